"""A slow shift of everything with time: whatever moves tracker, table or air."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import (
    Effect,
    Parameter,
    QuadraticPrior,
    Role,
    columns_along,
)
from app.numerics.splines import CubicSpline, natural_spline

_USUAL_MM = 0.005


@dataclass(frozen=True)
class TimeSpline(Effect):
    """A natural spline of time in one direction, without its mean."""

    kind = "time-spline"
    role = Role.NUISANCE
    direction: str
    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One for each knot but one, in mm."""
        return tuple(
            Parameter(f"{self.name}[{i}]", "mm") for i in range(self.gauge.shape[1])
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the direction times the spline's rows."""
        return columns_along(self.direction, self.spline.basis(at.time_s) @ self.gauge)

    def prior(self) -> QuadraticPrior:
        """Return the mean square over the run."""
        length = float(self.spline.knots[-1] - self.spline.knots[0])
        form = self.gauge.T @ self.spline.gram() @ self.gauge / length
        rank = self.gauge.shape[1]
        return QuadraticPrior(form, rank, rank * _USUAL_MM**2, "time")


def time_splines(at: Conditions, spacing_s: float) -> tuple[TimeSpline, ...]:
    """Return one spline a direction over the time of the conditions."""
    first, last = float(at.time_s.min()), float(at.time_s.max())
    count = max(3, int(np.ceil((last - first) / spacing_s)) + 1)
    spline = natural_spline(np.linspace(first, last, count))
    gauge = null_space((spline.gram() @ np.ones(spline.size))[None, :])
    return tuple(TimeSpline(d, spline, gauge) for d in ("X", "Y", "Z"))
