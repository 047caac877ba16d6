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

from app.kinematics.effects.base import Charge, Conditions, Effect, Parameter
from app.kinematics.effects.error_motion import arm_of, usual_size
from app.kinematics.machine import LinearAxis
from app.kinematics.symbols import is_turn
from app.numerics.splines import CubicSpline, natural_spline

_SHARE = 0.3  # usual size of h, in usual errors
_INTERVALS = 5  # h changes slowly along an axis


@dataclass(frozen=True)
class Backlash(Effect):
    """Half the difference between both directions of approach, the same everywhere."""

    symbol: str
    axis: LinearAxis

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"backlash-{self.symbol}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The half width."""
        return (Parameter(self.name, "rad" if is_turn(self.symbol) else "mm"),)

    def rows(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n p"]:
        """Return h per parameter at positions of its axis."""
        return np.ones((len(at_mm), 1))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the error's arm, with the sign of its axis' last motion."""
        return _signed(self.symbol, at, self.rows(at.axis_mm(self.axis.name)))

    def charge(self) -> Charge:
        """Return the square of the half width."""
        return Charge(np.eye(1), 1, (_SHARE * usual_size(self.symbol)) ** 2)


@dataclass(frozen=True)
class BacklashShape(Effect):
    """What the half difference of both directions does beyond its mean over the travel.

    gauge : (K, p), control values per parameter; none of them has a mean
    """

    symbol: str
    axis: LinearAxis
    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"backlash-shape-{self.symbol}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One for each degree of freedom beside the mean."""
        unit = "rad" if is_turn(self.symbol) else "mm"
        count = self.gauge.shape[1]
        return tuple(Parameter(f"{self.name}[{i}]", unit) for i in range(count))

    def rows(self, at_mm: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n p"]:
        """Return h per parameter at positions of its axis."""
        return self.spline.basis(at_mm) @ self.gauge

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the error's arm times the shape, signed by the last motion."""
        return _signed(self.symbol, at, self.rows(at.axis_mm(self.axis.name)))

    def charge(self) -> Charge:
        """Return the mean square of the shape over the travel."""
        length = self.axis.max_mm - self.axis.min_mm
        form = self.gauge.T @ self.spline.gram() @ self.gauge / length
        rank = self.gauge.shape[1]
        return Charge(form, rank, rank * (_SHARE * usual_size(self.symbol)) ** 2)


def backlash_shape(symbol: str, axis: LinearAxis) -> BacklashShape:
    """Return the shape of the half difference over the travel."""
    spline = natural_spline(np.linspace(axis.min_mm, axis.max_mm, _INTERVALS + 1))
    mean = spline.gram() @ np.ones(spline.size)
    return BacklashShape(symbol, axis, spline, null_space(mean[None, :]))


def _signed(
    symbol: str, at: Conditions, rows: Float64[np.ndarray, "n p"]
) -> Float64[np.ndarray, "n 3 p"]:
    sign = at.approach[:, at.machine.axis_names.index(symbol[2])]
    return (arm_of(symbol, at) * sign[:, None])[:, :, None] * rows[:, None, :]
