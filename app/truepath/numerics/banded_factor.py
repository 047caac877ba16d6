"""Solve with a banded Cholesky factor L of few diagonals, for many columns at once.

LAPACK processes a band row by row and column by column, limited by memory access. In
chunks of some rows the inverse is small and dense: most of the work is then products of
matrices, and only the last rows of a chunk are carried to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

_CHUNK = 24  # rows: longer costs products with zeros, shorter more turns


@dataclass(frozen=True, slots=True)
class BandedFactor:
    """A lower banded factor in chunks, ready to be solved.

    inverse : (c, k, k) of each chunk's diagonal block, of k rows
    corner : (c − 1, d, d) of L, from the last rows of a chunk to those of the next
    """

    inverse: Float64[np.ndarray, "c k k"]
    corner: Float64[np.ndarray, "_ d d"]

    @staticmethod
    def of(factor: Float64[np.ndarray, "b m"]) -> BandedFactor:
        """From a factor whose band i is i rows below the diagonal."""
        bands, size = factor.shape
        below, count = bands - 1, -(-size // _CHUNK)
        padded = np.zeros((bands, count * _CHUNK))
        padded[0] = 1.0
        padded[:, :size] = factor
        band = padded.reshape(bands, count, _CHUNK)
        column = np.arange(_CHUNK)
        block = np.zeros((count, _CHUNK, _CHUNK))
        corner = np.zeros((count - 1, below, below))
        for i in range(bands):
            here = _CHUNK - i
            block[:, column[i:], column[:here]] = band[i, :, :here]
            corner[:, column[:i], column[below - i : below]] = band[i, :-1, here:]
        return BandedFactor(np.linalg.inv(block), corner)

    def solve_half(
        self, right: Float64[np.ndarray, "m p"]
    ) -> Float64[np.ndarray, "m p"]:
        """L⁻¹ right."""
        solved = self.inverse @ self._cut(right)
        below = self.corner.shape[1]
        carry = self.inverse[1:, :, :below] @ self.corner
        for k, taken in enumerate(carry, start=1):
            solved[k] -= taken @ solved[k - 1, -below:]
        return self._join(solved, right)

    def solve(self, right: Float64[np.ndarray, "m p"]) -> Float64[np.ndarray, "m p"]:
        """(L Lᵀ)⁻¹ right."""
        turned = np.swapaxes(self.inverse, 1, 2)
        solved = turned @ self._cut(self.solve_half(right))
        below = self.corner.shape[1]
        carry = turned[:-1, :, -below:] @ np.swapaxes(self.corner, 1, 2)
        for k in range(len(carry) - 1, -1, -1):
            solved[k] -= carry[k] @ solved[k + 1, :below]
        return self._join(solved, right)

    def _cut(self, rows: Float64[np.ndarray, "m p"]) -> Float64[np.ndarray, "c k p"]:
        count = len(self.inverse)
        padded = np.pad(rows, ((0, count * _CHUNK - len(rows)), (0, 0)))
        return padded.reshape(count, _CHUNK, rows.shape[1])

    def _join(
        self, chunks: Float64[np.ndarray, "c k p"], like: Float64[np.ndarray, "m p"]
    ) -> Float64[np.ndarray, "m p"]:
        return chunks.reshape(len(chunks) * _CHUNK, like.shape[1])[: len(like)]
