"""`reference.csv` of a bundle: errors measured directly, to compare with."""

from __future__ import annotations

import io
import re

from app.errors import BundleError
from app.files.run import DirectMeasurement
from app.files.tables import Table, read_csv

_SYMBOL = re.compile(r"^[A-Z][0-9A-Z][A-Z]$")
_COLUMNS = ("error", "position_mm", "direction", "value", "unit")
_UNITS = ("um", "urad")


def decode_reference(
    data: bytes, *, file: str = "reference.csv"
) -> tuple[DirectMeasurement, ...]:
    """Return one measurement for each error, direction and unit, in order of rows."""
    table = read_csv(data, file)
    table.require(*_COLUMNS)
    if len(table) == 0:
        raise BundleError("has no rows", file=file, remedy="leave out the file")
    position, value = table.numbers("position_mm"), table.numbers("value")
    words = (table.texts(name) for name in ("error", "direction", "unit"))
    rows: dict[tuple[str, str, str], list[int]] = {}
    for index, (error, direction, unit) in enumerate(zip(*words, strict=True)):
        _check(table, index, error, direction, unit)
        rows.setdefault((error, direction, unit), []).append(index)
    return tuple(
        DirectMeasurement(*key, position[at], value[at]) for key, at in rows.items()
    )


def encode_reference(reference: tuple[DirectMeasurement, ...]) -> bytes:
    """Return the `reference.csv` of direct measurements."""
    text = io.StringIO()
    text.write(",".join(_COLUMNS) + "\n")
    for one in reference:
        for position, value in zip(one.position_mm, one.value, strict=True):
            numbers = repr(float(position)), repr(float(value))
            row = one.error, numbers[0], one.direction, numbers[1], one.unit
            text.write(",".join(row) + "\n")
    return text.getvalue().encode()


def _check(table: Table, index: int, error: str, direction: str, unit: str) -> None:
    if not _SYMBOL.match(error):
        raise table.error(
            f"is {error!r}", index, "error", "write a symbol of ISO 230-1, such as EXX"
        )
    if direction not in ("+", "-"):
        raise table.error(f"is {direction!r}", index, "direction", "write + or -")
    if unit not in _UNITS:
        raise table.error(f"is {unit!r}", index, "unit", "write um or urad")
