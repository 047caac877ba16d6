"""Fields of a line, and conversion of lines to samples."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.errors import Refused

NOT_VALID, NO_POSITION = 0x01, 0x80
_LENGTH_MM = {"mm": 1.0, "m": 1e3, "inch": 25.4}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": None}
_FIELDS = ("x", "y", "z", "time", "counter", "status", "-")
_AXIS = re.compile(r"^([+-]?)([xyz])$")


@dataclass(frozen=True, slots=True)
class LineBlock:
    """Fields of some lines; time_s and counter are NaN where a line has none."""

    time_s: NDArray[np.float64]
    counter: NDArray[np.float64]
    position_mm: NDArray[np.float64]
    status: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.status)


class LineLayout:
    """The fields of a line in order, and their units.

    columns : names of `_FIELDS` with commas between; `-` is an ignored field
    valid : words of the status field that allow a sample's use
    axes : signs and names of the fields that become x, y, z, right-handed
    invalid_place : x, y, z as the sender writes them while it has no position; empty if
        it writes no such place
    """

    def __init__(
        self,
        columns: str,
        *,
        delimiter: str = "comma",
        decimal_comma: bool = False,
        unit: str = "mm",
        time_unit: str = "s",
        axes: str = "x,y,z",
        valid: str = "0",
        invalid_place: str = "",
    ) -> None:
        self.fields = [name.strip() for name in columns.split(",")]
        _check_fields(self.fields)
        self._delimiter = _DELIMITERS[choose("delimiter", delimiter, _DELIMITERS)]
        if decimal_comma and delimiter == "comma":
            raise Refused("commas cannot separate both fields and decimals")
        self._decimal_comma = decimal_comma
        self._scale_mm = _LENGTH_MM[choose("unit", unit, _LENGTH_MM)]
        self._scale_s = _SECONDS[choose("time_unit", time_unit, _SECONDS)]
        self._order, self._signs = _parse_axes(axes)
        self._valid = {word.strip() for word in valid.split(",")}
        self._invalid_place = _parse_place(invalid_place)

    @property
    def has_time(self) -> bool:
        return "time" in self.fields

    @property
    def has_counter(self) -> bool:
        return "counter" in self.fields

    def parse(self, lines: Sequence[bytes]) -> tuple[LineBlock, int]:
        """The good lines, and the number of bad ones."""
        rows = [row for line in lines if (row := self._parse_line(line)) is not None]
        table = np.array(rows, float).reshape(-1, 6)
        position_mm = self._scale_mm * self._signs * table[:, 2:5][:, self._order]
        status = table[:, 5].astype(np.int64)
        lost = ~np.isfinite(position_mm).all(axis=1)
        lost |= (table[:, 2:5] == self._invalid_place).all(axis=1)
        status[lost] |= NO_POSITION
        position_mm[lost] = 0.0
        block = LineBlock(table[:, 0] * self._scale_s, table[:, 1], position_mm, status)
        return block, len(lines) - len(rows)

    def explain(self, line: bytes) -> str:
        """Why a line cannot be read; empty where it is good."""
        try:
            self._read_cells(line)
        except ValueError as problem:
            return str(problem)
        return ""

    def _parse_line(self, line: bytes) -> tuple[float, ...] | None:
        try:
            return self._read_cells(line)
        except ValueError:
            return None

    def _read_cells(self, line: bytes) -> tuple[float, ...]:
        """Time, counter, x, y, z, status. Raises ValueError with the cause."""
        text = _decode(line)
        words = [word.strip() for word in text.split(self._delimiter)]
        if len(words) != len(self.fields):
            raise ValueError(f"has {len(words)} fields, columns {len(self.fields)}")
        if self._decimal_comma:
            words = [word.replace(",", ".") for word in words]
        cells = dict(zip(self.fields, words, strict=True))
        values = [
            _read_number(name, cells.get(name, "nan"))
            for name in ("time", "counter", "x", "y", "z")
        ]
        for name, value in zip(("time", "counter"), values, strict=False):
            if name in cells and not math.isfinite(value):
                raise ValueError(f"{name} is {cells[name]!r}")
        if "counter" in cells and not values[1].is_integer():
            raise ValueError(f"counter is {cells['counter']!r}, no whole number")
        valid = "status" not in cells or cells["status"] in self._valid
        return *values, 0.0 if valid else NOT_VALID


def _decode(line: bytes) -> str:
    if b"\0" in line:
        raise ValueError("is not ASCII but UTF-16 or binary")
    try:
        return line.decode("ascii").strip()
    except UnicodeDecodeError:
        raise ValueError("is not ASCII") from None


def _read_number(name: str, word: str) -> float:
    if "_" not in word:
        with suppress(ValueError):
            return float(word)
    raise ValueError(f"{name} is {word!r}, no number")


def choose(option: str, word: str, known: Collection[str]) -> str:
    """The word. Raises Refused if it is none of those known."""
    if word not in known:
        raise Refused(f"{option} {word!r} is none of {', '.join(known)}")
    return word


def _check_fields(fields: list[str]) -> None:
    for name in fields:
        choose("column", name, _FIELDS)
        if name != "-" and fields.count(name) > 1:
            raise Refused(f"column {name} is named twice")
    for name in "xyz":
        if name not in fields:
            raise Refused(f"no column is {name}; name all fields of a line")


def _parse_axes(axes: str) -> tuple[list[int], NDArray[np.float64]]:
    found = [_AXIS.match(word.strip()) for word in axes.split(",")]
    parts = [match.groups() for match in found if match]
    if sorted(name for _, name in parts) != ["x", "y", "z"] or len(found) != 3:
        raise Refused(f"axes {axes!r}: write each of x, y, z once, as in x,-y,z")
    signs = np.array([-1.0 if sign == "-" else 1.0 for sign, _ in parts])
    return ["xyz".index(name) for _, name in parts], signs


def _parse_place(text: str) -> NDArray[np.float64]:
    """NaN, which no place equals, where there is no text."""
    if not text:
        return np.full(3, np.nan)
    with suppress(ValueError):
        place = np.array([_read_number("place", word) for word in text.split(",")])
        if place.shape == (3,) and np.isfinite(place).all():
            return place
    raise Refused(f"invalid_place {text!r}: write x, y, z in numbers, as in 0,0,0")
