"""One error motion of one linear axis: a natural cubic spline over its travel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from app.kinematics.chain import lever_mm
from app.kinematics.effects.base import Conditions, Effect, Parameter
from app.kinematics.machine import LinearAxis
from app.kinematics.symbols import DIRECTION, is_straightness, is_turn
from app.numerics.splines import CubicSpline, natural_spline


@dataclass(frozen=True)
class ErrorMotion(Effect):
    """E or ω of an axis: values of a spline in the gauge of formats.md.

    gauge : (K, p), control values per free parameter. Positioning and turns are 0 at
    the
        axis zero (else at the lowest position); straightness is 0 at both ends of the
        travel. What the gauge removes is squareness or the pose of the whole volume.
    """

    symbol: str
    axis: LinearAxis
    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    @property
    def name(self) -> str:
        """ISO 230-1 symbol."""
        return self.symbol

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One for each degree of freedom that the gauge leaves."""
        unit = "rad" if is_turn(self.symbol) else "mm"
        count = self.gauge.shape[1]
        return tuple(Parameter(f"{self.symbol}[{i}]", unit) for i in range(count))

    def rows(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n p"]:
        """Return the error's value per parameter at positions of its axis."""
        return self.spline.basis(at_mm) @ self.gauge

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the error's arm times its spline rows: e_d, or e_d × L for a turn."""
        arm = np.zeros((len(at), 3))
        unit = np.eye(3)[DIRECTION[self.symbol[1]]]
        if is_turn(self.symbol):
            arm += np.cross(
                unit,
                lever_mm(at.machine, self.axis.name, at.position_mm, at.offset_mm),
            )
        else:
            arm += unit
        return arm[:, :, None] * self.rows(at.axis_mm(self.axis.name))[:, None, :]

    def roughness(self) -> Float64[np.ndarray, "p p"]:
        """Return the bending energy of the beam (brunn-hanebeck-2005, eq. 12–13)."""
        return self.gauge.T @ self.spline.bending() @ self.gauge


def error_motion(symbol: str, axis: LinearAxis, intervals: int) -> ErrorMotion:
    """Return the error motion over the axis' travel, knots at equal intervals."""
    knots_mm = np.linspace(axis.min_mm, axis.max_mm, intervals + 1)
    return error_motion_over(symbol, axis, knots_mm)


def error_motion_over(
    symbol: str, axis: LinearAxis, knots_mm: Float64[np.ndarray, " k"]
) -> ErrorMotion:
    """Return the error motion in its gauge over given knots."""
    spline = natural_spline(knots_mm)
    fixed = np.array([reference_position_mm(axis)])
    if is_straightness(symbol):
        fixed = np.array([axis.min_mm, axis.max_mm])
    return ErrorMotion(symbol, axis, spline, null_space(spline.basis(fixed)))


def reference_position_mm(axis: LinearAxis) -> float:
    """Return the axis zero, or the lowest position where zero is out of travel."""
    return 0.0 if axis.min_mm <= 0.0 <= axis.max_mm else axis.min_mm
