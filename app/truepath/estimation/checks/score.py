"""Score tests (Rao 1948): what a fit would gain if parameters were added to it.

Computed from the residuals of the fit, without another solve. With r = y − Aθ, W = V⁻¹
(timing of the lines taken out), H = AᵀWA + prior and columns B of possible additions,
the gain is gᵀF⁻¹g with g = BᵀWr and F = BᵀWB − BᵀWA H⁻¹ AᵀWB.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Float64
from scipy.special import chdtri

_RISK = 0.003  # that chance exceeds a limit, in a clean measurement
STEP_MARGIN = 1.7  # over χ², for changes of the set-up: noise has longer tails
MEDIAN_OF_THREE = 2.366  # of χ² of three
_UNSEEN = 1e-4  # of a column's information: the fit explains it all


def compute_limit(columns: int, tests: int) -> float:
    """Gain by so many columns that chance rarely exceeds in any of the tests."""
    return float(chdtri(columns, _RISK / max(tests, 1)))


def compute_score(
    left: Float64[np.ndarray, "l k k"],
    raw: Float64[np.ndarray, "l k k"],
    pulled: Float64[np.ndarray, "l k"],
    unseen: float = _UNSEEN,
) -> tuple[Float64[np.ndarray, "l k k"], Float64[np.ndarray, "l k"]]:
    """R and Rᵀ `pulled`, with RRᵀ the inverse of the remaining information `left`.

    raw : information before elimination; directions that keep no more than a share
        `unseen` of it are dropped: the fit explains them
    """
    own = np.einsum("lii->li", raw)
    scale = np.where(own > 0.0, own, np.inf) ** -0.5
    scaled = left * scale[:, :, None] * scale[:, None, :]
    value, vector = np.linalg.eigh(scaled)
    seen = value > unseen
    size = np.where(seen, 1.0 / np.sqrt(np.where(seen, value, 1.0)), 0.0)
    root = scale[:, :, None] * vector * size[:, None, :]
    return root, np.einsum("lij,li->lj", root, pulled)


@dataclass(frozen=True)
class ScoredColumns:
    """Sets of columns that might be added, each alone, conditional on given columns.

    Given columns are eliminated, with all that the sets share with them and with the
    fit.

    known : products with the fit and the given columns, whitened
    raw, left : information before and after elimination; pulled : score g = BᵀWr
    """

    known: Float64[np.ndarray, "l m k"]
    raw: Float64[np.ndarray, "l k k"]
    left: Float64[np.ndarray, "l k k"]
    pulled: Float64[np.ndarray, "l k"]

    @cached_property
    def score(self) -> tuple[Float64[np.ndarray, "l k k"], Float64[np.ndarray, "l k"]]:
        """R and Rᵀ `pulled`, with RRᵀ the inverse of the remaining information."""
        return compute_score(self.left, self.raw, self.pulled)

    @property
    def gain(self) -> Float64[np.ndarray, " l"]:
        """χ² that each set would take off the fit."""
        return np.sum(self.score[1] ** 2, axis=1)

    @property
    def value(self) -> Float64[np.ndarray, "l k"]:
        root, score = self.score
        return np.einsum("lij,lj->li", root, score)

    def select(self, part: slice) -> Self:
        parts = {each.name: getattr(self, each.name)[part] for each in fields(self)}
        return replace(self, **parts)

    def select_one(self, k: int) -> Self:
        """The leading dimension stays, of length 1."""
        return self.select(slice(k, k + 1))

    def condition_on(
        self, one: ScoredColumns, shared: Float64[np.ndarray, "l j k"]
    ) -> Self:
        """Conditional on one more set of columns.

        shared : products of the columns of both
        """
        root, score = one.score
        own = root[0].T @ (shared - one.known[0].T @ self.known)
        return self.eliminate_with(
            np.concatenate([self.known, own], axis=1), own, score[0]
        )

    def eliminate_with(
        self,
        known: Float64[np.ndarray, "l n k"],
        own: Float64[np.ndarray, "l j k"],
        score: Float64[np.ndarray, " j"],
    ) -> Self:
        """Eliminates columns by whitened products `own`, part of `known`."""
        return replace(
            self,
            known=known,
            left=self.left - np.swapaxes(own, 1, 2) @ own,
            pulled=self.pulled - np.einsum("lji,j->li", own, score),
        )
