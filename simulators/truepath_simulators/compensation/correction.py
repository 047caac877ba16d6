"""Curves over axis positions, products and additions; the rules of a control."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.truth_machine import TruthMachine


class Correction(ABC):
    """Addition of a controller to the commanded positions of its axes."""

    @abstractmethod
    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Addition to each axis, mm or deg, (n, axes).

        position : (n, axes) as commanded
        heading : (n, axes) direction in which each axis moves or last moved, 1 or −1, 0
            where it has not moved yet
        """


@dataclass(frozen=True, slots=True)
class Curve:
    """Values at positions of an axis, linear between them; end values hold beyond.

    column : of the axis; at, value : (m,) ascending
    side : 1 or −1 for a curve of that direction of travel alone, 0 for both. An axis
        that has not moved yet counts as one that arrived in + direction
    period : length after which the curve repeats, 0 for none
    is_stepped : the value of the nearest position instead of a line
    """

    column: int
    at: np.ndarray
    value: np.ndarray
    side: int = 0
    period: float = 0.0
    is_stepped: bool = False

    def read(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Values, (n,); 0 in the direction that it is not for."""
        place = position[:, self.column]
        if self.period:
            place = self.at[0] + np.mod(place - self.at[0], self.period)
        if self.is_stepped:
            between = 0.5 * (self.at[1:] + self.at[:-1])
            value = self.value[np.searchsorted(between, place, side="right")]
        else:
            value = np.interp(place, self.at, self.value)
        if not self.side:
            return value
        direction = np.where(heading[:, self.column] < 0.0, -1, 1)
        return np.where(direction == self.side, value, 0.0)


@dataclass(frozen=True, slots=True)
class Term:
    """A product of curves that is added to an axis.

    out : column of that axis; factor : of the product
    """

    out: int
    curves: tuple[Curve, ...]
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class TableCorrection(Correction):
    """The sum of terms."""

    terms: tuple[Term, ...]

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        total = np.zeros_like(position, dtype=float)
        for term in self.terms:
            value = np.full(len(position), term.factor)
            for curve in term.curves:
                value = value * curve.read(position, heading)
            total[:, term.out] += value
        return total


@dataclass(frozen=True, slots=True)
class ChainedCorrection(Correction):
    """First correction, and a second one at the positions corrected by the first."""

    first: Correction
    then: Correction

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        once = self.first.added(position, heading)
        return once + self.then.added(position + once, heading)


@dataclass(frozen=True, slots=True)
class ReversedCorrection(Correction):
    """Tables that were entered with the wrong sign."""

    right: Correction

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        return -self.right.added(position, heading)


def measure_deviation_mm(
    truth: TruthMachine,
    correction: Correction | None,
    position: np.ndarray,
    direction: float = 1.0,
    target: str = "",
) -> np.ndarray:
    """Actual minus nominal tool point of the machine with its tables, (n, 3) mm.

    position : (n, axes) as commanded; direction : in which all axes arrive
    """
    driven = position
    if correction is not None:
        heading = np.full_like(position, direction, dtype=float)
        driven = position + correction.added(position, heading)
    reflector = truth.machine.reflector(target)
    return truth.point_mm(driven, reflector) - truth.nominal_point_mm(
        position, reflector
    )


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
        active = dict(part.split("=") for part in text.split(","))
        return int(active.get(axis, 1))
