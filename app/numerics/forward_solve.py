"""L z = y with a banded factor of few diagonals, for many right-hand sides at once.

LAPACK goes through a band row by row and column by column, and waits for memory all the
while. In chunks of some rows the inverse is small and dense: most of the work is then
products of matrices, and only the last rows of a chunk are carried to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

_CHUNK = 24  # rows: longer costs products with zeros, shorter more turns


@dataclass(frozen=True, slots=True)
class ForwardSolve:
    """A lower banded factor, ready to be solved.

    inverse : (c, k, k) of each chunk's diagonal block, of k rows
    carry : (c − 1, k, d), what a chunk takes over from the last d rows before it
    """

    inverse: Float64[np.ndarray, "c k k"]
    carry: Float64[np.ndarray, "_ k d"]

    @staticmethod
    def of(factor: Float64[np.ndarray, "b m"]) -> ForwardSolve:
        """Return it for a factor whose band i is i rows below the diagonal."""
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
        inverse = np.linalg.inv(block)
        return ForwardSolve(inverse, inverse[1:, :, :below] @ corner)

    def solve(self, right: Float64[np.ndarray, "m p"]) -> Float64[np.ndarray, "m p"]:
        """Return L⁻¹ right."""
        size, columns = right.shape
        missing = self.inverse.shape[0] * _CHUNK - size
        padded = np.pad(right, ((0, missing), (0, 0)))
        solved = self.inverse @ padded.reshape(-1, _CHUNK, columns)
        below = self.carry.shape[2]
        for k, carry in enumerate(self.carry, start=1):
            solved[k] -= carry @ solved[k - 1, -below:]
        return solved.reshape(-1, columns)[:size]
