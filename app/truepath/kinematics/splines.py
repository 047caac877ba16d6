"""Natural and cyclic cubic splines as linear maps of their control values.

A spline S over knots t_1 … t_K is linear in its control values a (brunn-hanebeck-2005,
eq. 2–11): S(t) = mᵀ(t) a. The second derivatives solve a tridiagonal (natural) or
cyclic tridiagonal system; the forward recursion printed as eq. 5 is ill-conditioned and
does not enforce the end condition, so it is not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64


@dataclass(frozen=True, slots=True)
class CubicSpline:
    """A space of cubic splines over given knots; values come with each use.

    knots : (K,), increasing
    curvature_map : (K, K), second derivatives at the knots per unit control value
    period : length of a cyclic spline, 0 for a natural one. A cyclic spline has no
        control value at its closing knot.
    """

    knots: Float64[np.ndarray, " k"]
    curvature_map: Float64[np.ndarray, "k k"]
    period: float = 0.0

    @property
    def size(self) -> int:
        return len(self.knots)

    def basis(self, at: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n k"]:
        """Rows m(t) for each t (eq. 19); natural splines continue straight outside."""
        if self.period:
            return self._cyclic_basis(at)
        inside = np.clip(at, self.knots[0], self.knots[-1])
        left = _interval(self.knots, inside)
        rows = self._values(left, left + 1, inside, np.diff(self.knots)[left])
        beyond = at - inside
        outside = np.flatnonzero(beyond)
        if len(outside):
            slope = self.slope(inside[outside])
            rows[outside] += beyond[outside, None] * slope
        return rows

    def slope(self, at: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n k"]:
        """Row of S' for each t inside the knots of a natural spline."""
        left = _interval(self.knots, at)
        h = np.diff(self.knots)[left]
        b = (at - self.knots[left]) / h
        a = 1.0 - b
        M = self.curvature_map
        rows = ((1.0 - 3.0 * a**2) * h / 6.0)[:, None] * M[left] + (
            (3.0 * b**2 - 1.0) * h / 6.0
        )[:, None] * M[left + 1]
        n = np.arange(len(at))
        rows[n, left] -= 1.0 / h
        rows[n, left + 1] += 1.0 / h
        return rows

    def bending(
        self, weight: Float64[np.ndarray, " s"] | None = None
    ) -> Float64[np.ndarray, "k k"]:
        """K with aᵀ K a = ∫ w S''² dt, the beam's energy (eq. 12–13).

        weight : w, stiffness of the beam in each interval of the knots; 1 if None
        """
        h, left, right = self._spans()
        stiff = h if weight is None else h * weight
        M = self.curvature_map
        L, R = M[left], M[right]
        third = (stiff / 3.0)[:, None]
        energy = (L * third).T @ L + (R * third).T @ R
        cross = (L * (stiff / 6.0)[:, None]).T @ R
        return energy + cross + cross.T

    def gram(self) -> Float64[np.ndarray, "k k"]:
        """G with aᵀ G a = ∫ S² dt, in closed form (eq. 24–26, 34–36)."""
        h, left, right = self._spans()
        M, unit = self.curvature_map, np.eye(self.size)
        # Four shape functions of an interval: two hats, two cubic corrections.
        shapes = [unit[left], unit[right], M[left], M[right]]
        total = np.zeros((self.size, self.size))
        for i, row in enumerate(shapes):
            for j, column in enumerate(shapes):
                power = 1 + 2 * (i > 1) + 2 * (j > 1)
                weight = _GRAM[i, j] * h**power
                total += (row * weight[:, None]).T @ column
        return total

    def _values(
        self,
        left: Int64[np.ndarray, " n"],
        right: Int64[np.ndarray, " n"],
        at: Float64[np.ndarray, " n"],
        h: Float64[np.ndarray, " n"],
    ) -> Float64[np.ndarray, "n k"]:
        b = (at - self.knots[left]) / h
        a = 1.0 - b
        M = self.curvature_map
        rows = ((a**3 - a) * h**2 / 6.0)[:, None] * M[left]
        rows += ((b**3 - b) * h**2 / 6.0)[:, None] * M[right]
        n = np.arange(len(at))
        rows[n, left] += a
        rows[n, right] += b
        return rows

    def _cyclic_basis(
        self, at: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n k"]:
        h, _, right = self._spans()
        turned: Float64[np.ndarray, " n"] = self.knots[0] + np.mod(
            at - self.knots[0], self.period
        )
        left = np.asarray(np.searchsorted(self.knots, turned, side="right")) - 1
        return self._values(left, right[left], turned, h[left])

    def _spans(
        self,
    ) -> tuple[
        Float64[np.ndarray, " s"], Int64[np.ndarray, " s"], Int64[np.ndarray, " s"]
    ]:
        K = self.size
        if not self.period:
            left = np.arange(K - 1)
            return np.diff(self.knots), left, left + 1
        closed = np.append(self.knots, self.knots[0] + self.period)
        left = np.arange(K)
        return np.diff(closed), left, (left + 1) % K


# ∫ of products of a, b, (a³-a)/6, (b³-b)/6 over a unit interval, a = 1 - b.
_GRAM = np.array(
    [
        [1 / 3, 1 / 6, -1 / 45, -7 / 360],
        [1 / 6, 1 / 3, -7 / 360, -1 / 45],
        [-1 / 45, -7 / 360, 2 / 945, 31 / 15120],
        [-7 / 360, -1 / 45, 31 / 15120, 2 / 945],
    ]
)


def natural_spline(knots: Float64[np.ndarray, " k"]) -> CubicSpline:
    """Natural spline space over the knots (eq. 2–6)."""
    K = len(knots)
    h = np.diff(knots)
    system = np.eye(K)
    right = np.zeros((K, K))
    for i in range(1, K - 1):
        system[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
        right[i, i - 1 : i + 2] = (
            6.0 / h[i - 1],
            -6.0 / h[i - 1] - 6.0 / h[i],
            6.0 / h[i],
        )
    return CubicSpline(knots, np.linalg.solve(system, right))


def cyclic_spline(knots: Float64[np.ndarray, " k"], period: float) -> CubicSpline:
    """Cyclic spline space (eq. 7–10), at least 3 knots in a period."""
    K = len(knots)
    h = np.diff(np.append(knots, knots[0] + period))
    system, right = np.zeros((K, K)), np.zeros((K, K))
    for i in range(K):
        before, after = (i - 1) % K, (i + 1) % K
        system[i, before] += h[before]
        system[i, i] += 2.0 * (h[before] + h[i])
        system[i, after] += h[i]
        right[i, before] += 6.0 / h[before]
        right[i, i] -= 6.0 / h[before] + 6.0 / h[i]
        right[i, after] += 6.0 / h[i]
    return CubicSpline(knots, np.linalg.solve(system, right), period)


def _interval(
    knots: Float64[np.ndarray, " k"], at: Float64[np.ndarray, " n"]
) -> Int64[np.ndarray, " n"]:
    return np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
