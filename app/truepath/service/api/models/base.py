"""Base of bodies: address of the interface, limits of numbers, problems."""

from __future__ import annotations

import re
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Annotated, Any, Self, cast

from fastapi import Path
from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    StringConstraints,
)
from pydantic.json_schema import JsonSchemaValue, SkipJsonSchema
from pydantic_core import CoreSchema
from pydantic_core.core_schema import any_schema

from truepath.documents.file_model import LONGEST_LINE, UNPRINTED
from truepath.machine_settings import MACHINE_ID
from truepath.motion.nc_programs.programs import LARGEST_FEED_MM_MIN
from truepath.motion.paths.commanded_rows import LEAST_FEED_MM_MIN

PREFIX = "/api/v1"
BASE: ContextVar[str] = ContextVar("base", default="")
"""Path prefix of a proxy for the current request; empty without one."""
JOB_ID = "019a3f5e-7a11-7c3e-9d64-2b1f0c5e8a90"
OTHER_ID = "019a3f6b-0c52-7e41-8a3d-5f7e9b1c2d34"
"""The job of all examples."""

Mm = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Deg = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
Feed = Annotated[
    float, Field(ge=LEAST_FEED_MM_MIN, le=LARGEST_FEED_MM_MIN, allow_inf_nan=False)
]
TargetUm = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
Hours = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
HoursAhead = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
Degrees = Annotated[float, Field(ge=-50, le=150, allow_inf_nan=False)]
Dwell = Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)]
Identifier = Annotated[
    str, StringConstraints(pattern=r"^[0-9a-zA-Z-]+$", max_length=36)
]
CompensationName = Annotated[  # neither "." nor "..": it names a folder
    str, StringConstraints(pattern=r"^[0-9A-Za-z-][0-9A-Za-z.-]*$", max_length=100)
]


def _require_utc(at: datetime) -> datetime:
    try:
        return at.astimezone(UTC)
    except OverflowError:
        raise ValueError("is not in the years 1 to 9999 of UTC") from None


Time = Annotated[AwareDatetime, AfterValidator(_require_utc)]
"""With its zone; turned into UTC."""

MachineId = Annotated[str, StringConstraints(pattern=MACHINE_ID, max_length=32)]
MachinePath = Annotated[
    str, Path(description="`id` of the machine.", examples=["default"])
]
JobId = Annotated[str, Path(description="`id` of the job.", examples=[JOB_ID])]
PlanId = Annotated[str, Path(description="`id` of the plan.", examples=[OTHER_ID])]
RunId = Annotated[str, Path(description="`id` of the Run.", examples=[OTHER_ID])]
ModelId = Annotated[
    str,
    Path(description="`id` of the model: of the job that made it.", examples=[JOB_ID]),
]
CertificateNumber = Annotated[
    str,
    Path(
        description="`number` of the certificate.",
        examples=["TP-20261124-2B1F0C5E-1"],
    ),
]
CompensationId = Annotated[
    str,
    Path(
        description="`id` of the files of one format.",
        examples=["linuxcnc-10-hold"],
    ),
]


class AsKept:
    """Marks a field that is passed on unchanged and described by a model.

    The content of a file or the catalogue may be of another version of the service: it
    is not validated again. Content that is sent in is checked by the reader of such
    files, which names the key and the remedy.
    """

    def __init__(self, model: type[BaseModel], *, many: bool = False) -> None:
        self._model, self._many = model, many

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return any_schema()

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        self._model.model_rebuild()  # models of files are built when they are used
        described = handler(self._model.__pydantic_core_schema__)
        return {"type": "array", "items": described} if self._many else described


_STRICT = frozenset({"bool", "int", "float"})
_NO_SCHEMA = frozenset({"config", "default", "metadata"})


def _make_strict(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_make_strict(one) for one in cast(list[Any], schema)]
    if not isinstance(schema, dict):
        return schema
    parts = cast(dict[str, Any], schema)
    inner = {k: v if k in _NO_SCHEMA else _make_strict(v) for k, v in parts.items()}
    is_strict = isinstance(kind := parts.get("type"), str) and kind in _STRICT
    return inner | {"strict": True} if is_strict else inner


class RequestBody(BaseModel):
    """What clients send: nothing else is in it.

    A number is no text and no truth value, a truth value is nothing else.
    """

    model_config = ConfigDict(extra="forbid", str_max_length=200)

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return _make_strict(handler(source))


def examples(*bodies: dict[str, Any]) -> ConfigDict:
    """Show these bodies of a request in the documentation."""
    return ConfigDict(json_schema_extra={"examples": [*bodies]})


def address(path: str) -> str:
    """Address of a path below `PREFIX`, with a proxy's prefix."""
    return BASE.get() + PREFIX + path


class Links(BaseModel):
    """Where else to look: beside each field its address below `PREFIX`."""

    @classmethod
    def of(cls, **ids: str | None) -> Self:
        """Addresses by field of these identifiers; None where one is None."""
        addresses = {
            name: address(field.metadata[0].format(**ids))
            for name, field in cls.model_fields.items()
            if field.metadata
            and all(ids[i] for i in re.findall(r"{(\w+)}", field.metadata[0]))
        }
        nowhere = {n: None for n, field in cls.model_fields.items() if field.metadata}
        return cls.model_validate(nowhere | addresses)


class Problem(BaseModel, extra="allow"):
    """What went wrong and the way out (RFC 9457). Further keys belong to its code."""

    type: str = Field(examples=["/problems/busy"])
    title: str = Field(examples=["Another job holds the machine"])
    status: int | None = Field(None, examples=[409])
    detail: str = Field(examples=[f"job {JOB_ID} (running) holds the machine"])
    code: str = Field(examples=["busy"])
    action: str = Field(examples=["Wait until current_job has ended, or abort it."])
    instance: str | None = Field(None, examples=["/api/v1/jobs"])
    request_id: str | None = Field(None, examples=["6f0e4c1b9a7d4e52"])


_PRINTED = f"[^{UNPRINTED}]"
_PRINTED_OR_BREAK = (
    "[^\\u0000-\\u0008\\u000b-\\u001f\\u007f-\\u009f\\u2028-\\u202e\\u2066-\\u2069]"
)
Name = Annotated[
    str, StringConstraints(pattern=f"^{_PRINTED}*$", max_length=LONGEST_LINE)
]
RunName = Annotated[
    str, StringConstraints(pattern=f"^{_PRINTED}+$", min_length=1, max_length=200)
]
Note = Annotated[
    str, StringConstraints(pattern=f"^{_PRINTED_OR_BREAK}*$", max_length=2000)
]


class JobNaming(RequestBody):
    """Name and note of a job. What is left out stays as it is."""

    model_config = ConfigDict(
        str_max_length=2000,
        json_schema_extra={"examples": [{"name": "As found, before the new spindle"}]},
    )

    name: Name | SkipJsonSchema[None] = Field(
        None, description="Empty: none.", examples=["As found"]
    )
    note: Note | SkipJsonSchema[None] = Field(
        None, description="Lines are broken by \\n.", examples=["Warm since 8:00."]
    )


class RunNaming(JobNaming):
    """Name and note of a Run. What is left out stays as it is."""

    name: RunName | SkipJsonSchema[None] = Field(
        None, description="A Run has one always.", examples=["As found"]
    )
