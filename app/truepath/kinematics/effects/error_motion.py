"""Errors of one axis as in ISO 230-1: error motions, squareness, location.

An error motion is a cubic spline over the travel: natural, or cyclic where a rotary
axis turns fully; the positions of a rotary axis are in deg.

Squareness is the slope that straightness leaves to it. The rigid-body model has all of
them. As a family, it is a squareness that the model in use does not have, or that has
changed since.

A rotary axis may be shifted and tilted against its nominal location: XOC, YOC, AOC, BOC
of a C axis, and so on. At the axis zero a wrong location moves nothing; from there it
moves the target by (1 − R) g on the tool side, (R − 1) g on the workpiece side. Error
motions across the axis have no mean over the travel: their mean would be location,
as slopes of straightness are squareness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import (
    Effect,
    ErrorCurve,
    Parameter,
    QuadraticPrior,
    columns_along,
)
from truepath.kinematics.effects.family import Candidate, Family, read_words
from truepath.kinematics.effects.keys import SYMBOL
from truepath.kinematics.machine.machine import (
    Axis,
    RotaryAxis,
    compute_local_directions,
)
from truepath.kinematics.machine.symbols import (
    DIRECTION,
    TURNS,
    is_straightness,
    is_turn,
    list_locations,
)
from truepath.kinematics.splines import CubicSpline, cyclic_spline, natural_spline

_TYPICAL_MM, _TYPICAL_RAD = 0.01, 2e-5


@dataclass(frozen=True)
class ErrorMotion(ErrorCurve):
    """E or ω of an axis: values of a spline in the gauge of formats.md.

    gauge : (K, p), control values per free parameter. Positioning and turns are 0 at
        the axis zero (else at the lowest position); straightness is 0 at both ends of
        the travel. What the gauge removes is squareness or the pose of the volume.
        Of a rotary axis all six are 0 at the axis zero, and what is across the axis
        has no mean over the travel: that mean is the location of the axis.
    """

    @property
    def iso_symbol(self) -> str:
        return self.symbol

    @property
    def motion(self) -> ErrorMotion:
        return self

    def coarsen(self, intervals: int) -> ErrorMotion:
        return make_error_motion(self.symbol, self.axis, intervals)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arm of the error times its spline rows: e_d, or e_d × L for a turn."""
        rows = at.spline_rows(self.axis.name, self.spline) @ self.gauge
        return columns_along(compute_arm(self.symbol, at), rows)

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        rows = at.spline_rows(self.axis.name, self.spline)
        return compute_arm(self.symbol, at) * (rows @ (self.gauge @ theta))[:, None]

    def prior(self) -> QuadraticPrior:
        """Bending energy of the beam (brunn-hanebeck-2005, eq. 12–13).

        The typical size is that of an error that waves once over the travel.
        """
        length = self.axis.high - self.axis.low
        typical = (
            get_typical_size(self.symbol) ** 2
            * (2.0 * np.pi / length) ** 4
            * length
            / 2
        )
        form = self.gauge.T @ self.spline.bending() @ self.gauge
        free = 1 if self.spline.period else 2
        kind = "turn" if is_turn(self.symbol) else "shift"
        if isinstance(self.axis, RotaryAxis):
            kind += " of a rotary axis"
        return QuadraticPrior(form, self.spline.size - free, typical, kind)


def compute_arm(symbol: str, at: Conditions) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the target per unit of error: e_d, or e_d × L; read-only."""
    arms = at.chain.arms
    if symbol not in arms:
        axis = at.machine.axis(symbol[2])
        turned = isinstance(axis, RotaryAxis)
        local = compute_local_directions(axis) if turned else np.eye(3)
        direction, lever = local[:, DIRECTION[symbol[1]]], at.chain.lever(axis.name)
        arms[symbol] = lever.displace(direction, is_turn=is_turn(symbol))
        arms[symbol].flags.writeable = False
    return arms[symbol]


def get_typical_size(symbol: str) -> float:
    return _TYPICAL_RAD if is_turn(symbol) else _TYPICAL_MM


def make_error_motion(symbol: str, axis: Axis, intervals: int) -> ErrorMotion:
    """Knots at equal intervals over the travel; one turn where the axis turns fully."""
    knots = np.linspace(axis.low, axis.high, intervals + 1)
    if isinstance(axis, RotaryAxis) and axis.turns_fully:
        # One period of a travel that may hold more than a turn.
        knots = axis.low + 360.0 * np.arange(intervals) / intervals
    return make_error_motion_over(symbol, axis, knots)


def make_error_motion_over(
    symbol: str, axis: Axis, knots_mm: Float64[np.ndarray, " k"]
) -> ErrorMotion:
    """Over given knots, mm or deg, in the gauge of formats.md."""
    if isinstance(axis, RotaryAxis):
        return _turning_motion(symbol, axis, knots_mm)
    spline = natural_spline(knots_mm)
    fixed = np.array([reference_position_mm(axis)])
    if is_straightness(symbol):
        fixed = np.array([axis.low, axis.high])
    shapes = _find_shapes(spline, spline.basis(fixed))
    return ErrorMotion(symbol, axis, spline, shapes)


def reference_position_mm(axis: Axis) -> float:
    """The axis zero, or the lowest position where zero is out of travel; mm or deg."""
    return 0.0 if axis.low <= 0.0 <= axis.high else axis.low


def _turning_motion(
    symbol: str, axis: RotaryAxis, knots_deg: Float64[np.ndarray, " k"]
) -> ErrorMotion:
    spline = natural_spline(knots_deg)
    if axis.turns_fully:
        spline = cyclic_spline(knots_deg, 360.0)
    fixed = spline.basis(np.array([reference_position_mm(axis)]))
    if DIRECTION[symbol[1]] != DIRECTION[axis.name]:
        mean = spline.gram() @ np.ones(spline.size)
        fixed = np.vstack([fixed, mean / mean.sum()])
    return ErrorMotion(symbol, axis, spline, _find_shapes(spline, fixed))


def _find_shapes(
    spline: CubicSpline, fixed: Float64[np.ndarray, "c k"]
) -> Float64[np.ndarray, "k p"]:
    """Orthonormal and without bending products (Demmler & Reinsch 1975), straight ones
    first: in this basis prior and data are both well scaled, however many the knots.
    """
    free = null_space(fixed)
    _, shapes = np.linalg.eigh(free.T @ spline.bending() @ free)
    return free @ shapes


# The axis out of square, which way it leans, the sign of a right-handed turn.
_LEAN = {"C0Y": ("Y", 0, -1.0), "B0Z": ("Z", 0, 1.0), "A0Z": ("Z", 1, -1.0)}


@dataclass(frozen=True)
class Squareness(Effect):
    """C0Y, B0Z or A0Z: the axis leans by a right-handed turn."""

    units = {"": "rad"}
    symbol: str

    @property
    def iso_symbol(self) -> str:
        return self.symbol

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Lean: a displacement in proportion to the axis' position."""
        name, direction, sign = _LEAN[self.symbol]
        axis = at.machine.linear(name)
        lean = np.zeros((len(at), 3))
        lean[:, direction] = sign * (at.axis_mm(name) - reference_position_mm(axis))
        return at.chain.lever(name).displace(lean, is_turn=False)[:, :, None]


def list_squarenesses(axes: tuple[str, ...]) -> tuple[Squareness, ...]:
    pairs = {"C0Y": {"X", "Y"}, "B0Z": {"X", "Z"}, "A0Z": {"Y", "Z"}}
    return tuple(Squareness(s) for s, pair in pairs.items() if pair <= set(axes))


class SquarenessFamily(Family):
    name = "squareness"
    is_rigid_body = True
    effect = Squareness
    keys = {"symbol": SYMBOL}
    stated = {"value_urad": 1e6}
    words = read_words("""
        [en]
        title = Squareness
        cause = Two axes are not square to each other: as assembled, after a crash, or
            because the machine was levelled anew.
        looks_like = Lines across the plane of the two axes lean in proportion to the
            travel of one of them; face diagonals differ in length.
        remedy = Enter the angle as squareness compensation; check levelling and the
            joint between the two axes.
        [de]
        title = Rechtwinkligkeit
        cause = Zwei Achsen stehen nicht rechtwinklig zueinander: seit der Montage, nach
            einem Aufprall oder weil die Maschine neu nivelliert wurde.
        looks_like = Geraden quer durch die Ebene der beiden Achsen neigen sich im
            Verhältnis zum Weg der einen; die Diagonalen der Ebene sind verschieden
            lang.
        remedy = Den Winkel als Rechtwinkligkeitskompensation eintragen; Nivellierung
            und Verbindung der beiden Achsen prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        names = tuple(axis.name for axis in at.machine.linear_axes)
        return [
            self.make_candidate(s, [_TYPICAL_RAD]) for s in list_squarenesses(names)
        ]


@dataclass(frozen=True)
class AxisLocation(Effect):
    """A shift of the axis, or a tilt about its origin, in its local directions."""

    symbol: str
    axis: RotaryAxis

    @property
    def iso_symbol(self) -> str:
        return self.symbol

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(self.symbol, "rad" if self.symbol[0] in TURNS else "mm"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """F (1 − R) d, with × L for a tilt."""
        unit = compute_local_directions(self.axis)[:, DIRECTION[self.symbol[0]]]
        chain = at.chain
        turn = chain.turns[self.axis.name]
        if self.axis.name in at.machine.workpiece_side:
            # The error is behind the joint: R there is that of the workpiece.
            direction = np.einsum("nji,j->ni", turn, unit) - unit
        else:
            direction = unit - np.einsum("nij,j->ni", turn, unit)
        is_turn = self.symbol[0] in TURNS
        lever = chain.lever(self.axis.name)
        return lever.displace(direction, is_turn=is_turn)[:, :, None]


def list_axis_locations(axis: RotaryAxis) -> tuple[AxisLocation, ...]:
    """Four per rotary axis, shifts first."""
    return tuple(AxisLocation(symbol, axis) for symbol in list_locations(axis.name))
