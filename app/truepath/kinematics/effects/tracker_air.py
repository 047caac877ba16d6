"""Errors along or across the beam: the tracker's scale drifts, air bends the beam, the
distance meter errs periodically.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Quantity,
    Wave,
    read_words,
)
from truepath.kinematics.effects.sinusoid import Sinusoid, SinusoidFamily
from truepath.kinematics.effects.tracker_error import (
    BeamEffect,
    BeamFamily,
    raise_beam,
)

AIR = "air"  # name of the sensor
_TYPICAL_PER_K = 1e-6  # refractive index of air
_FEWEST_KELVIN = 0.1


class ScaleError(BeamEffect):
    """The error of a distance is in proportion to it and to a growth in time."""

    @abstractmethod
    def growth(self, at: Conditions) -> Float64[np.ndarray, " n"]:
        """Growth since its start, in K or s."""

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        return recorded.tracker_mm

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n 1"]:
        return self.growth(at)[:, None]


@dataclass(frozen=True)
class ScaleByAir(ScaleError):
    """Every distance is too long in proportion to the air's temperature change."""

    kind = "tracker-scale-by-air"
    units = {"": "1/K"}
    start_degc: float

    def growth(self, at: Conditions) -> Float64[np.ndarray, " n"]:
        """Change in K since the start; 0 where no sensor measures it."""
        celsius = at.sensor_degc(AIR)
        return np.zeros(len(at)) if celsius is None else celsius - self.start_degc


@dataclass(frozen=True)
class ScaleDrift(ScaleError):
    """Every distance grows steadily with time, in proportion to itself."""

    kind = "tracker-scale-drift"
    units = {"": "1/s"}
    middle_s: float

    def growth(self, at: Conditions) -> Float64[np.ndarray, " n"]:
        return at.time_s - self.middle_s


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

    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
        celsius = at.sensor_degc(AIR)
        if celsius is not None and np.ptp(celsius) > _FEWEST_KELVIN:
            first = float(celsius[np.argmin(at.time_s)])
            return [self.make_candidate(ScaleByAir(first), [2.0 * _TYPICAL_PER_K])]
        span = max(float(np.ptp(at.time_s)), 1.0)
        length = float(np.linalg.norm(recorded.tracker_mm, axis=1).mean())
        typical = 4.0 * USUAL_MM / (span * length)
        return [self.make_candidate(ScaleDrift(at.middle_s), [typical])]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
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

    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
        square = 3.0 * float(np.mean(recorded.tracker_mm**2))
        return [self.make_candidate(BeamBending(), [4.0 * USUAL_MM / square])]


_SHORTEST, _LONGEST = 4.0, 300.0  # mm


@dataclass(frozen=True)
class RangeCycle(Sinusoid):
    """Sine and cosine of the range, along the beam; 0 without a recording.

    middle_mm : of the ranges, where the phase is 0, so that it hardly depends on the
        period
    """

    kind = "range-cycle"
    role = Role.MEASUREMENT
    period_name = "period_mm"
    period_mm: float
    middle_mm: float

    @property
    def origin(self) -> float:
        return self.middle_mm

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        if at.recorded is None:
            nothing = np.zeros((len(at), 3))
            return Wave(nothing, nothing[:, 0], nothing[:, 0], waves)
        range_mm = _measure_ranges_mm(at)
        beam = at.recorded.tracker_mm @ at.recorded.rotation / range_mm[:, None]
        rate = np.abs(np.einsum("ni,ni->n", beam, at.velocity_mm_s))
        return Wave(beam, range_mm, rate, waves)


def _measure_ranges_mm(at: Conditions) -> Float64[np.ndarray, " n"]:
    if at.recorded is None:
        return np.zeros(len(at))
    return np.linalg.norm(at.recorded.tracker_mm, axis=1)


class RangeCycleFamily(SinusoidFamily):
    """A single candidate, for any machine, the period scanned."""

    name = "range-cycle"
    effect = RangeCycle
    value_name = "period_mm"
    words = read_words("""
        [en]
        title = Cyclic error of the tracker's distance meter
        cause = Stray light or crosstalk in the tracker's distance meter, or a reflector
            that sends some of the light back twice.
        looks_like = A wave along the beam that follows the distance from the tracker,
            whatever axis moves and at every feed.
        remedy = Clean reflector and window of the tracker; have its distance meter
            checked; measure from a second place, whose distances differ.
        [de]
        title = Zyklischer Fehler des Distanzmessers im Tracker
        cause = Streulicht oder Übersprechen im Distanzmesser des Trackers, oder ein
            Reflektor, der einen Teil des Lichts zweimal zurückwirft.
        looks_like = Eine Welle längs des Strahls, die dem Abstand vom Tracker folgt,
            gleich welche Achse fährt und bei jedem Vorschub.
        remedy = Reflektor und Fenster des Trackers reinigen; seinen Distanzmesser
            prüfen lassen; von einem zweiten Standort messen, von dem aus die Abstände
            andere sind.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """None where the ranges are too alike for a wave."""
        range_mm = _measure_ranges_mm(at)
        if np.ptp(range_mm) <= 2.0 * _SHORTEST:
            return []
        cycle = RangeCycle(20.0, float(range_mm.mean()))
        return [self.make_candidate(cycle, [USUAL_MM] * 2)]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Waves from one over the ranges up, four steps to one."""
        span_mm = max(float(np.ptp(_measure_ranges_mm(at))), _SHORTEST)
        longest = min(_LONGEST, span_mm)
        return np.arange(1.0 / longest, 1.0 / _SHORTEST, 0.25 / span_mm)
