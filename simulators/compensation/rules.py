"""Readings of a form that no public text settles: of this controller, as options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

BacklashReading = Literal["negative-value", "difference"]
BACKLASH_READINGS: tuple[BacklashReading, ...] = ("negative-value", "difference")


@dataclass(frozen=True, slots=True)
class Rules:
    """How this controller takes its tables.

    backlash_reading : of the column BACKLASH of Heidenhain tables: the value in
        negative travel, or what is added to the other column there
    reversed_sign : it takes the tables with the other sign
    tool_length_mm : of the tool in use, along N0X, N0Y, N0Z of ISG_CSV and
        Etalon Exchange
    measuring_system : of the axes of a SINUMERIK, the active one: 1 or 2
    """

    backlash_reading: BacklashReading = "negative-value"
    reversed_sign: bool = False
    tool_length_mm: float = 0.0
    measuring_system: int = 1
