"""What air does to a tracker: its scale drifts, its beam bends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Role
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from app.kinematics.effects.tracker_error import BeamBending

AIR = "air"  # name of the sensor
_USUAL_PER_K = 1e-6  # refractive index of air
_FEWEST_KELVIN = 0.1


@dataclass(frozen=True)
class ScaleByAir(Effect):
    """Every distance is too long in proportion to the change of the air sensor."""

    kind = "tracker-scale-by-air"
    role = Role.MEASUREMENT
    units = {"": "1/K"}
    start_degc: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the beam times the change."""
        celsius = read_air_degc(at)
        if celsius is None:
            return np.zeros((len(at), 3, 1))
        return _lengthen(at, celsius - self.start_degc)


@dataclass(frozen=True)
class ScaleDrift(Effect):
    """Every distance grows evenly with time, in proportion to itself."""

    kind = "tracker-scale-drift"
    role = Role.MEASUREMENT
    units = {"": "1/s"}
    middle_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the beam times the time since the middle."""
        return _lengthen(at, at.time_s - self.middle_s)


def read_air_degc(at: Conditions) -> Float64[np.ndarray, " n"] | None:
    """Return the temperature of the air; None where no sensor tells it."""
    recorded = at.recorded
    if recorded is None or recorded.temperature_degc is None:
        return None
    if AIR not in recorded.sensors:
        return None
    return recorded.temperature_degc[:, recorded.sensors.index(AIR)]


def _lengthen(
    at: Conditions, by: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3 1"]:
    if at.recorded is None:
        return np.zeros((len(at), 3, 1))
    beam = at.recorded.tracker_mm @ at.recorded.rotation
    return (beam * by[:, None])[:, :, None]


class ScaleDriftFamily(Family):
    """One candidate: by the air's sensor where it has seen a change, else by time."""

    name = "tracker-scale-drift"
    varies_with = "time"
    role = Role.MEASUREMENT
    words = read_words("""
        [en]
        title = Drift of the tracker's scale
        cause = The air between tracker and machine warms or cools, and the tracker is
            not told: its wavelength changes by 1 ppm a kelvin.
        looks_like = All distances from the tracker grow evenly with time, the farther
            the more.
        remedy = Let the tracker's weather station measure the air near the beam; put
            the tracker close to the machine; let the hall settle.
        [de]
        title = Drift des Trackermaßstabs
        cause = Die Luft zwischen Tracker und Maschine wird wärmer oder kälter, und der
            Tracker erfährt es nicht: Seine Wellenlänge ändert sich um 1 ppm je Kelvin.
        looks_like = Alle Abstände vom Tracker wachsen gleichmäßig mit der Zeit, je
            weiter, desto mehr.
        remedy = Die Wetterstation des Trackers die Luft nahe am Strahl messen lassen;
            den Tracker nahe an die Maschine stellen; die Halle sich setzen lassen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return the drift."""
        if at.recorded is None:
            return []
        celsius = read_air_degc(at)
        if celsius is not None and np.ptp(celsius) > _FEWEST_KELVIN:
            first = float(celsius[np.argmin(at.time_s)])
            return [self.offer(ScaleByAir(first), [2.0 * _USUAL_PER_K])]
        span = max(float(np.ptp(at.time_s)), 1.0)
        length = float(np.linalg.norm(at.recorded.tracker_mm, axis=1).mean())
        middle = 0.5 * float(at.time_s.min() + at.time_s.max())
        return [self.offer(ScaleDrift(middle), [4.0 * USUAL_MM / (span * length)])]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return ppm by kelvin, or by second."""
        unit = "K" if isinstance(found.candidate.effect, ScaleByAir) else "s"
        return {f"rate_ppm_per_{unit}": found.parameters[0].scale(1e6)}


class BeamBendingFamily(Family):
    """One candidate."""

    name = "beam-bending"
    varies_with = "place"
    role = Role.MEASUREMENT
    stated = {"curvature_urad_per_m": 1e9}
    words = read_words("""
        [en]
        title = Bending of the beam
        cause = Air that is warmer above than below bends the beam of the tracker.
        looks_like = Points seem to lie higher, or lower, with the square of their
            distance from the tracker, whatever axis moves.
        remedy = Mix the air with fans; keep the beam short and away from warm surfaces;
            measure from a second place.
        [de]
        title = Krümmung des Strahls
        cause = Luft, die oben wärmer ist als unten, krümmt den Strahl des Trackers.
        looks_like = Punkte scheinen mit dem Quadrat ihres Abstands vom Tracker höher
            oder tiefer zu liegen, gleich welche Achse fährt.
        remedy = Die Luft mit Ventilatoren mischen; den Strahl kurz und von warmen
            Flächen fern halten; von einem zweiten Standort messen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return the curvature."""
        if at.recorded is None:
            return []
        square = 3.0 * float(np.mean(at.recorded.tracker_mm**2))
        return [self.offer(BeamBending(), [4.0 * USUAL_MM / square])]
