"""Periodic errors along an axis: of screw, gear or scale, and across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.error_motion import find_arm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    Wave,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS, DIRECTION, ROTARY_AXIS
from truepath.kinematics.effects.sinusoid import (
    Sinusoid,
    SinusoidFamily,
)
from truepath.kinematics.machine.machine import Axis, LinearAxis, RotaryAxis
from truepath.kinematics.machine.symbols import LINEAR

_SECOND = 0.2  # typical share of the second harmonic
_USUAL_RAD = 2e-5
_FEWEST_PLACES = 12  # fewer fit any wave


@dataclass(frozen=True)
class ScrewCyclic(Sinusoid):
    """Positioning of an axis as sin and cos of its position, twice: lead and half lead.

    The error of a screw turn is hardly ever a pure sine.
    """

    kind = "screw-cyclic"
    units = dict.fromkeys(("sin", "cos", "sin2", "cos2"), "mm")
    harmonics = (1, 2)
    period_name = "lead_mm"
    axis: LinearAxis
    lead_mm: float

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Wave of the axis' position in mm."""
        return _make_wave(f"E{self.axis.name}{self.axis.name}", at, waves)


@dataclass(frozen=True)
class GearCyclic(Sinusoid):
    """Positioning of a rotary axis as sine and cosine of its angle over a period."""

    kind = "gear-cyclic"
    units = dict.fromkeys(("sin", "cos"), "rad")
    period_name = "period_deg"
    axis: RotaryAxis
    period_deg: float

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Wave of the axis' angle in deg."""
        return _make_wave(f"E{self.axis.name}{self.axis.name}", at, waves)


@dataclass(frozen=True)
class PositionWave(Sinusoid):
    """Sine and cosine of an axis' position, across the axis."""

    kind = "position-wave"
    role = Role.STRUCTURE
    period_name = "period_mm"
    axis: LinearAxis
    direction: str
    period_mm: float

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Wave of the axis' position in mm."""
        return _make_wave(f"E{self.direction}{self.axis.name}", at, waves)


def _make_wave(symbol: str, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
    name = symbol[2]
    rate = np.abs(at.axis_rate(name))
    return Wave(find_arm(symbol, at), at.axis_mm(name), rate, waves)


class _FamilyOfAxes(SinusoidFamily):
    shortest: ClassVar[float]
    longest: ClassVar[float]

    def is_resolved(self, axis: Axis, at: Conditions) -> bool:
        places = np.unique(np.round(at.axis_mm(axis.name)))
        travel = float(np.ptp(places))
        return len(places) >= _FEWEST_PLACES and travel > 2.0 * self.longest

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        # In a further Run the axis may not move.
        travel = float(np.ptp(at.axis_mm(candidate.keys["axis"])))
        step = 0.25 / max(travel, self.longest)
        return np.arange(1.0 / self.longest, 1.0 / self.shortest, step)


class ScrewCyclicFamily(_FamilyOfAxes):
    """One candidate per linear axis, the lead scanned."""

    name = "screw-cyclic"
    value_name = "lead_mm"
    numbers = ("lead_mm",)
    shortest, longest = 2.5, 45.0
    effect = ScrewCyclic
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
        """One per linear axis that resolves waves."""
        usual = USUAL_MM * np.array([1.0, 1.0, _SECOND, _SECOND])
        axes = [a for a in at.machine.linear_axes if self.is_resolved(a, at)]
        return [self.make_candidate(ScrewCyclic(axis, 10.0), usual) for axis in axes]


class GearCyclicFamily(_FamilyOfAxes):
    """One candidate per rotary axis, the period scanned.

    An error that repeats once or a few times per turn, as of an eccentric ring scale,
    is part of the axis' positioning in every model.
    """

    name = "gear-cyclic"
    value_name = "period_deg"
    numbers = ("period_deg",)
    shortest, longest = 3.0, 30.0
    amplitude = ("amplitude_urad", 1e6)
    effect = GearCyclic
    keys = {"axis": ROTARY_AXIS}
    words = read_words("""
        [en]
        title = Cyclic error of gear or ring scale
        cause = A worm or pinion that errs alike every turn, or a ring scale that errs
            within its pitch.
        looks_like = A wave in the angle of a rotary axis, the same at every speed, with
            the angle of one worm turn or tooth as its period.
        remedy = Enter a cyclic compensation for the axis; look at the worm's bearing
            and mesh, or at the scale's head.
        [de]
        title = Zyklischer Fehler von Getriebe oder Ringmaßstab
        cause = Eine Schnecke oder ein Ritzel, das bei jeder Umdrehung gleich irrt, oder
            ein Ringmaßstab, der innerhalb seiner Teilung irrt.
        looks_like = Eine Welle im Winkel einer Drehachse, bei jeder Drehzahl gleich,
            mit dem Winkel einer Schneckenumdrehung oder eines Zahns als Periode.
        remedy = Für die Achse eine zyklische Kompensation eintragen; Lager und Eingriff
            der Schnecke oder den Abtastkopf ansehen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per rotary axis that resolves waves."""
        axes = [a for a in at.machine.rotary_axes if self.is_resolved(a, at)]
        return [
            self.make_candidate(GearCyclic(axis, 5.0), [_USUAL_RAD] * 2)
            for axis in axes
        ]


class PositionWaveFamily(_FamilyOfAxes):
    """One candidate per axis and direction across it, the period scanned."""

    name = "position-wave"
    value_name = "period_mm"
    numbers = ("period_mm",)
    shortest, longest = 4.0, 60.0
    effect = PositionWave
    keys = {"axis": replace(AXIS, phrase="({})"), "direction": DIRECTION}
    covariates = ("{axis}",)
    sentence = (
        "a wave along {axis} in the direction of {direction} with a period of "
        "{period_mm:.3g} mm and an amplitude of {amplitude_um:.2g} µm"
    )
    words = read_words("""
        [en]
        title = Wave along an axis
        cause = A guide, chain or rolling element that repeats with travel.
        looks_like = The straightness of an axis waves with a steady period.
        remedy = Check guide and rolling elements; compensate straightness finely.
        [de]
        title = Welle entlang einer Achse
        cause = Eine Führung, eine Kette oder ein Wälzkörper, der sich mit dem Weg
            wiederholt.
        looks_like = Die Geradheit der Achse schwankt mit fester Periode.
        remedy = Führung und Wälzkörper prüfen; Geradheit fein kompensieren.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per axis that resolves waves and direction across it."""
        return [
            self.make_candidate(PositionWave(axis, direction, 20.0), [USUAL_MM] * 2)
            for axis in at.machine.linear_axes
            for direction in LINEAR
            if direction != axis.name and self.is_resolved(axis, at)
        ]
