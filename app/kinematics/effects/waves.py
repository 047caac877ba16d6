"""Periodic behaviour that no catalogued effect explains: in time, or along an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role, along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Described,
    Measured,
    Scan,
    Signature,
    Wave,
    rate_of,
)
from app.kinematics.effects.sinusoid import (
    is_resolved,
    measured_wave,
    sine_and_cosine,
    wave_numbers,
    wave_of_time,
    waves_of_cells,
)
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import DIRECTION, LINEAR

_FASTEST_HZ = 1.0
_FEWEST = 3.0  # periods in the run: what is slower wanders
_SHORTEST_MM, _LONGEST_MM = 4.0, 60.0


@dataclass(frozen=True)
class TimeWave(Effect):
    """Sine and cosine of time in one direction.

    middle_s : of the run, where the phase is 0: so it does not turn with the period
    """

    direction: str
    period_s: float
    middle_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"time-wave-{self.direction}-{self.period_s:.5g}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.STRUCTURE

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sine and cosine, in mm."""
        return sine_and_cosine(self.name, "mm")

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        rate = np.full(len(at), 2.0 * np.pi / self.period_s)
        angle = rate * (at.time_s - self.middle_s)
        return along(self.direction, waves_of_cells(angle, rate, at))


@dataclass(frozen=True)
class PositionWave(Effect):
    """Sine and cosine of an axis' position, across the axis."""

    axis: LinearAxis
    direction: str
    period_mm: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"position-wave-{self.axis.name}-{self.direction}-{self.period_mm:.5g}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.STRUCTURE

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sine and cosine, in mm."""
        return sine_and_cosine(self.name, "mm")

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        turn = 2.0 * np.pi / self.period_mm
        angle = turn * at.axis_mm(self.axis.name)
        rate = turn * rate_of(at, self.axis.name)
        return along(self.direction, waves_of_cells(angle, rate, at))


class TimeWaveFamily(Described):
    """Every direction, the period scanned down to a second."""

    name = "time-wave"
    scanned = "period_s"
    in_machine = False
    signature = Signature(
        cause="Something switches or breathes with a steady period: coolant, air "
        "conditioning, a pump's pressure.",
        looks_like="All points move to and fro with time, whatever axis moves.",
        remedy="Find what runs with this period; measure with it off, or average over "
        "whole periods.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction."""
        usual = np.full(2, USUAL_MM)
        middle_s = 0.5 * float(at.time_s.min() + at.time_s.max())
        waves = [TimeWave(direction, 20.0, middle_s) for direction in LINEAR]
        return [
            Candidate(self.name, {"direction": w.direction}, w, usual, w.period_s)
            for w in waves
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return periods from a second to a third of the run."""
        span = float(np.ptp(at.time_s))
        frequency = np.arange(_FEWEST / span, _FASTEST_HZ, 0.25 / span)
        return Scan(self.scanned, 1.0 / frequency[::-1]) if len(frequency) else None

    def wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave of time."""
        scan = self.scan(candidate, at)
        if scan is None or at.recorded is None:
            return None
        return wave_of_time(candidate.keys["direction"], at, 1.0 / scan.values)

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "2"],
        covariance: Float64[np.ndarray, "2 2"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return period and amplitude."""
        return measured_wave(self.scanned, candidate, theta, covariance, value_sigma)

    def depends_on(self, candidate: Candidate) -> list[str]:
        """Return the time."""
        return ["t"]

    def told(self, candidate: Candidate, found: Mapping[str, Measured]) -> str:
        """Return direction, period and amplitude."""
        return (
            f"a wave in time along {candidate.keys['direction']} with a period of "
            f"{found['period_s'].value:.3g} s and an amplitude of "
            f"{found['amplitude_um'].value:.2g} µm"
        )


class PositionWaveFamily(Described):
    """Every axis and direction across it, the period scanned."""

    name = "position-wave"
    scanned = "period_mm"
    signature = Signature(
        cause="A guide, chain or rolling element that repeats with travel.",
        looks_like="The straightness of an axis waves with a steady period.",
        remedy="Check guide and rolling elements; compensate straightness finely.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each axis and direction across it."""
        usual = np.full(2, USUAL_MM)
        return [
            Candidate(
                self.name,
                {"axis": axis.name, "direction": d},
                PositionWave(axis, d, 20.0),
                usual,
                20.0,
            )
            for axis in at.machine.linear_axes
            for d in LINEAR
            if d != axis.name and is_resolved(at, axis.name, _LONGEST_MM)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Return periods at equal steps of waves, four to one over the travel."""
        axis = candidate.keys["axis"]
        waves = wave_numbers(at, axis, _SHORTEST_MM, _LONGEST_MM)
        return Scan(self.scanned, 1.0 / waves[::-1])

    def wave(self, candidate: Candidate, at: Conditions) -> Wave:
        """Return the scan as a wave of the position."""
        axis = candidate.keys["axis"]
        unit = np.eye(3)[DIRECTION[candidate.keys["direction"]]]
        return Wave(
            np.tile(unit, (len(at), 1)),
            at.axis_mm(axis),
            rate_of(at, axis),
            1.0 / self.scan(candidate, at).values,
        )

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        """Return the effect as a model file states it."""
        axis = machine.linear(keys["axis"])
        return PositionWave(axis, keys["direction"], numbers[self.scanned])

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "2"],
        covariance: Float64[np.ndarray, "2 2"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return period and amplitude."""
        return measured_wave(self.scanned, candidate, theta, covariance, value_sigma)

    def depends_on(self, candidate: Candidate) -> list[str]:
        """Return the axis."""
        return [candidate.keys["axis"]]

    def told(self, candidate: Candidate, found: Mapping[str, Measured]) -> str:
        """Return axis, direction, period and amplitude."""
        axis, direction = candidate.keys["axis"], candidate.keys["direction"]
        return (
            f"a wave along {axis} in the direction of {direction} with "
            f"a period of {found['period_mm'].value:.3g} mm and an amplitude of "
            f"{found['amplitude_um'].value:.2g} µm"
        )
