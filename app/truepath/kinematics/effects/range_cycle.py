"""Periodic error of the tracker's distance meter, along its beam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    Wave,
    read_words,
)
from truepath.kinematics.effects.sinusoid import Sinusoid, SinusoidFamily

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
        """The middle of the ranges, mm."""
        return self.middle_mm

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Wave of the range in mm."""
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
        del candidate
        span_mm = max(float(np.ptp(_measure_ranges_mm(at))), _SHORTEST)
        longest = min(_LONGEST, span_mm)
        return np.arange(1.0 / longest, 1.0 / _SHORTEST, 0.25 / span_mm)
