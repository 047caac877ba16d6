"""Models of JSON files, and errors of one line.

A model defines the keys, types and bounds of an object. A refusal of a validator
becomes one BundleError: `machine.json: axes.X.max_mm is true; write a number`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Self, TypeVar, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    Strict,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from truepath.errors import BundleError


class FileModel(BaseModel):
    """An object of a file. Unknown keys are ignored.

    Numbers are finite and neither texts nor truth values; a key of null is missing. The
    refusal of a missing key gives the example of its field, if it has one.
    """

    model_config = ConfigDict(
        extra="ignore",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        defer_build=True,  # a command reads few kinds of files
    )

    @model_validator(mode="wrap")
    @classmethod
    def _reject_missing(
        cls, content: object, validate: ModelWrapValidatorHandler[Self]
    ) -> Self:
        fields = {
            field.alias or name: field for name, field in cls.model_fields.items()
        }
        for key, field in fields.items():
            if isinstance(content, Mapping) and content.get(key, field) is None:
                raise reject("is missing", _add(key, field), key)
        try:
            return validate(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = str(first["loc"][0]) if len(first["loc"]) == 1 else ""
            if first["type"] == "missing" and key in fields:
                raise reject("is missing", _add(key, fields[key]), key) from error
            raise


def _add(key: str, field: FieldInfo) -> str:
    example = f', as "{key}": {quote(field.examples[0])}' if field.examples else ""
    return f"add it{example}"


def reject(problem: str, remedy: str = "", *place: str | int) -> PydanticCustomError:
    """The error that a validator raises.

    place : keys below the value that is being validated
    """
    told = {"problem": problem, "remedy": remedy, "place": place}
    return PydanticCustomError("refused", "{problem}; {remedy}", told)


def require_finite(value: object, *place: str | int) -> object:
    """The value itself. Raises a refusal for a number in it that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise reject("is not finite", "write a finite number", *place)
    if isinstance(value, Mapping):
        for key, inner in cast("Mapping[str, object]", value).items():
            require_finite(inner, *place, key)
    if isinstance(value, list):
        for index, inner in enumerate(cast("list[object]", value)):
            require_finite(inner, *place, index)
    return value


def _require_three(value: object) -> object:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise reject(f"is {quote(value)}", "write three numbers, [x, y, z]")
    return value


def is_line(text: str) -> bool:
    """Whether a text is a printed line, of `LONGEST_LINE` characters at most."""
    return len(text) <= LONGEST_LINE and not _UNPRINTED.search(text)


def check_line(text: str) -> str:
    """The same text. Raises a refusal unless `is_line`."""
    if len(text) > LONGEST_LINE:
        problem = f"is {quote(text)}, of {len(text)} characters"
        raise reject(problem, f"write {LONGEST_LINE} at most")
    if bad := _UNPRINTED.search(text):
        problem = f"holds \\u{ord(bad.group()):04x} at character {bad.start() + 1}"
        raise reject(problem, "write one line of characters that are printed")
    return text


Text = Annotated[str, Field(min_length=1)]
Line = Annotated[Text, AfterValidator(check_line)]
Vector = Annotated[
    tuple[float, float, float], Strict(False), BeforeValidator(_require_three)
]
# Control characters, and marks that turn the direction of what follows.
UNPRINTED = "\\u0000-\\u001f\\u007f-\\u009f\\u2028-\\u202e\\u2066-\\u2069"
_UNPRINTED = re.compile(f"[{UNPRINTED}\\ud800-\\udfff]")
LONGEST_LINE = 200
_NO_CHARACTER = re.compile("[\0\ud800-\udfff]")
Model = TypeVar("Model", bound=FileModel)


def parse_json(data: bytes, file: str) -> object:
    """Decoded from UTF-8, with or without a byte order mark. Raises BundleError."""
    try:
        content = json.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise BundleError(
            f"is not text in UTF-8 (byte {error.start})",
            file=file,
            remedy="save as UTF-8",
        ) from error
    except json.JSONDecodeError as error:
        raise BundleError(
            f"is not JSON: {error.msg} at character {error.colno}",
            file=file,
            row=error.lineno,
            remedy="correct that line",
        ) from error
    except (RecursionError, ValueError) as error:
        raise BundleError(
            "is nested too deeply or holds a number of too many digits", file=file
        ) from error
    if b"\\u" in data:
        _require_text(content, file)
    return content


def _require_text(content: object, file: str) -> None:
    found = (_NO_CHARACTER.search(text) for text in _list_texts(content))
    code = next((one.group() for one in found if one), None)
    if code is not None:
        raise BundleError(
            f"holds \\u{ord(code):04x}, which is no character",
            file=file,
            remedy="write the text without it",
        )


def _list_texts(content: object) -> Iterator[str]:
    left: list[object] = [content]
    while left:
        match left.pop():
            case str() as text:
                yield text
            case dict() as keys:
                left += [*keys.keys(), *keys.values()]
            case list() as values:
                left += values
            case _:
                pass


def as_object(content: object) -> Mapping[str, Any]:
    """Parsed JSON where it is an object; an empty one for anything else."""
    return cast(Mapping[str, Any], content) if isinstance(content, Mapping) else {}


def encode_json(content: object, *, indent: int | None = None) -> bytes:
    """UTF-8 with a final line feed. Raises ValueError for a NaN or infinity."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, indent=indent)
    return f"{text}\n".encode()


def validate(
    model: type[Model],
    content: object,
    file: str,
    *,
    key: str = "",
    context: object = None,
) -> Model:
    """The model of parsed JSON. Raises BundleError with the place.

    key : path of the content in the file, empty for the whole file
    context : what validators need to know in addition to the content
    """
    try:
        return model.model_validate(content, context=context)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise _bundle_error(first, content, file, key) from error


def quote(value: object) -> str:
    """As JSON, of 60 characters at most."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    text = text.encode(errors="backslashreplace").decode()
    return text if len(text) <= 60 else text[:57] + "…"


def _bundle_error(
    error: ErrorDetails, content: object, file: str, key: str
) -> BundleError:
    place, (problem, remedy) = list(error["loc"]), _describe(error)
    told = error.get("ctx", {})
    if error["type"] == "refused":
        place += told["place"]
    elif error["type"].startswith("union_tag"):
        place.append(told["discriminator"].strip("'"))
    path = _path(place, content, key)
    return BundleError(f"{path} {problem}".lstrip(), file=file, remedy=remedy)


def _describe(error: ErrorDetails) -> tuple[str, str]:
    kind, value, told = error["type"], error["input"], error.get("ctx", {})
    if kind == "refused":
        return told["problem"], told["remedy"]
    if kind in ("missing", "union_tag_not_found"):
        return "is missing", "add it"
    if kind == "union_tag_invalid":
        value = value[told["discriminator"].strip("'")]
        return f"is {quote(value)}", f"write one of {_unquote(told['expected_tags'])}"
    if kind == "literal_error":
        return f"is {quote(value)}", _choices(error)
    if kind == "finite_number" or (kind == "float_type" and _is_integer(value)):
        return "is not finite", "write a finite number"
    if kind in ("greater_than", "greater_than_equal"):
        bound = told.get("gt", told.get("ge"))
        wanted = f"above {bound:g}" if "gt" in told else f"{bound:g} or more"
        return f"is {value:g}", f"it must be {wanted}"
    if kind == "less_than_equal":
        return f"is {value:g}", f"it must be {told['le']:g} or less"
    return f"is {quote(value)}", f"write {_KINDS.get(kind, error['msg'])}"


_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "string_too_short": "a text",
    "string_unicode": "a text of whole characters",
    "list_type": "a list, […]",
    "dict_type": "an object, {…}",
    "model_type": "an object, {…}",
    "model_attributes_type": "an object, {…}",
}


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _choices(error: ErrorDetails) -> str:
    choices = _unquote(error.get("ctx", {})["expected"]).replace(" or ", ", ")
    if ", " in choices:
        return f"write one of {choices}"
    return f'write "{error["loc"][-1]}": "{choices}"'


def _unquote(text: str) -> str:
    return text.replace("'", "")


def _path(place: Sequence[str | int], content: Any, key: str) -> str:
    """For example `axes.X.min_mm`; steps that choose among models are no keys."""
    path, last = key, len(place) - 1
    for number, step in enumerate(place):
        if isinstance(step, int):
            path += f"[{step}]"
        elif step in content or number == last:
            path += f".{step}" if path else step
        else:
            continue
        try:
            content = content[step]
        except (LookupError, TypeError):
            content = ()
    return path
