"""Values of a parsed JSON file with their place in it, so that every error names it."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.errors import BundleError

Json = Mapping[str, Any]


def parse_json(data: bytes, file: str) -> object:
    """Return what the bytes of a JSON file say. Raises BundleError with the place."""
    try:
        return json.loads(data.decode("utf-8-sig"))
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


class Field:
    """A value of the file and the way to it, `axes.X.min_mm`."""

    def __init__(self, file: str, path: str, value: object) -> None:
        self.file, self.path, self.value = file, path, value

    def error(self, problem: str, remedy: str = "") -> BundleError:
        """Return the error that names this place."""
        where = f"{self.path} " if self.path else ""
        return BundleError(f"{where}{problem}", file=self.file, remedy=remedy)

    def mapping(self) -> Fields:
        """Return an object."""
        if not isinstance(self.value, Mapping):
            raise self.error(f"is {shown(self.value)}", "write an object, {…}")
        return Fields(self.file, self.path, self.value)

    def elements(self) -> list[Field]:
        """Return the elements of a list."""
        if not isinstance(self.value, list):
            raise self.error(f"is {shown(self.value)}", "write a list, […]")
        return [
            Field(self.file, f"{self.path}[{i}]", v) for i, v in enumerate(self.value)
        ]

    def numbers(self) -> Float64[np.ndarray, " n"]:
        """Return a list of finite numbers."""
        return np.array([element.number() for element in self.elements()], float)

    def text(self) -> str:
        """Return a text, not an empty one."""
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"is {shown(self.value)}", "write a text")
        return self.value

    def number(self, *, lowest: float = -math.inf, above: bool = False) -> float:
        """Return a finite number, not below (with `above`, greater than) `lowest`."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"is {shown(value)}", "write a number")
        if not -sys.float_info.max <= value <= sys.float_info.max:
            raise self.error("is not finite", "write a finite number")
        if value < lowest or (above and value <= lowest):
            bound = f"above {lowest:g}" if above else f"{lowest:g} or more"
            raise self.error(f"is {value:g}", f"it must be {bound}")
        return float(value)

    def vector(self) -> tuple[float, float, float]:
        """Return three finite numbers."""
        value = self.value
        if not isinstance(value, list | tuple) or len(value) != 3:
            raise self.error(f"is {shown(value)}", "write three numbers, [x, y, z]")
        x, y, z = (
            Field(self.file, f"{self.path}[{i}]", v).number()
            for i, v in enumerate(value)
        )
        return x, y, z

    def choice(self, allowed: tuple[str, ...]) -> str:
        """Return one of the allowed texts."""
        if self.value not in allowed:
            raise self.error(
                f"is {shown(self.value)}", f"write one of {', '.join(allowed)}"
            )
        return str(self.value)


class Fields:
    """An object of the file and the way to it."""

    def __init__(self, file: str, path: str, values: Json) -> None:
        self.file, self.path, self.values = file, path, values

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def child(self, key: str, *, default: object = None) -> Field:
        """Return the value of a key; it must be there unless a default stands in."""
        value = self.values.get(key, default)
        path = f"{self.path}.{key}" if self.path else key
        if value is None:
            raise BundleError(f"{path} is missing", file=self.file, remedy="add it")
        return Field(self.file, path, value)

    def children(self) -> list[tuple[str, Field]]:
        """Return all keys with their values."""
        return [(key, self.child(key)) for key in self.values]


def shown(value: object) -> str:
    """Quote a value as JSON, shortened."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "…"
