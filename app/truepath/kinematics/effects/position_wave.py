"""Periodic errors along an axis: of screw, gear or scale, and across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.error_motion import compute_arm, reference_position_mm
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
    WaveFamily,
    sine_and_cosine,
)
from truepath.kinematics.machine.machine import Axis, RotaryAxis
from truepath.kinematics.machine.symbols import LINEAR

_TYPICAL_RAD = 2e-5
_LEAST_TURN_DEG = 180.0  # over less, one wave per turn looks like any bend


class AxisWave(Sinusoid):
    """A wave of the position of an axis, mm or deg."""

    axis: Axis

    @property
    def symbol(self) -> str:
        """Of the error motion that it is part of: the axis' positioning by default."""
        return f"E{self.axis.name}{self.axis.name}"

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        name = self.axis.name
        rate = np.abs(at.axis_rate(name))
        return Wave(compute_arm(self.symbol, at), at.axis_mm(name), rate, waves)


@dataclass(frozen=True)
class ScrewCyclic(AxisWave):
    """Positioning of an axis as sin and cos of its position, twice: lead and half lead.

    The error of a screw turn is hardly ever a pure sine.
    """

    kind = "screw-cyclic"
    units = dict.fromkeys(("sin", "cos", "sin2", "cos2"), "mm")
    harmonics = (1, 2)
    period_name = "lead_mm"
    axis: Axis
    lead_mm: float


@dataclass(frozen=True)
class GearCyclic(AxisWave):
    """Positioning of a rotary axis as sine and cosine of its angle over a period."""

    kind = "gear-cyclic"
    units = dict.fromkeys(("sin", "cos"), "rad")
    period_name = "period_deg"
    axis: Axis
    period_deg: float


@dataclass(frozen=True)
class PositionWave(AxisWave):
    """Sine and cosine of an axis' position, across the axis."""

    kind = "position-wave"
    role = Role.STRUCTURE
    period_name = "period_mm"
    axis: Axis
    direction: str
    period_mm: float

    @property
    def symbol(self) -> str:
        return f"E{self.direction}{self.axis.name}"


class AxisWaveFamily(SinusoidFamily):
    """Waves of axes. shortest, longest : period, mm or deg"""

    shortest: ClassVar[float]
    longest: ClassVar[float]

    def is_resolved(self, axis: Axis, at: Conditions) -> bool:
        positions = np.unique(np.round(at.axis_mm(axis.name)))
        travel = float(np.ptp(positions))
        # Fewer positions fit any wave.
        return len(positions) >= 12 and travel > 2.0 * self.longest

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        # In a further Run the axis may not move.
        travel = float(np.ptp(at.axis_mm(candidate.keys["axis"])))
        step = 0.25 / max(travel, self.longest)
        return np.arange(1.0 / self.longest, 1.0 / self.shortest, step)


class ScrewCyclicFamily(AxisWaveFamily):
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
        typical = USUAL_MM * np.array([1.0, 1.0, 0.2, 0.2])
        axes = [a for a in at.machine.linear_axes if self.is_resolved(a, at)]
        return [self.make_candidate(ScrewCyclic(axis, 10.0), typical) for axis in axes]


class GearCyclicFamily(AxisWaveFamily):
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
        axes = [a for a in at.machine.rotary_axes if self.is_resolved(a, at)]
        return [
            self.make_candidate(GearCyclic(axis, 5.0), [_TYPICAL_RAD] * 2)
            for axis in axes
        ]


class PositionWaveFamily(AxisWaveFamily):
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
        return [
            self.make_candidate(PositionWave(axis, direction, 20.0), [USUAL_MM] * 2)
            for axis in at.machine.linear_axes
            for direction in LINEAR
            if direction != axis.name and self.is_resolved(axis, at)
        ]


@dataclass(frozen=True)
class RotaryEccentricity(Effect):
    """A ring scale, or its coupling, off the axis: one wave per turn, 0 at its zero.

    The rigid-body model has it in the axis' own positioning. As a family, it is an
    eccentricity that the model in use does not have, or that has changed since.
    """

    kind = "rotary-eccentricity"
    units = dict.fromkeys(("sin", "cos"), "rad")
    axis: RotaryAxis

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        name = self.axis.name
        zero = np.array([reference_position_mm(self.axis)])
        waves = sine_and_cosine(np.radians(at.axis_mm(name)))
        waves = waves - sine_and_cosine(np.radians(zero))
        return columns_along(compute_arm(f"E{name}{name}", at), waves)


class RotaryEccentricityFamily(WaveFamily):
    """One candidate per rotary axis that turns far enough."""

    name = "rotary-eccentricity"
    is_rigid_body = True
    varies_with = "place"
    amplitude = ("amplitude_urad", 1e6)
    effect = RotaryEccentricity
    keys = {"axis": ROTARY_AXIS}
    words = read_words("""
        [en]
        title = Eccentricity
        cause = The ring scale or its coupling sits off the axis: as mounted, after a
            crash, or because it was exchanged.
        looks_like = A wave in the angle of a rotary axis, once a turn.
        remedy = Enter the wave in the axis' positioning table; centre the scale, or
            read it with two heads.
        [de]
        title = Exzentrizität
        cause = Der Ringmaßstab oder seine Kupplung sitzt neben der Achse: seit dem
            Einbau, nach einem Aufprall oder einem Tausch.
        looks_like = Eine Welle im Winkel einer Drehachse, einmal je Umdrehung.
        remedy = Die Welle in die Positioniertabelle der Achse eintragen; den Maßstab
            zentrieren oder mit zwei Köpfen ablesen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        axes = [
            axis
            for axis in at.machine.rotary_axes
            if np.ptp(at.axis_mm(axis.name)) >= _LEAST_TURN_DEG
        ]
        return [
            self.make_candidate(RotaryEccentricity(axis), [_TYPICAL_RAD] * 2)
            for axis in axes
        ]
