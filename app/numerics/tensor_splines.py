"""Splines over several positions at once: what one axis does as another moves.

The tensor product of cubic splines, as brunn-hanebeck-2005 proposes for errors of a
plane (its bi-cubic splines): S(t) = Σ a_jk… m_j(t₁) m_k(t₂) …, linear in the control
values, which lie on a grid of knots. Along each position, the others held, it is a
cubic between knots, so the exact search along one axis holds for it as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float64

from app.numerics.splines import CubicSpline


@dataclass(frozen=True, slots=True)
class TensorSpline:
    """A space of splines over a grid of knots; control values in C order of the axes.

    axes : a natural or cyclic spline space for each position
    """

    axes: tuple[CubicSpline, ...]

    @property
    def size(self) -> int:
        """Number of control values."""
        return int(np.prod([axis.size for axis in self.axes]))

    def basis(self, at: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "n k"]:
        """Return m(t) for each row of positions."""
        rows = [axis.basis(at[:, d]) for d, axis in enumerate(self.axes)]
        return reduce(_row_products, rows)

    def gram(self) -> Float64[np.ndarray, "k k"]:
        """Return G with aᵀ G a = ∫ S² over the whole grid, in closed form."""
        return reduce(np.kron, [axis.gram() for axis in self.axes])

    def bending(self) -> Float64[np.ndarray, "k k"]:
        """Return K with aᵀ K a = Σ_d ∫ (∂²S/∂t_d²)², the energy of beams each way."""
        total = np.zeros((self.size, self.size))
        for bent in range(len(self.axes)):
            total += reduce(
                np.kron,
                [
                    axis.bending() if d == bent else axis.gram()
                    for d, axis in enumerate(self.axes)
                ],
            )
        return total


def _row_products(
    left: Float64[np.ndarray, "n j"], right: Float64[np.ndarray, "n k"]
) -> Float64[np.ndarray, "n jk"]:
    return (left[:, :, None] * right[:, None, :]).reshape(len(left), -1)
