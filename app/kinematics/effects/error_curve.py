"""One error of an axis as a function of its position: what a table states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.machine import Axis
from app.numerics.splines import CubicSpline
from app.numerics.value_equality import ValueEquality


@dataclass(frozen=True)
class ErrorCurve(ValueEquality):
    """A spline over the travel of an axis, linear in θ.

    symbol : ISO 230-1 symbol of the error motion
    gauge : (K, p), control values per parameter
    """

    symbol: str
    axis: Axis
    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    def rows(self, position: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n p"]:
        """Return the value per parameter at positions of the axis, mm or deg."""
        return self.spline.basis(position) @ self.gauge
