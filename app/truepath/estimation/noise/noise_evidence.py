"""Evidence of a noise model, with its slope and curvature.

The evidence is that of restricted maximum likelihood: the part of the data absorbed by
the parameters is not mistaken for low noise. With V the covariance of the data, H =
AᵀV⁻¹A + prior and P = V⁻¹ − V⁻¹A H⁻¹AᵀV⁻¹,

    cost = log|V| + log|H| + yᵀPy,    ∂cost/∂x = tr(P ∂V) − yᵀP ∂V Py,

and its curvature is that of the average information, yᵀP ∂V P ∂V Py, which needs no
trace (Gilmour, Thompson & Cullis 1995). The traces that the slope needs are second
moments of the Ornstein–Uhlenbeck part given the data, between neighbours in time only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from truepath.errors import Unidentifiable
from truepath.estimation.problem.design_matrix import DesignMatrix
from truepath.estimation.problem.information import Information
from truepath.estimation.problem.noise import NoiseModel, split_sigma_mm
from truepath.numerics.correlated_noise import (
    OrnsteinUhlenbeckPrecision,
    build_ou_precision,
)
from truepath.numerics.scaled_cholesky import ScaledCholesky

_STEP = 1e-4  # of a logarithm, for derivatives of what is cheap
_LEAST_LEFT = 1e-3  # of the variance of noise: a fit that takes all leaves rounding

Sizes = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Slope:
    """Cost (−2 log evidence) with gradient and curvature.

    With respect to the logarithms of the Ornstein–Uhlenbeck part's size along the beam,
    in azimuth and in elevation, its time and, if there is one, the jitter along the
    travel or the noise between places along the beam, in azimuth and in elevation.
    """

    cost: float
    gradient: Float64[np.ndarray, " k"]
    curvature: Float64[np.ndarray, "k k"]


@dataclass(frozen=True)
class NoiseEvidence:
    """Cells whose noise is estimated.

    columns : (n, 3, p) of the parameters, p may be 0; residual : (n, 3) the data
    known : information on the first parameters, from prior and other data
    """

    design: DesignMatrix
    columns: Float64[np.ndarray, "n 3 p"]
    residual: Float64[np.ndarray, "n 3"]
    known: Information

    def evaluate(self, noise: NoiseModel) -> Slope:
        """Cost, gradient and curvature at a noise model.

        Raises Unidentifiable if data and prior do not determine the parameters.
        """
        return _Solution(self, noise).slope()

    def solve(self, noise: NoiseModel) -> Float64[np.ndarray, " p"]:
        """Parameters of greatest posterior probability under a noise model."""
        return _Solution(self, noise).theta

    def compare_neighbours(
        self, noise: NoiseModel
    ) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"]]:
        """Squared residual differences of neighbours in time, and their expectation."""
        return _Solution(self, noise).compare_neighbours()

    @cached_property
    def rows(self) -> Float64[np.ndarray, "n 3 q"]:
        return np.concatenate([self.columns, self.residual[:, :, None]], axis=2)

    @cached_property
    def travel(self) -> Float64[np.ndarray, "n 3"]:
        return self.design.travel


class _Solution:
    """The problem solved under one noise model; A and y side by side."""

    def __init__(self, of: NoiseEvidence, noise: NoiseModel) -> None:
        self.of, self.noise = of, noise
        self.inverse = of.design.whiten(noise)
        n, p = len(of.residual), of.columns.shape[2]
        weighted, ou = (v.reshape(3 * n, p + 1) for v in self.inverse.split(of.rows))
        new = self.inverse.whiten(of.rows)
        total = new.T @ new
        k = len(of.known.vector)
        total[:k, :k] += of.known.matrix
        total[:k, p] += of.known.vector
        try:
            self.factor = ScaledCholesky.of(total[:p, :p])
        except np.linalg.LinAlgError as error:
            raise Unidentifiable(
                "the lines do not determine the noise beside the errors; add lines"
            ) from error
        half = self.factor.solve_half(total[:p, p])
        self.square = float(total[p, p] + of.known.square - half @ half)
        theta = self.theta = self.factor.solve(total[:p, p])
        # V⁻¹A; the residual, and its Ornstein–Uhlenbeck part.
        self.columns = weighted[:, :p]
        self.residual = (weighted[:, p] - weighted[:, :p] @ theta).reshape(n, 3)
        self.ou = ou[:, :p]
        self.ou_residual = ou[:, p] - ou[:, :p] @ theta
        # C⁻¹, and that of a slightly longer correlation time.
        observations = of.design.observations
        _, sigma = split_sigma_mm(observations, noise)
        self.here, self.longer = (
            build_ou_precision(observations.at.time_s, sigma, each.ou_time_s)
            for each in (noise, _lengthen(noise))
        )

    def slope(self) -> Slope:
        determinants = self.inverse.log_determinant + self.factor.log_determinant
        cost = determinants + self.square
        gradient = self._volume_slope() - self._moments()
        return Slope(cost, gradient, self._curvature())

    def compare_neighbours(
        self,
    ) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"]]:
        of, noise = self.of, self.noise
        seen, apart = of.design.observations, np.diff(of.columns, axis=0)
        white, ou = split_sigma_mm(seen, noise)
        fresh = -np.expm1(-np.diff(seen.at.time_s) / noise.ou_time_s)[:, None]
        sigma = white[1:] ** 2 + white[:-1] ** 2 + 2.0 * fresh * ou[1:] ** 2
        taken = self.factor.solve_half(apart.reshape(-1, apart.shape[2]).T)
        rest = of.residual - of.columns @ self.theta
        expected = sigma - (taken**2).sum(axis=0).reshape(-1, 3)
        return np.diff(rest, axis=0) ** 2, np.maximum(expected, _LEAST_LEFT * sigma)

    def _volume_slope(self) -> Float64[np.ndarray, " k"]:
        here = self.inverse.log_determinant
        return np.array(
            [
                (self.of.design.whiten(moved).log_determinant - here) / _STEP
                for moved in _perturb(self.noise)
            ]
        )

    def _moments(self) -> Float64[np.ndarray, " k"]:
        """tr(∂V V⁻¹A H⁻¹AᵀV⁻¹) + yᵀP ∂V Py."""
        spread = self.factor.solve_half(self.ou.T)
        now = (spread**2).sum(axis=0) + self.ou_residual**2
        next_ = (spread[:, 3:] * spread[:, :-3]).sum(axis=0)
        next_ += self.ou_residual[3:] * self.ou_residual[:-3]
        size = 2.0 * _by_coordinate(self.here, now, next_)
        longer = _by_coordinate(self.longer, now, next_).sum()
        time = (longer - 0.5 * size.sum()) / _STEP
        found = [*size, -time]
        if np.isfinite(self.noise.along_sigma_mm):
            n, along = len(self.of.residual), self.of.travel
            pulled = np.einsum("ni,nip->pn", along, self.columns.reshape(n, 3, -1))
            rest = np.einsum("ni,ni->n", along, self.residual)
            square = float(
                (self.factor.solve_half(pulled) ** 2).sum() + (rest**2).sum()
            )
            found.append(2.0 * self.noise.along_sigma_mm**2 * square)
        if any(self.noise.place):
            spread = self.factor.solve_half(self.columns.T) ** 2
            square = spread.sum(axis=0) + self.residual.ravel() ** 2
            found += (2.0 * self._place * square.reshape(-1, 3)).sum(axis=0).tolist()
        return np.array(found)

    @property
    def _place(self) -> Float64[np.ndarray, "n 3"]:
        with_, without = (
            split_sigma_mm(self.of.design.observations, each)[0]
            for each in (self.noise, replace(self.noise, place=(0.0, 0.0, 0.0)))
        )
        return with_**2 - without**2

    def _curvature(self) -> Float64[np.ndarray, "k k"]:
        moved = self._perturb_data()
        weighted = self.inverse.apply(moved).reshape(-1, moved.shape[2])
        half = self.factor.solve_half(self.columns.T @ moved.reshape(weighted.shape))
        return moved.reshape(weighted.shape).T @ weighted - half.T @ half

    def _perturb_data(self) -> Float64[np.ndarray, "n 3 k"]:
        """∂V P y for each parameter."""
        n = len(self.of.residual)
        ou = self.ou_residual.reshape(n, 3)
        change = (self.longer.multiply(ou) - self.here.multiply(ou)) / _STEP
        each = [2.0 * ou * axis for axis in np.eye(3)]
        columns = [*each, -self.here.solve(change)]
        if np.isfinite(self.noise.along_sigma_mm):
            along = self.of.travel
            rest = np.einsum("ni,ni->n", along, self.residual)[:, None]
            columns.append(2.0 * self.noise.along_sigma_mm**2 * along * rest)
        if any(self.noise.place):
            own = 2.0 * self._place * self.residual
            columns += [own * axis for axis in np.eye(3)]
        return np.stack(columns, axis=2)


def _by_coordinate(
    ou: OrnsteinUhlenbeckPrecision,
    now: Float64[np.ndarray, " m"],
    next_: Float64[np.ndarray, " l"],
) -> Float64[np.ndarray, "3"]:
    """tr(C⁻¹M) for each coordinate, from the diagonals of M and those beside them."""
    square = (ou.diagonal * now.reshape(-1, 3)).sum(axis=0)
    return square + 2.0 * (ou.below[:-1] * next_.reshape(-1, 3)).sum(axis=0)


def _lengthen(noise: NoiseModel) -> NoiseModel:
    return replace(noise, ou_time_s=noise.ou_time_s * float(np.exp(_STEP)))


def _perturb(noise: NoiseModel) -> list[NoiseModel]:
    factor = float(np.exp(_STEP))

    def raise_each(sizes: Sizes) -> list[Sizes]:
        x, y, z = sizes
        return [(x * factor, y, z), (x, y * factor, z), (x, y, z * factor)]

    moved = [replace(noise, ou=ou) for ou in raise_each(noise.ou)]
    moved.append(_lengthen(noise))
    if np.isfinite(noise.along_sigma_mm):
        moved.append(replace(noise, along_sigma_mm=noise.along_sigma_mm * factor))
    if any(noise.place):
        moved += [replace(noise, place=place) for place in raise_each(noise.place)]
    return moved
