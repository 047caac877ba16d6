"""Splines believed in but not yet measured: the two priors that are compared.

Both give every spline the same mean variance over its length. `independent` is that of
brunn-hanebeck-2005: control points know nothing of one another. `bending` charges for
the energy of the bent beam (eq. 12–13) between two ends that are independent.
"""

from __future__ import annotations

import numpy as np

from truepath.kinematics.splines import CubicSpline
from truepath.numerics.design_criteria import IntegratedVariance


def independent(spline: CubicSpline) -> IntegratedVariance:
    """Return independent control points of variance 1."""
    return IntegratedVariance(np.eye(spline.size), spline.gram())


def bending(spline: CubicSpline) -> IntegratedVariance:
    """Return a beam whose bending energy is charged for, ends of variance 1."""
    ends = np.column_stack(
        [np.linspace(1.0, 0.0, spline.size), np.linspace(0.0, 1.0, spline.size)]
    )
    beam = np.zeros((spline.size, spline.size))
    beam[1:-1, 1:-1] = np.linalg.inv(spline.bending()[1:-1, 1:-1])
    gram = spline.gram()
    wanted = np.trace(gram) - np.trace(gram @ ends @ ends.T)
    return IntegratedVariance(
        ends @ ends.T + wanted / np.trace(gram @ beam) * beam, gram
    )


def stack(beliefs: list[IntegratedVariance]) -> IntegratedVariance:
    """Return what is believed of several splines together."""
    size = sum(len(b.gram) for b in beliefs)
    covariance, gram = np.zeros((size, size)), np.zeros((size, size))
    begin = 0
    for belief in beliefs:
        part = slice(begin, begin + len(belief.gram))
        covariance[part, part], gram[part, part] = belief.covariance, belief.gram
        begin = part.stop
    return IntegratedVariance(covariance, gram)


def draw(
    belief: IntegratedVariance, rng: np.random.Generator, count: int
) -> np.ndarray:
    value, vector = np.linalg.eigh(belief.covariance)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    return rng.standard_normal((count, len(value))) @ root.T


def sigma(belief: IntegratedVariance, rows: np.ndarray) -> np.ndarray:
    variance = np.einsum("np,pq,nq->n", rows, belief.covariance, rows)
    return np.sqrt(np.maximum(variance, 0.0))


def learnt(
    before: IntegratedVariance,
    estimate: np.ndarray,
    row: np.ndarray,
    noise_variance: float,
    measured: np.ndarray,
) -> np.ndarray:
    """Return estimates (m, p) after one measurement of each of m truths (eq. 21)."""
    moved = before.covariance @ row
    gain = moved / (noise_variance + row @ moved)
    return estimate + (measured - estimate @ row)[:, None] * gain
