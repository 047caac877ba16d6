"""Several configurations ahead: greedy choice, then exchange.

The order of scalar measurements does not matter (brunn-hanebeck-2005, section IV), but
which ones they are does: the first of a greedy choice were chosen without the others.
So each is taken out again and replaced by the best one given all others, as long as
that lowers J; places that share a summit with a better one move there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_factor, cho_solve

from app.numerics.design_criteria import Belief
from app.planning.next_configuration import (
    PositionRows,
    SearchSpace,
    climbed_from,
    next_configuration,
)

_GAIN = 1e-3  # share of J by which a whole round of exchanges must pay


@dataclass(frozen=True, slots=True)
class Ahead:
    """Configurations, and what is known once all are measured."""

    position: Float64[np.ndarray, "m a"]
    known: Belief


def configurations_ahead(
    known: Belief,
    rows: PositionRows,
    axes: SearchSpace,
    noise_variance: float,
    count: int,
    *,
    rounds: int = 2,
    seed: int = 0,
) -> Ahead:
    """Return `count` configurations that together lower J most.

    rounds : of exchange after the greedy choice, at most
    """
    start, chosen = known, np.empty((0, len(axes.borders)))
    for turn in range(count):
        best = next_configuration(known, rows, axes, noise_variance, seed=seed + turn)
        chosen = np.vstack([chosen, best.position])
        known = known.after(rows(best.position[None])[0], noise_variance)
    for number in range(rounds):
        before = known.integrated_variance
        chosen, known = _exchanged(
            start, chosen, rows, axes, noise_variance, seed + count * (number + 1)
        )
        if known.integrated_variance > before * (1.0 - _GAIN):
            break
    return Ahead(chosen, known)


def _exchanged(
    start: Belief,
    chosen: Float64[np.ndarray, "m a"],
    rows: PositionRows,
    axes: SearchSpace,
    noise_variance: float,
    seed: int,
) -> tuple[Float64[np.ndarray, "m a"], Belief]:
    """Replace each configuration by the best one given all others."""
    chosen = chosen.copy()
    prior = _inverse(start.covariance)
    told = [_information(rows, q, noise_variance) for q in chosen]
    total = prior + np.sum(told, axis=0)
    for k, here in enumerate(chosen):
        total -= told[k]
        others = Belief(_inverse(total), start.gram)
        found = next_configuration(others, rows, axes, noise_variance, seed=seed + k)
        moved = climbed_from(others, rows, axes, noise_variance, here)
        chosen[k] = max(found, moved, key=lambda best: best.drop).position
        told[k] = _information(rows, chosen[k], noise_variance)
        total += told[k]
    return chosen, Belief(_inverse(total), start.gram)


def _information(
    rows: PositionRows, position: Float64[np.ndarray, " a"], noise_variance: float
) -> Float64[np.ndarray, "p p"]:
    found = rows(position[None])
    H = found.reshape(-1, found.shape[-1])
    return H.T @ H / noise_variance


def _inverse(matrix: Float64[np.ndarray, "p p"]) -> Float64[np.ndarray, "p p"]:
    """Return the inverse of a positive definite matrix of unlike units."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * scale[:, None] * scale, lower=True)
    inverse = cho_solve(factor, np.eye(len(matrix)))
    return inverse * scale[:, None] * scale
