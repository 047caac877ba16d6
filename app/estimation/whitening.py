"""Rows in units of their noise, correlation in time included.

With V = D + C the covariance of white and Ornstein–Uhlenbeck noise, aᵀ V⁻¹ b is the
difference of two products: what white noise alone would tell, less what the correlated
noise and eliminated parameters take away. Both factors of a column are computed once
and then give its products with any other column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.design_matrix import DesignMatrix
from app.estimation.noise import NoiseModel, cell_noise
from app.numerics.correlated_noise import Whitener, factorise


def whiten(design: DesignMatrix, noise: NoiseModel) -> Whitener:
    """Return the inverse covariance of the cells in the beam frame."""
    precision, ou_sigma = cell_noise(design.observations, noise, design.travel)
    time_s = design.observations.at.time_s
    return factorise(time_s, precision, ou_sigma, noise.ou_time_s)


@dataclass(frozen=True)
class WhitenedBlocks:
    """Columns on lines, one line after another: aᵀ V⁻¹ b = a₊ᵀ b₊ − a₋ᵀ b₋.

    plus : (m, p); minus : (s, p); begin : (l + 1, 2) first row of each line in either,
        and one past the last
    """

    plus: Float64[np.ndarray, "m p"]
    minus: Float64[np.ndarray, "s p"]
    begin: Int64[np.ndarray, "l 2"]

    @staticmethod
    def build(whitener: Whitener, columns: Float64[np.ndarray, "n 3 p"]):
        """Return columns of one line."""
        return WhitenedBlocks.of_line(*whitener.whiten(columns))

    @staticmethod
    def of_line(
        plus: Float64[np.ndarray, "m p"], minus: Float64[np.ndarray, "s p"]
    ) -> WhitenedBlocks:
        """Return the blocks of one line."""
        return WhitenedBlocks(plus, minus, np.array([[0, 0], [len(plus), len(minus)]]))

    @staticmethod
    def join(lines: Sequence[WhitenedBlocks]) -> WhitenedBlocks:
        """Return the blocks of all lines, in their order."""
        length = [[0, 0], *([len(line.plus), len(line.minus)] for line in lines)]
        return WhitenedBlocks(
            np.concatenate([line.plus for line in lines]),
            np.concatenate([line.minus for line in lines]),
            np.cumsum(length, axis=0),
        )

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.plus.shape[1]

    def select(self, own: slice | Int64[np.ndarray, " k"]) -> WhitenedBlocks:
        """Return some of the columns."""
        plus, minus = (np.asfortranarray(h[:, own]) for h in (self.plus, self.minus))
        return WhitenedBlocks(plus, minus, self.begin)

    def between(self, first: int, last: int) -> WhitenedBlocks:
        """Return the blocks of some lines that follow one another."""
        (a, b), (c, d) = self.begin[first], self.begin[last]
        begin = self.begin[first : last + 1] - self.begin[first]
        return WhitenedBlocks(self.plus[a:c], self.minus[b:d], begin)

    def multiply(self, other: WhitenedBlocks) -> Float64[np.ndarray, "p q"]:
        """Return the products of these columns with others, on the same lines."""
        return self.plus.T @ other.plus - self.minus.T @ other.minus

    def squares(self) -> Float64[np.ndarray, " p"]:
        """Return the product of each column with itself."""
        return np.sum(self.plus**2, axis=0) - np.sum(self.minus**2, axis=0)
