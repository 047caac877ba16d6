"""Options of the user for an exported file, where it is ambiguous."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from truepath.errors import BadInput

DELIMITERS = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": " "}
ROLES = ("x", "y", "z", "time", "date", "status", "point")


@dataclass(frozen=True, slots=True)
class TextOptions:
    """Empty values are recognised from the file.

    columns : role, or `NAME_degC`, to a column's name or its number from 1
    rate_hz : of the rows; the time column, if any, is left out
    valid : values in the status column of samples that may be used
    axes : signs and names of the file's axes that become x, y, z: `x,-y,z`
    """

    delimiter: str = ""
    decimal: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    time_unit: str = ""
    date_order: str = ""
    across_midnight: bool = False
    rate_hz: float | None = None
    valid: tuple[str, ...] = ()
    axes: str = "x,y,z"


def parse_columns(words: list[str]) -> dict[str, str]:
    """From `role=column` words. Raises BadInput."""
    columns: dict[str, str] = {}
    for word in words:
        role, equals, column = word.partition("=")
        known = role in ROLES or (role.endswith("_degC") and role != "_degC")
        if not (known and equals and column.strip()):
            raise BadInput(
                f"--column {word}: write ROLE=NAME or ROLE=NUMBER; roles are "
                f"{', '.join(ROLES)} and NAME_degC"
            )
        if role in columns:
            raise BadInput(f"--column {role}: is given twice")
        columns[role] = column.strip()
    return columns
