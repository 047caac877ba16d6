"""A positioning error that repeats with every turn of the ball screw or scale pitch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    Wave,
    Words,
    find_speed,
)
from app.kinematics.effects.error_motion import find_arm
from app.kinematics.effects.keys import AXIS
from app.kinematics.effects.sinusoid import (
    average_over_cells,
    is_resolved,
    list_wave_numbers,
    state_wave,
)
from app.kinematics.machine import LinearAxis

_SHORTEST_MM, _LONGEST_MM = 2.5, 45.0
_SECOND = 0.2  # usual share of the second harmonic


@dataclass(frozen=True)
class ScrewCyclic(Effect):
    """Positioning of an axis as sin and cos of its position over a lead and half of it.

    A screw that errs every turn hardly does so as a pure sine.
    """

    kind = "screw-cyclic"
    units = dict.fromkeys(("sin", "cos", "sin2", "cos2"), "mm")
    axis: LinearAxis
    lead_mm: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 4"]:
        """Return the axis' direction times the waves, averaged over each cell."""
        name, turn = self.axis.name, 2.0 * np.pi / self.lead_mm
        angle, rate = turn * at.axis_mm(name), turn * find_speed(at, name)
        waves = [average_over_cells(k * angle, k * rate, at) for k in (1, 2)]
        arm = find_arm(f"E{name}{name}", at)
        return arm[:, :, None] * np.concatenate(waves, axis=1)[:, None, :]


class ScrewCyclicFamily(Family):
    """Candidates of every straight axis, the lead scanned."""

    name = "screw-cyclic"
    scanned = "lead_mm"
    numbers = ("lead_mm",)
    makes = ScrewCyclic
    keys = {"axis": AXIS}
    words = {
        "en": Words(
            title="Cyclic error of screw or scale",
            cause="A ball screw, its bearing or a scale that errs alike every turn.",
            looks_like="A wave along one axis, the same at every feed, with the "
            "period of the screw's lead or of the scale's pitch.",
            remedy="Enter a cyclic compensation for the axis; look at the screw's "
            "thrust bearing and coupling, or at the scale's head.",
        ),
        "de": Words(
            title="Zyklischer Fehler von Spindel oder Maßstab",
            cause="Eine Kugelgewindespindel, ihr Lager oder ein Maßstab, der bei "
            "jeder Umdrehung gleich irrt.",
            looks_like="Eine Welle entlang einer Achse, bei jedem Vorschub gleich, "
            "mit der Steigung der Spindel oder der Teilung des Maßstabs als Periode.",
            remedy="Für die Achse eine zyklische Kompensation eintragen; Axiallager "
            "und Kupplung der Spindel oder den Abtastkopf des Maßstabs ansehen.",
        ),
    }

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one an axis."""
        usual = USUAL_MM * np.array([1.0, 1.0, _SECOND, _SECOND])
        return [
            self.offer(ScrewCyclic(axis, 10.0), usual, 10.0)
            for axis in at.machine.linear_axes
            if is_resolved(at, axis.name, _LONGEST_MM)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Return leads at equal steps of turns, four to a period over the travel."""
        axis = candidate.keys["axis"]
        turns = list_wave_numbers(at, axis, _SHORTEST_MM, _LONGEST_MM)
        return Scan(self.scanned, 1.0 / turns[::-1])

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave:
        """Return the scan as a wave of the position."""
        axis = candidate.keys["axis"]
        return Wave(
            find_arm(f"E{axis}{axis}", at),
            at.axis_mm(axis),
            find_speed(at, axis),
            1.0 / self.scan(candidate, at).values,
        )

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return lead, amplitude and phase at the axis zero."""
        return state_wave(self.scanned, found)
