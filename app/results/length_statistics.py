"""Mean, 95th percentile and largest length of vectors that are known with noise.

A length of a noisy vector is too long on average: its square by the trace of the
covariance of the noise, which is taken off. The standard uncertainty of a statistic is
its spread when noise is added once more (a parametric bootstrap; Efron & Tibshirani
1993, chapter 6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.app.files.units import UM_PER_MM

NAMES = ("mean", "p95", "largest")
_SHARE = 0.95
DRAWS = 400


@dataclass(frozen=True, slots=True)
class Statistic:
    """A number in µm with its standard uncertainty (k = 1)."""

    value_um: float
    uncertainty_um: float


LengthStatistics = dict[str, Statistic]
"""By `mean`, `p95` and `largest`."""


def state_measured(
    vector_mm: Float64[np.ndarray, "n 3"], noise_mm: Float64[np.ndarray, "n 3 d"]
) -> LengthStatistics:
    """Return the statistics of vectors, of which noise is part.

    noise_mm : drawn from its distribution
    """
    square = np.sum(vector_mm**2, axis=1) - np.mean(np.sum(noise_mm**2, axis=1), axis=1)
    value = _state(UM_PER_MM * np.sqrt(np.maximum(square, 0.0))[:, None])[:, 0]
    return _name(value, _compute(vector_mm[:, :, None] + noise_mm))


def state_predicted(
    vector_mm: Float64[np.ndarray, "n 3"], departure_mm: Float64[np.ndarray, "n 3 d"]
) -> LengthStatistics:
    """Return what is expected of vectors that may depart from a prediction.

    departure_mm : drawn from the distribution of truth less prediction
    """
    drawn = _compute(vector_mm[:, :, None] + departure_mm)
    return _name(drawn.mean(axis=1), drawn)


def _compute(vector_mm: Float64[np.ndarray, "n 3 d"]) -> Float64[np.ndarray, "3 d"]:
    return _state(UM_PER_MM * np.linalg.norm(vector_mm, axis=1))


def _state(length: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "3 d"]:
    return np.stack(
        [length.mean(axis=0), np.quantile(length, _SHARE, axis=0), length.max(axis=0)]
    )


def _name(
    value: Float64[np.ndarray, "3"], drawn: Float64[np.ndarray, "3 d"]
) -> LengthStatistics:
    pairs = zip(value.tolist(), drawn.std(axis=1).tolist(), strict=True)
    return {name: Statistic(*pair) for name, pair in zip(NAMES, pairs, strict=True)}
