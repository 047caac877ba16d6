"""An encoder circle of the tracker that is off the axis it measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role
from app.kinematics.effects.catalogue import (
    Candidate,
    Family,
    Measured,
    Signature,
)
from app.kinematics.effects.sinusoid import amplitude_and_phase, sine_and_cosine

_USUAL_RAD = 2e-5
CIRCLES = ("azimuth", "elevation")


@dataclass(frozen=True)
class TrackerEccentricity(Effect):
    """The measured angle errs as sin and cos of itself, once a turn."""

    circle: str

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"tracker-eccentricity-{self.circle}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.MEASUREMENT

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sine and cosine, in rad."""
        return sine_and_cosine(self.name, "rad")

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return how the target seems to move in the frame the tracker stands on."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 2))
        x, y, z = at.recorded.tracker_mm.T
        flat = np.hypot(x, y)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, flat)
        if self.circle == "azimuth":
            angle = azimuth
            moved = np.stack([-y, x, np.zeros_like(x)], axis=1)
        else:
            angle = elevation
            moved = np.stack([-z * np.cos(azimuth), -z * np.sin(azimuth), flat], axis=1)
        wave = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        return (moved @ at.recorded.rotation)[:, :, None] * wave[:, None, :]


class TrackerEccentricityFamily(Family):
    """Both circles."""

    name = "tracker-eccentricity"
    in_machine = False
    signature = Signature(
        cause="The encoder circle of the tracker sits off its axis, or was shaken.",
        looks_like="Points are turned about the tracker by an angle that follows a "
        "sine of the direction looked in, whatever axis moves.",
        remedy="Run the tracker's own compensation (two-face and circle tests); "
        "measure from a second place to separate it from the machine.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a circle."""
        if at.recorded is None:
            return []
        return [
            Candidate(
                self.name,
                {"circle": circle},
                TrackerEccentricity(circle),
                np.full(2, _USUAL_RAD),
            )
            for circle in CIRCLES
        ]

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "2"],
        covariance: Float64[np.ndarray, "2 2"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return amplitude and phase."""
        amplitude, phase = amplitude_and_phase(theta, covariance)
        urad = Measured(amplitude.value * 1e6, amplitude.uncertainty * 1e6)
        return {"amplitude_urad": urad, "phase_rad": phase}
