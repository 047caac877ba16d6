"""A positioning error that repeats with every turn of the ball screw or scale pitch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.catalogue import USUAL_MM, Candidate, Wave, read_words
from app.kinematics.effects.error_motion import find_arm
from app.kinematics.effects.keys import AXIS
from app.kinematics.effects.sinusoid import (
    Sinusoid,
    SinusoidFamily,
    is_resolved,
    list_wave_numbers,
)
from app.kinematics.machine import LinearAxis

_SHORTEST_MM, _LONGEST_MM = 2.5, 45.0
_SECOND = 0.2  # usual share of the second harmonic


@dataclass(frozen=True)
class ScrewCyclic(Sinusoid):
    """Positioning of an axis as sin and cos of its position over a lead and half of it.

    A screw that errs every turn hardly does so as a pure sine.
    """

    kind = "screw-cyclic"
    units = dict.fromkeys(("sin", "cos", "sin2", "cos2"), "mm")
    harmonics = (1, 2)
    axis: LinearAxis
    lead_mm: float

    @property
    def wave_number(self) -> float:
        """Waves a millimetre."""
        return 1.0 / self.lead_mm

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Return the wave of the axis' position."""
        name = self.axis.name
        arm = find_arm(f"E{name}{name}", at)
        return Wave(arm, at.axis_mm(name), np.abs(at.axis_rate(name)), waves)


class ScrewCyclicFamily(SinusoidFamily):
    """Candidates of every straight axis, the lead scanned."""

    name = "screw-cyclic"
    value_name = "lead_mm"
    numbers = ("lead_mm",)
    makes = ScrewCyclic
    keys = {"axis": AXIS}
    words = read_words("""
        [en]
        title = Cyclic error of screw or scale
        cause = A ball screw, its bearing or a scale that errs alike every turn.
        looks_like = A wave along one axis, the same at every feed, with the period of
            the screw's lead or of the scale's pitch.
        remedy = Enter a cyclic compensation for the axis; look at the screw's thrust
            bearing and coupling, or at the scale's head.
        [de]
        title = Zyklischer Fehler von Spindel oder Maßstab
        cause = Eine Kugelgewindespindel, ihr Lager oder ein Maßstab, der bei jeder
            Umdrehung gleich irrt.
        looks_like = Eine Welle entlang einer Achse, bei jedem Vorschub gleich, mit der
            Steigung der Spindel oder der Teilung des Maßstabs als Periode.
        remedy = Für die Achse eine zyklische Kompensation eintragen; Axiallager und
            Kupplung der Spindel oder den Abtastkopf des Maßstabs ansehen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one an axis."""
        usual = USUAL_MM * np.array([1.0, 1.0, _SECOND, _SECOND])
        return [
            self.offer(ScrewCyclic(axis, 10.0), usual)
            for axis in at.machine.linear_axes
            if is_resolved(at, axis.name, _LONGEST_MM)
        ]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Return turns, four steps to one over the travel."""
        axis = candidate.keys["axis"]
        return list_wave_numbers(at, axis, _SHORTEST_MM, _LONGEST_MM)
