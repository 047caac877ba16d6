"""Error motions that depend on the direction of approach: backlash and its kin.

The error is E + h on the way up, E − h on the way down. The 2023 paper leaves both ways
of modelling h to the future: one number an error motion (14 of them with one target),
or tables of both directions. Here h is a constant, and for tables a spline besides. As
families, it is the lost motion of an axis in its own direction, and across it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import (
    Effect,
    ErrorCurve,
    QuadraticPrior,
    Role,
    columns_along,
)
from truepath.kinematics.effects.error_motion import (
    compute_arm,
    get_typical_size,
)
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    read_words,
)
from truepath.kinematics.effects.keys import ANY_AXIS, AXIS, DIRECTION, MOTION
from truepath.kinematics.machine.machine import Axis, LinearAxis, Machine
from truepath.kinematics.machine.symbols import (
    is_positioning,
    is_turn,
    list_error_motions,
)
from truepath.kinematics.splines import CubicSpline, natural_spline

_INTERVALS = 5  # h changes slowly along an axis
_TYPICAL_RAD = 1e-5


@dataclass(frozen=True)
class Backlash(ErrorCurve):
    """Half the difference between both directions of approach of an error motion.

    varies : the part that changes along the axis and has no mean; else the constant
    """

    role = Role.DIRECTION
    varies: bool

    def compose_name(self, digits: str) -> str:
        """`backlash-` or `backlash-shape-` with the symbol."""
        return f"backlash-{'shape-' if self.varies else ''}{self.symbol}"

    @property
    def half_difference(self) -> Backlash:
        return self

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arm of the error times h, with the sign of its axis' last motion."""
        rows = at.spline_rows(self.axis.name, self.spline) @ self.gauge
        sign = at.approach[:, at.machine.axis_names.index(self.axis.name)]
        arm = compute_arm(self.symbol, at) * sign[:, None]
        return columns_along(arm, rows)

    def prior(self) -> QuadraticPrior:
        return self.mean_square_prior(0.3 * get_typical_size(self.symbol))


def make_half_width(symbol: str, axis: Axis) -> Backlash:
    """The same half difference over the whole travel."""
    spline = _few_knots(axis)
    return Backlash(symbol, axis, spline, np.ones((spline.size, 1)), False)


def make_half_shape(symbol: str, axis: Axis) -> Backlash:
    """Variation of the half difference about its mean over the travel."""
    spline = _few_knots(axis)
    mean = spline.gram() @ np.ones(spline.size)
    return Backlash(symbol, axis, spline, null_space(mean[None, :]), True)


def _few_knots(axis: Axis) -> CubicSpline:
    return natural_spline(np.linspace(axis.low, axis.high, _INTERVALS + 1))


def _lost_positioning(axis: Axis) -> Backlash:
    return make_half_width(f"E{axis.name}{axis.name}", axis)


class BacklashFamily(Family):
    name = "backlash"
    effect = Backlash
    varies_with = "way"
    makes = _lost_positioning
    keys = {"axis": ANY_AXIS}
    # Coming from below, the axis stops short by half the width.
    stated = {"width_um": -2e3}
    words = read_words("""
        [en]
        title = Backlash
        cause = Play or wind-up in screw, nut, thrust bearing or rack.
        looks_like = An axis stops short by the same width whenever it comes from the
            other side: lines lie apart by direction of travel.
        remedy = Enter the width as the axis' backlash compensation; check nut preload
            and thrust bearing, or measure with a scale.
        [de]
        title = Umkehrspiel
        cause = Spiel oder Verdrillung in Spindel, Mutter, Axiallager oder Zahnstange.
        looks_like = Eine Achse bleibt immer um dieselbe Breite zurück, wenn sie von der
            anderen Seite kommt: Die Geraden liegen je nach Fahrtrichtung auseinander.
        remedy = Die Breite als Losekompensation der Achse eintragen; Vorspannung der
            Mutter und Axiallager prüfen oder mit einem Maßstab messen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        effects = [_lost_positioning(axis) for axis in at.machine.axes]
        typical = {True: 2.0 * _TYPICAL_RAD, False: 0.5 * USUAL_MM}
        return [self.make_candidate(e, [typical[is_turn(e.symbol)]]) for e in effects]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Width, µm; of a rotary axis without a sign, µrad.

        There it depends on the side that carries the axis.
        """
        if not is_turn(f"E{2 * found.candidate.keys['axis']}"):
            return super().state(found)
        (half,) = found.parameters
        return {"width_urad": Quantity(abs(half.value), half.uncertainty).scale(2e6)}


@dataclass(frozen=True)
class GradualBacklash(Backlash):
    """An error motion that changes sides gradually within some travel.

    turnover_mm : travel after a reversal in which it changes sides
    """

    turnover_mm: float = 0.0

    def compose_name(self, digits: str) -> str:
        return f"{super().compose_name(digits)}-{self.turnover_mm:{digits}}"

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Arm of the error times the side of each cell, on average over the cell."""
        whole = super().jacobian(at)
        if at.recorded is None:
            return whole
        column = at.machine.axis_names.index(self.axis.name)
        travelled = at.recorded.since_reversal[:, column]
        width = np.abs(at.recorded.rate[:, column]) * at.recorded.span_s
        return whole * _side(travelled, width, self.turnover_mm)[:, None, None]


def _side(
    travelled_mm: Float64[np.ndarray, " n"],
    width_mm: Float64[np.ndarray, " n"],
    turnover_mm: float,
) -> Float64[np.ndarray, " n"]:
    """Mean of min(2 s / turnover − 1, 1) for s within width about travelled."""
    half = 0.5 * np.maximum(width_mm, 1e-6)
    low, high = np.maximum(travelled_mm - half, 0.0), travelled_mm + half
    early = low < turnover_mm
    side = np.ones(len(travelled_mm))
    a, b = low[early], high[early]
    within = np.minimum(b, turnover_mm)
    turning = (within**2 - a**2) / turnover_mm - (within - a)
    side[early] = (turning + np.maximum(b - turnover_mm, 0.0)) / (b - a)
    return side


_TURNOVERS_MM = np.array([0.02, 0.25, 0.5, 1.0, 2.0])


class LateralBacklashFamily(Family):
    """One candidate per error motion across or about an axis, its turnover scanned."""

    name = "lateral-backlash"
    varies_with = "way"
    value_name = "turnover_mm"
    numbers = ("turnover_mm",)
    is_smooth = False
    effect = GradualBacklash
    keys = {"axis": replace(AXIS, phrase=""), "motion": MOTION}
    words = read_words("""
        [en]
        title = Lateral backlash
        cause = A carriage has play in its guide, or is pushed aside by a nut or chain
            that is off centre: it tilts or shifts as it turns back.
        looks_like = A straightness or an angle has two values at each place, one for
            each direction of approach.
        remedy = Check guide clearance, gibs and preload; approach from one side, or
            enter tables of both directions.
        [de]
        title = Seitliches Umkehrspiel
        cause = Ein Schlitten hat Spiel in seiner Führung oder wird von einer
            außermittigen Mutter oder Kette zur Seite gedrückt: Er kippt oder versetzt
            sich beim Umkehren.
        looks_like = Eine Geradheit oder ein Winkel hat an jedem Ort zwei Werte, einen
            je Anfahrrichtung.
        remedy = Führungsspiel, Keilleisten und Vorspannung prüfen; von einer Seite
            anfahren oder Tabellen beider Richtungen eintragen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        first = float(_TURNOVERS_MM[0])
        return [
            Candidate(
                self.name,
                {"axis": axis.name, "motion": symbol},
                _gradual_backlash(symbol, axis, first),
                np.array([_TYPICAL_RAD if is_turn(symbol) else 0.5 * USUAL_MM]),
                first,
            )
            for axis in at.machine.linear_axes
            for symbol in list_error_motions(axis.name)
            if not is_positioning(symbol)
        ]

    def restore(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        axis, symbol = machine.linear(keys["axis"]), keys["motion"]
        if symbol not in list_error_motions(axis.name):
            raise KeyError(symbol)
        return _gradual_backlash(symbol, axis, numbers.get(self.value_name, 0.0))

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Turnovers, mm; None if the travel since each reversal is not recorded."""
        return None if at.recorded is None else Scan(self.value_name, _TURNOVERS_MM)

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Half the difference between both directions, µm or µrad; turnover, mm."""
        scale = 1e6 if is_turn(found.candidate.keys["motion"]) else 1e3
        half_width = found.parameters[0].scale(scale)
        return {"half_width": half_width, self.value_name: found.value}


def _gradual_backlash(
    symbol: str, axis: LinearAxis, turnover_mm: float
) -> GradualBacklash:
    plain = make_half_width(symbol, axis)
    return GradualBacklash(
        plain.symbol, plain.axis, plain.spline, plain.gauge, False, float(turnover_mm)
    )


_DECAYS_MM = np.geomspace(3.0, 60.0, 10)


@dataclass(frozen=True)
class ReversalSpike(Effect):
    """Displacement in one direction that decays with the distance since reversal.

    Its sign is that of the axis' present direction.
    θ : the excursion at the reversal
    """

    kind = "reversal-spike"
    units = {"": "mm"}
    axis: LinearAxis
    direction: str
    decay_mm: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        column = at.machine.axis_names.index(self.axis.name)
        left = np.exp(-at.recorded.since_reversal[:, column] / self.decay_mm)
        arm = compute_arm(f"E{self.direction}{self.axis.name}", at)
        return columns_along(arm, left * at.approach[:, column])


class ReversalSpikeFamily(Family):
    """One candidate per axis and direction, the decay scanned."""

    name = "reversal-spike"
    varies_with = "way"
    value_name = "decay_mm"
    numbers = ("decay_mm",)
    effect = ReversalSpike
    keys = {"axis": AXIS, "direction": DIRECTION}
    stated = {"amplitude_um": 1e3}
    words = read_words("""
        [en]
        title = Spike at reversal
        cause = Friction holds an axis back for a moment when it reverses, or its guide
            tilts before it settles.
        looks_like = A peak just after each reversal that fades within some millimetres
            of travel; on circles, a spike at the change of quadrant.
        remedy = Tune the controller's friction (quadrant error) compensation; check
            lubrication and the preload of guides and nut.
        [de]
        title = Umkehrspitze
        cause = Reibung hält eine Achse beim Umkehren einen Augenblick fest, oder ihre
            Führung kippt, bevor sie sich setzt.
        looks_like = Eine Spitze kurz nach jeder Umkehr, die nach einigen Millimetern
            Weg abklingt; auf Kreisen eine Spitze am Quadrantenübergang.
        remedy = Die Reibungskompensation (Quadrantenfehler) der Steuerung einstellen;
            Schmierung und Vorspannung von Führungen und Mutter prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        axes = at.machine.linear_axes
        return [
            self.make_candidate(ReversalSpike(axis, other.name, 10.0), [USUAL_MM])
            for axis in axes
            for other in axes
            if _reverses(axis, at)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        return Scan(self.value_name, _DECAYS_MM)


def _reverses(axis: LinearAxis, at: Conditions) -> bool:
    if at.recorded is None:
        return False
    column = at.machine.axis_names.index(axis.name)
    return bool((at.recorded.since_reversal[:, column] < _DECAYS_MM[-1]).any())
