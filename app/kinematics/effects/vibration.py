"""A periodic motion in time at 1 Hz or faster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.kinematics.effects.base import Conditions, Effect, Parameter
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Scan,
    Signature,
    Wave,
    averaged,
)
from app.kinematics.effects.sinusoid import measured_wave, sine_and_cosine
from app.kinematics.symbols import DIRECTION, LINEAR

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
    def parameters(self) -> tuple[Parameter, ...]:
        """Sine and cosine, in mm."""
        return sine_and_cosine(self.name, "mm")

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves, averaged over each cell."""
        columns = self.in_time(at.time_s)
        if at.around is not None:
            turn = 2.0 * np.pi * self.frequency_hz
            span = at.around.span_s
            columns *= averaged(np.full(len(span), turn), span)[:, None, None]
        return columns

    def in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        angle = 2.0 * np.pi * self.frequency_hz * (time_s - self.middle_s)
        wave = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        unit = np.eye(3)[DIRECTION[self.direction]]
        return unit[None, :, None] * wave[:, None, :]


class VibrationFamily(Family):
    """Every direction, the frequency scanned as far as the samples can follow."""

    name = "vibration"
    in_machine = False
    signature = Signature(
        cause="A pump, a fan, a drive or the floor shakes table, spindle or tracker.",
        looks_like="A wave in time of one frequency, the same whatever axis moves.",
        remedy="Find what turns at this frequency and stop or isolate it; check the "
        "tracker's stand.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction."""
        if at.around is None:
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
        if at.around is None:
            return None
        fastest = _FASTEST * at.machine.tracker.rate_hz
        step = 0.5 / max(float(np.ptp(at.time_s)), 1.0)
        return Scan("frequency_hz", np.arange(_SLOWEST_HZ, fastest, step))

    def wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave of time."""
        scan = self.scan(candidate, at)
        if scan is None or at.around is None:
            return None
        unit = np.eye(3)[DIRECTION[candidate.keys["direction"]]]
        arm = np.tile(unit, (len(at), 1))
        return Wave(arm, at.time_s, np.ones(len(at)), scan.values)

    def at_value(self, candidate: Candidate, at: Conditions, value: float) -> Candidate:
        """Return the candidate of another frequency."""
        effect = candidate.effect
        if isinstance(effect, Vibration):
            effect = replace(effect, frequency_hz=value)
        return replace(candidate, effect=effect, value=value)

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "2"],
        covariance: Float64[np.ndarray, "2 2"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return frequency and amplitude."""
        return measured_wave("frequency_hz", candidate, theta, covariance, value_sigma)
