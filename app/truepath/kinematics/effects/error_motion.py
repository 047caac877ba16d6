"""One error motion of one axis: a cubic spline over its travel.

Natural, or cyclic where a rotary axis turns fully; the positions of a rotary axis are
in deg.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import (
    ErrorCurve,
    QuadraticPrior,
    columns_along,
)
from truepath.kinematics.machine.machine import Axis, RotaryAxis, find_local_directions
from truepath.kinematics.machine.symbols import DIRECTION, is_straightness, is_turn
from truepath.kinematics.splines import CubicSpline, cyclic_spline, natural_spline

_USUAL_MM, _USUAL_RAD = 0.01, 2e-5


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
        """Its own symbol."""
        return self.symbol

    @property
    def motion(self) -> ErrorMotion:
        """Itself."""
        return self

    def coarsen(self, intervals: int) -> ErrorMotion:
        """The same motion over fewer intervals."""
        return make_error_motion(self.symbol, self.axis, intervals)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arm of the error times its spline rows: e_d, or e_d × L for a turn."""
        rows = at.spline_rows(self.axis.name, self.spline) @ self.gauge
        return columns_along(find_arm(self.symbol, at), rows)

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Arm of the error times its value."""
        rows = at.spline_rows(self.axis.name, self.spline)
        return find_arm(self.symbol, at) * (rows @ (self.gauge @ theta))[:, None]

    def prior(self) -> QuadraticPrior:
        """Bending energy of the beam (brunn-hanebeck-2005, eq. 12–13).

        The typical size is that of an error that waves once over the travel.
        """
        length = self.axis.high - self.axis.low
        usual = (
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
        return QuadraticPrior(form, self.spline.size - free, usual, kind)


def find_arm(symbol: str, at: Conditions) -> Float64[np.ndarray, "n 3"]:
    """Displacement of the target per unit of error: e_d, or e_d × L; read-only."""
    arms = at.chain.arms
    if symbol not in arms:
        axis = at.machine.axes[at.machine.axis_names.index(symbol[2])]
        turned = isinstance(axis, RotaryAxis)
        local = find_local_directions(axis) if turned else np.eye(3)
        direction, lever = local[:, DIRECTION[symbol[1]]], at.chain.lever(axis.name)
        arms[symbol] = lever.displace(direction, is_turn=is_turn(symbol))
        arms[symbol].flags.writeable = False
    return arms[symbol]


def get_typical_size(symbol: str) -> float:
    """Typical size of an error motion, mm or rad."""
    return _USUAL_RAD if is_turn(symbol) else _USUAL_MM


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
