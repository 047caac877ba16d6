"""Effects that are a sine and a cosine of one coordinate, and their families."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, columns_along
from truepath.kinematics.effects.family import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    Wave,
)


class Sinusoid(Effect):
    """Sine and cosine of 2π coordinate · waves along an arm, averaged over each cell.

    harmonics : multiples of the waves, a sine and a cosine each
    period_name : of the field that holds the period
    """

    units = {"sin": "mm", "cos": "mm"}
    harmonics: ClassVar[tuple[int, ...]] = (1,)
    period_name: ClassVar[str]

    @property
    def wave_number(self) -> float:
        """Waves per unit of the coordinate."""
        return 1.0 / float(getattr(self, self.period_name))

    @property
    def origin(self) -> float:
        """The coordinate where the phase is 0."""
        return 0.0

    @abstractmethod
    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Its wave with other wave numbers."""

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        wave = self.make_wave(at, np.array([self.wave_number]))
        turn = 2.0 * np.pi * self.wave_number
        angle, turned = turn * (wave.coordinate - self.origin), turn * wave.rate
        columns = [
            sine_and_cosine(k * angle) * attenuate_wave(k * turned, at.span_s)[:, None]
            for k in self.harmonics
        ]
        return columns_along(wave.arm, np.concatenate(columns, axis=1))


class WaveFamily(Family):
    """Effects whose first two parameters are a sine and a cosine.

    amplitude : its name in files, and the factor from the inside unit
    """

    amplitude: ClassVar[tuple[str, float]] = ("amplitude_um", 1e3)

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        size, phase = compute_amplitude_and_phase(
            found.theta[:2], found.covariance[:2, :2]
        )
        name, factor = self.amplitude
        scanned = {self.value_name: found.value} if self.value_name else {}
        return {**scanned, name: size.scale(factor), "phase_rad": phase}


class SinusoidFamily(WaveFamily):
    """Sinusoids whose waves are scanned.

    scans_periods : the scanned value is a period; else a frequency
    """

    scans_periods: ClassVar[bool] = True

    @abstractmethod
    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Wave numbers at equal steps; empty where there is nothing to scan."""

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        waves = self.list_waves(candidate, at)
        values = 1.0 / waves[::-1] if self.scans_periods else waves
        return Scan(self.value_name, values) if len(values) else None

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        scan = self.scan(candidate, at)
        if scan is None or not isinstance(candidate.effect, Sinusoid):
            return None
        waves = 1.0 / scan.values if self.scans_periods else scan.values
        return candidate.effect.make_wave(at, waves)


def sine_and_cosine(angle: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Columns, (n, 2)."""
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def attenuate_wave(
    angular_rate: Float64[np.ndarray, " n"], span_s: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Factor left of a wave after averaging it over each span: a sinc."""
    return np.sinc(angular_rate * span_s / (2.0 * np.pi))


def compute_amplitude_and_phase(
    theta: Float64[np.ndarray, "2"], covariance: Float64[np.ndarray, "2 2"]
) -> tuple[Quantity, Quantity]:
    """Amplitude and phase of θ₀ sin + θ₁ cos = amplitude sin(… + phase).

    To second order (GUM 5.1.2, note): where the phase is poorly known, so is the
    amplitude.
    """
    amplitude = max(float(np.hypot(theta[0], theta[1])), 1e-300)
    along = theta / amplitude
    across = np.array([-along[1], along[0]])
    phase = float(np.mod(np.arctan2(theta[1], theta[0]), 2.0 * np.pi))
    radial, turned = along @ covariance @ along, across @ covariance @ across
    both = along @ covariance @ across
    bent = turned / amplitude
    size = np.sqrt(radial + 0.5 * bent**2)
    turn = np.sqrt(turned + (radial * turned + both**2) / amplitude**2) / amplitude
    return Quantity(amplitude, float(size)), Quantity(phase, float(turn))
