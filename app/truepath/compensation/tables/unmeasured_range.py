"""Content of tables where an axis was not measured.

Splines continue beyond the last measured position, with an uncertainty that grows fast:
their value there is no measurement. A table holds the value of the last measured
position, or fades from there to 0 at the end of the travel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.kinematics.machine.machine import LinearAxis, Machine

_LEAST_MM = 1e-3  # a shorter range is due to rounding


class Unmeasured(StrEnum):
    """Treatment of the part of a travel that was not measured."""

    HOLD = "hold"
    FADE = "fade"
    REFUSE = "refuse"

    @property
    def words(self) -> str:
        """Text for people."""
        if self is Unmeasured.FADE:
            return "fades to 0 at the end of the travel"
        return "holds the value of the last measured position"


@dataclass(frozen=True, slots=True)
class MeasuredRange:
    """The measured range of an axis, and the content of its table beyond.

    choice : None for the model's extrapolation
    is_stated : whether the result says where it was measured; if not, the range is the
        travel
    """

    axis: LinearAxis
    low: float
    high: float
    choice: Unmeasured | None
    is_stated: bool = True

    @property
    def missing(self) -> tuple[tuple[float, float], ...]:
        """Parts of the travel that were not measured."""
        ends = (self.axis.low, self.low), (self.high, self.axis.high)
        return tuple((a, b) for a, b in ends if b - a > _LEAST_MM)

    def place(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Positions whose errors a table holds at its own positions."""
        return at_mm if self.choice is None else np.clip(at_mm, self.low, self.high)

    def weigh(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Weight of the error there: 1, or less where it fades."""
        weight = np.ones(len(at_mm))
        if self.choice is not Unmeasured.FADE:
            return weight
        for begin, end in self.missing:
            measured, far = (begin, end) if begin == self.high else (end, begin)
            share = (at_mm - far) / (measured - far)
            weight = np.minimum(weight, np.clip(share, 0.0, 1.0))
        return weight

    @property
    def is_fully_measured(self) -> bool:
        """Whether the whole travel was measured according to the result."""
        return self.is_stated and not self.missing

    def describe(self) -> str:
        """Text about the unmeasured range, in plain ASCII."""
        if not self.is_stated:
            return (
                f"{self.axis.name}: the result does not state where it was measured: "
                "its table has what it says over the whole travel"
            )
        parts = " and ".join(f"{a:g} to {b:g}" for a, b in self.missing)
        choice = self.choice or Unmeasured.HOLD
        return f"{self.axis.name} not measured from {parts} mm: {choice.words}"


def compute_measured_ranges(
    machine: Machine,
    measured: Mapping[str, tuple[float, float]],
    choice: Unmeasured | None,
) -> dict[str, MeasuredRange]:
    """Measured range of each linear axis; the whole travel where none is stated.

    Raises BadInput if a part was not measured, or may not have been, and the choice is
    to refuse.
    """
    ranges = {
        axis.name: MeasuredRange(
            axis,
            *measured.get(axis.name, (axis.low, axis.high)),
            choice,
            axis.name in measured,
        )
        for axis in machine.linear_axes
    }
    if choice is Unmeasured.REFUSE:
        said = [one.describe() for one in ranges.values() if not one.is_fully_measured]
        if said:
            text = "; ".join(text.rpartition(":")[0] for text in said)
            raise BadInput(f"{text}; measure there, or hold or fade the values")
    return ranges
