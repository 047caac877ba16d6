"""A periodic motion in time at 1 Hz or faster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role, along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Scan,
    Signature,
    Wave,
)
from app.kinematics.effects.sinusoid import (
    measured_wave,
    sine_and_cosine,
    wave_of_time,
    waves,
    waves_of_cells,
)
from app.kinematics.symbols import LINEAR

_SLOWEST_HZ = 1.0
_FASTEST = 0.45  # of the tracker's rate


@dataclass(frozen=True)
class Vibration(Effect):
    """Sine and cosine in time, in one direction.

    middle_s : of the run, where the phase is 0: so it does not turn with the frequency
    """

    direction: str
    frequency_hz: float
    middle_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"vibration-{self.direction}-{self.frequency_hz:.5g}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.MEASUREMENT

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sine and cosine, in mm."""
        return sine_and_cosine(self.name, "mm")

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves, averaged over each cell."""
        rate = np.full(len(at), 2.0 * np.pi * self.frequency_hz)
        return along(self.direction, waves_of_cells(self._angle(at.time_s), rate, at))

    def in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        return along(self.direction, waves(self._angle(time_s)))

    def _angle(self, time_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        return 2.0 * np.pi * self.frequency_hz * (time_s - self.middle_s)


class VibrationFamily(Family):
    """Every direction, the frequency scanned as far as the samples can follow."""

    name = "vibration"
    scanned = "frequency_hz"
    in_machine = False
    signature = Signature(
        cause="A pump, a fan, a drive or the floor shakes table, spindle or tracker.",
        looks_like="A wave in time of one frequency, the same whatever axis moves.",
        remedy="Find what turns at this frequency and stop or isolate it; check the "
        "tracker's stand.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction."""
        if at.recorded is None:
            return []
        middle_s = 0.5 * float(at.time_s.min() + at.time_s.max())
        return [
            Candidate(
                self.name,
                {"direction": direction},
                Vibration(direction, _SLOWEST_HZ, middle_s),
                np.full(2, USUAL_MM),
                _SLOWEST_HZ,
            )
            for direction in LINEAR
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return frequencies, two to a period over the run."""
        if at.recorded is None:
            return None
        fastest = _FASTEST * at.machine.tracker.rate_hz
        step = 0.5 / max(float(np.ptp(at.time_s)), 1.0)
        return Scan(self.scanned, np.arange(_SLOWEST_HZ, fastest, step))

    def wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave of time."""
        scan = self.scan(candidate, at)
        if scan is None or at.recorded is None:
            return None
        return wave_of_time(candidate.keys["direction"], at, scan.values)

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "2"],
        covariance: Float64[np.ndarray, "2 2"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return frequency and amplitude."""
        return measured_wave(self.scanned, candidate, theta, covariance, value_sigma)
