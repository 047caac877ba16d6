"""A positioning error that repeats with every turn of the ball screw or scale pitch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Scan,
    Signature,
    Wave,
    rate_of,
)
from app.kinematics.effects.error_motion import arm_of
from app.kinematics.effects.sinusoid import (
    is_resolved,
    measured_wave,
    wave_numbers,
    waves_of_cells,
)
from app.kinematics.machine import LinearAxis, Machine

_SHORTEST_MM, _LONGEST_MM = 2.5, 45.0
_SECOND = 0.2  # usual share of the second harmonic


@dataclass(frozen=True)
class ScrewCyclic(Effect):
    """Positioning of an axis as sin and cos of its position over a lead and half of it.

    A screw that errs every turn hardly does so as a pure sine.
    """

    axis: LinearAxis
    lead_mm: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"screw-cyclic-{self.axis.name}-{self.lead_mm:.4g}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sine and cosine of the lead, then of half of it, in mm."""
        return tuple(
            Parameter(f"{self.name}-{p}", "mm") for p in ("sin", "cos", "sin2", "cos2")
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 4"]:
        """Return the axis' direction times the waves, averaged over each cell."""
        name, turn = self.axis.name, 2.0 * np.pi / self.lead_mm
        angle, rate = turn * at.axis_mm(name), turn * rate_of(at, name)
        waves = [waves_of_cells(k * angle, k * rate, at) for k in (1, 2)]
        arm = arm_of(f"E{name}{name}", at)
        return arm[:, :, None] * np.concatenate(waves, axis=1)[:, None, :]


class ScrewCyclicFamily(Family):
    """Candidates of every straight axis, the lead scanned."""

    name = "screw-cyclic"
    scanned = "lead_mm"
    signature = Signature(
        cause="A ball screw, its bearing or a scale that errs alike every turn.",
        looks_like="A wave along one axis, the same at every feed, with the period of "
        "the screw's lead or of the scale's pitch.",
        remedy="Enter a cyclic compensation for the axis; look at the screw's thrust "
        "bearing and coupling, or at the scale's head.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one an axis."""
        return [
            Candidate(
                self.name,
                {"axis": axis.name},
                ScrewCyclic(axis, 10.0),
                USUAL_MM * np.array([1.0, 1.0, _SECOND, _SECOND]),
                10.0,
            )
            for axis in at.machine.linear_axes
            if is_resolved(at, axis.name, _LONGEST_MM)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Return leads at equal steps of turns, four to a period over the travel."""
        axis = candidate.keys["axis"]
        turns = wave_numbers(at, axis, _SHORTEST_MM, _LONGEST_MM)
        return Scan(self.scanned, 1.0 / turns[::-1])

    def wave(self, candidate: Candidate, at: Conditions) -> Wave:
        """Return the scan as a wave of the position."""
        axis = candidate.keys["axis"]
        return Wave(
            arm_of(f"E{axis}{axis}", at),
            at.axis_mm(axis),
            rate_of(at, axis),
            1.0 / self.scan(candidate, at).values,
        )

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        return ScrewCyclic(machine.linear(keys["axis"]), numbers[self.scanned])

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "4"],
        covariance: Float64[np.ndarray, "4 4"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return lead, amplitude and phase at the axis zero."""
        return measured_wave(
            self.scanned, candidate, theta[:2], covariance[:2, :2], value_sigma
        )
