"""Error motions that depend on the direction of approach: backlash and its kin.

Going up an axis errs by E + h, coming down by E − h. The 2023 paper leaves both ways of
modelling h to the future: one number an error motion (14 of them with one target), or
tables of both directions. Here h is a constant, and for tables a spline besides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, QuadraticPrior, Role
from app.kinematics.effects.error_curve import ErrorCurve
from app.kinematics.effects.error_motion import (
    find_arm,
    find_usual_size,
    list_spline_parameters,
)
from app.kinematics.machine import Axis
from app.numerics.splines import CubicSpline, natural_spline

_SHARE = 0.3  # usual size of h, in usual errors
_INTERVALS = 5  # h changes slowly along an axis


@dataclass(frozen=True)
class Backlash(ErrorCurve, Effect):
    """Half the difference between both directions of approach of an error motion.

    varies : the part that changes along the axis and has no mean; else the constant
    """

    role = Role.DIRECTION
    varies: bool

    def spell(self, digits: str) -> str:
        """Return `backlash` with the symbol."""
        del digits
        return f"backlash-{'shape-' if self.varies else ''}{self.symbol}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The half width, or one for each degree of freedom beside the mean."""
        return list_spline_parameters(self.name, self.symbol, self.gauge.shape[1])

    @property
    def half_difference(self) -> Backlash:
        """Itself."""
        return self

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the error's arm times h, with the sign of its axis' last motion."""
        rows = self.rows(at.axis_mm(self.axis.name))
        sign = at.approach[:, at.machine.axis_names.index(self.axis.name)]
        arm = find_arm(self.symbol, at) * sign[:, None]
        return arm[:, :, None] * rows[:, None, :]

    def prior(self) -> QuadraticPrior:
        """Return the mean square of h over the travel."""
        length = self.axis.high - self.axis.low
        form = self.gauge.T @ self.spline.gram() @ self.gauge / length
        rank = self.gauge.shape[1]
        usual = rank * (_SHARE * find_usual_size(self.symbol)) ** 2
        return QuadraticPrior(form, rank, usual)


def make_half_width(symbol: str, axis: Axis) -> Backlash:
    """Return the half difference that is the same everywhere."""
    spline = _spline(axis)
    return Backlash(symbol, axis, spline, np.ones((spline.size, 1)), False)


def make_half_shape(symbol: str, axis: Axis) -> Backlash:
    """Return what the half difference does beyond its mean over the travel."""
    spline = _spline(axis)
    mean = spline.gram() @ np.ones(spline.size)
    return Backlash(symbol, axis, spline, null_space(mean[None, :]), True)


def _spline(axis: Axis) -> CubicSpline:
    return natural_spline(np.linspace(axis.low, axis.high, _INTERVALS + 1))
