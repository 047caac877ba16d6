"""Columns whitened line by line, phase and speed of each line taken out of them.

With columns a, b on a line, V its noise and T its phase and speed,

    aᵀ V⁻¹ b − aᵀ V⁻¹ T (Tᵀ V⁻¹ T)⁻¹ Tᵀ V⁻¹ b = a₊ᵀ b₊ − a₋ᵀ b₋ :

what white noise alone would tell, less what Ornstein–Uhlenbeck noise and timing take
away. Made once, the halves of a column give its sums with any other by one product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.discovery.view import TIMING, View, line_rows
from app.estimation.noise import whiten
from app.numerics.correlated_noise import Whitener

_NOTHING = 1e-12

_Pair = tuple[Float64[np.ndarray, "m p"], Float64[np.ndarray, "s p"]]


@dataclass(frozen=True)
class Halves:
    """Columns on lines, one after another.

    plus : (m, p); minus : (s, p); begin : (l + 1, 2) first row of each line in either,
        and one past the last
    """

    plus: Float64[np.ndarray, "m p"]
    minus: Float64[np.ndarray, "s p"]
    begin: Int64[np.ndarray, "l 2"]

    @staticmethod
    def of_line(
        plus: Float64[np.ndarray, "m p"], minus: Float64[np.ndarray, "s p"]
    ) -> Halves:
        """Return the halves on one line."""
        return Halves(plus, minus, np.array([[0, 0], [len(plus), len(minus)]]))

    @staticmethod
    def joined(lines: Sequence[Halves]) -> Halves:
        """Return the halves on all lines, in their order."""
        length = [[0, 0], *([len(h.plus), len(h.minus)] for h in lines)]
        return Halves(
            np.concatenate([h.plus for h in lines]),
            np.concatenate([h.minus for h in lines]),
            np.cumsum(length, axis=0),
        )

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.plus.shape[1]

    def columns(self, own: slice) -> Halves:
        """Return some of the columns."""
        plus, minus = (np.asfortranarray(h[:, own]) for h in (self.plus, self.minus))
        return Halves(plus, minus, self.begin)

    def between(self, first: int, last: int) -> Halves:
        """Return the halves on some lines that follow one another."""
        (a, b), (c, d) = self.begin[first], self.begin[last]
        begin = self.begin[first : last + 1] - self.begin[first]
        return Halves(self.plus[a:c], self.minus[b:d], begin)

    def times(self, other: Halves) -> Float64[np.ndarray, "p q"]:
        """Return the sums of these columns with others, on the same lines."""
        return self.plus.T @ other.plus - self.minus.T @ other.minus


@dataclass(frozen=True)
class Line:
    """One line or standstill: what whitens its columns, and its base.

    run, cells : where its cells are; timing : phase and speed, whitened and made
        orthonormal, as far as they are told
    rows : (n, 3, q) timing, machine, poses, data in the beam frame
    base : machine, poses, data, whitened; freedom : observations less phase and speed
    log_determinant : of its noise, and of what timing told
    """

    run: int
    cells: slice
    frame: Float64[np.ndarray, "n 3 3"]
    whitener: Whitener
    rows: Float64[np.ndarray, "n 3 q"]
    timing: _Pair
    base: Halves
    freedom: float
    log_determinant: float

    def whitened(self, columns: Float64[np.ndarray, "n 3 p"]) -> Halves:
        """Return columns of this line's cells as they count."""
        own = np.matmul(self.frame, columns)
        return _without(self.whitener.halves(own), self.timing)


def line_of(view: View, run: int, first: int, last: int) -> Line:
    """Return one line or standstill of a Run, ready to whiten columns.

    run : which of the Runs; first, last : its first cell, and one past its last
    """
    seen = view.seen.taken(np.arange(first, last))
    rows, frame = line_rows(seen, view.base, ())
    whitener = whiten(seen, view.base.noise, frame)
    plus, minus = whitener.halves(rows)
    square = np.sum(plus**2, axis=0) - np.sum(minus**2, axis=0)
    told = np.flatnonzero(square[:TIMING] > _NOTHING * float(np.max(square[:-1])))
    timing, log_timing = _told(plus[:, told], minus[:, told])
    across = view.base.noise.along_sigma_mm == np.inf and seen.at.line[0] >= 0
    return Line(
        run,
        slice(first, last),
        frame,
        whitener,
        rows,
        timing,
        _without((plus[:, TIMING:], minus[:, TIMING:]), timing),
        (2.0 if across else 3.0) * len(seen) - len(told),
        whitener.log_determinant + log_timing,
    )


def _told(
    plus: Float64[np.ndarray, "m t"], minus: Float64[np.ndarray, "s t"]
) -> tuple[_Pair, float]:
    """Return phase and speed made orthonormal, and the log determinant of what is told.

    What may be told of neither is left out.
    """
    factor = np.linalg.cholesky(plus.T @ plus - minus.T @ minus)
    inverse = np.linalg.inv(factor).T
    log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
    return (plus @ inverse, minus @ inverse), log_determinant


def _without(columns: _Pair, timing: _Pair) -> Halves:
    """Return the halves of columns once phase and speed have taken their share."""
    taken = timing[0].T @ columns[0] - timing[1].T @ columns[1]
    return Halves.of_line(columns[0], np.concatenate([columns[1], taken]))
