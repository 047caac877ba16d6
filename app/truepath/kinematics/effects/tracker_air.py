"""Effects of air on a tracker: its scale drifts, its beam bends."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.tracker_beam import (
    BeamEffect,
    BeamFamily,
    raise_beam,
)

AIR = "air"  # name of the sensor
_USUAL_PER_K = 1e-6  # refractive index of air
_FEWEST_KELVIN = 0.1


class ScaleError(BeamEffect):
    """The error of a distance is in proportion to it and to a growth in time."""

    @abstractmethod
    def growth(self, at: Conditions) -> Float64[np.ndarray, " n"]:
        """Growth since its start, in K or s."""

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """The beam, mm."""
        return recorded.tracker_mm

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n 1"]:
        """Growth, for the one parameter."""
        del recorded
        return self.growth(at)[:, None]


@dataclass(frozen=True)
class ScaleByAir(ScaleError):
    """Every distance is too long in proportion to the air's temperature change."""

    kind = "tracker-scale-by-air"
    units = {"": "1/K"}
    start_degc: float

    def growth(self, at: Conditions) -> Float64[np.ndarray, " n"]:
        """Change in K since the start; 0 where no sensor measures it."""
        celsius = read_air_degc(at)
        return np.zeros(len(at)) if celsius is None else celsius - self.start_degc


@dataclass(frozen=True)
class ScaleDrift(ScaleError):
    """Every distance grows steadily with time, in proportion to itself."""

    kind = "tracker-scale-drift"
    units = {"": "1/s"}
    middle_s: float

    def growth(self, at: Conditions) -> Float64[np.ndarray, " n"]:
        """Time since the middle, s."""
        return at.time_s - self.middle_s


def read_air_degc(at: Conditions) -> Float64[np.ndarray, " n"] | None:
    """Air temperature, °C; None where no sensor measures it."""
    recorded = at.recorded
    if recorded is None or recorded.temperature_degc is None:
        return None
    if AIR not in recorded.sensors:
        return None
    return recorded.temperature_degc[:, recorded.sensors.index(AIR)]


class ScaleDriftFamily(BeamFamily):
    """One candidate: by the air's sensor if that has changed, else by time."""

    name = "tracker-scale-drift"
    effect = ScaleDrift
    varies_with = "time"
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

    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """A single candidate."""
        celsius = read_air_degc(at)
        if celsius is not None and np.ptp(celsius) > _FEWEST_KELVIN:
            first = float(celsius[np.argmin(at.time_s)])
            return [self.make_candidate(ScaleByAir(first), [2.0 * _USUAL_PER_K])]
        span = max(float(np.ptp(at.time_s)), 1.0)
        length = float(np.linalg.norm(recorded.tracker_mm, axis=1).mean())
        usual = 4.0 * USUAL_MM / (span * length)
        return [self.make_candidate(ScaleDrift(at.middle_s), [usual])]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """In ppm per K, or per s."""
        unit = "K" if isinstance(found.candidate.effect, ScaleByAir) else "s"
        return {f"rate_ppm_per_{unit}": found.parameters[0].scale(1e6)}


@dataclass(frozen=True)
class BeamBending(BeamEffect):
    """The beam bends up or down, as in air that is warmer above than below.

    Its parameter is the curvature of a level beam, rad per mm.
    """

    kind = "beam-bending"
    units = {"": "1/mm"}

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Apparent rise of the target, with the square of its distance."""
        flat = np.linalg.norm(recorded.tracker_mm[:, :2], axis=1, keepdims=True)
        return 0.5 * flat * raise_beam(recorded)


class BeamBendingFamily(BeamFamily):
    """A single candidate, for any machine."""

    name = "beam-bending"
    effect = BeamBending
    varies_with = "place"
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

    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """A single candidate."""
        del at
        square = 3.0 * float(np.mean(recorded.tracker_mm**2))
        return [self.make_candidate(BeamBending(), [4.0 * USUAL_MM / square])]
