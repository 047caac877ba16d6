"""Interpretations of files that no public text decides, as options."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from truepath_simulators.errors import SimulatorError

BacklashReading = Literal["negative-value", "difference"]
_BY_AXIS = re.compile(r"[12]|[A-Z]=[12](,[A-Z]=[12])*")
BACKLASH_READINGS: tuple[BacklashReading, ...] = ("negative-value", "difference")


@dataclass(frozen=True, slots=True)
class Rules:
    """Interpretation of tables by this controller.

    backlash_reading : of the column BACKLASH of Heidenhain tables: the value in
        negative travel, or what is added to the other column there
    reversed_sign : it uses the tables with the other sign
    tool_length_mm : of the tool in use, along N0X, N0Y, N0Z of ISG_CSV and Etalon
        Exchange
    measuring_system : of the axes of a SINUMERIK, the active one: 1 or 2; by axis as
        `X=1,Y=2`, 1 for others
    """

    backlash_reading: BacklashReading = "negative-value"
    reversed_sign: bool = False
    tool_length_mm: float = 0.0
    measuring_system: int | str = 1

    def find_measuring_system(self, axis: str) -> int:
        """Active measuring system of an axis. Raises SimulatorError."""
        text = str(self.measuring_system)
        if _BY_AXIS.fullmatch(text) is None:
            raise SimulatorError(
                f"measuring_system: expected 1, 2 or X=1,Y=2, not {text!r}"
            )
        if "=" not in text:
            return int(text)
        return dict(_read_part(part) for part in text.split(",")).get(axis, 1)


def _read_part(part: str) -> tuple[str, int]:
    axis, _, number = part.partition("=")
    return axis, int(number)
