"""Mean, 95th percentile and largest length of vectors that are known with noise.

A length of a noisy vector is too long on average: its square by the trace of the
covariance of the noise, which is subtracted. The remaining effect of the noise on a
statistic is found by adding noise once more (a parametric bootstrap; Efron & Tibshirani
1993, chapter 10) and subtracted as well; the uncertainty has its spread, the second
subtraction, the uncertainty of the size of the noise, and the scale that all points
have in common. Where noise is larger than the lengths the bootstrap shows only a part
of what noise adds to their upper end: there twice as much counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.files.units import UM_PER_MM
from truepath.results.volumetric_error import TWICE, compute_scale_uncertainty

NAMES = ("mean", "p95", "largest")
_SHARE = 0.95
_TAKEN_OFF = np.array([1.0, 2.0, 2.0])  # of what was taken off, by `NAMES`
DRAWS = 400


@dataclass(frozen=True, slots=True)
class Statistic:
    """A number in µm with its standard uncertainty (k = 1)."""

    value_um: float
    uncertainty_um: float


LengthStatistics = dict[str, Statistic]
"""By `mean`, `p95` and `largest`."""


def compute_measured_statistics(
    vector_mm: Float64[np.ndarray, "n 3"],
    noise_mm: Float64[np.ndarray, "n 3 d"],
    known_by: float,
    scale_mm: Float64[np.ndarray, "n 3"],
) -> LengthStatistics:
    """Statistics of vectors that include noise.

    noise_mm : sampled from its distribution
    known_by : degrees of freedom of the size of the noise
    scale_mm : by one standard uncertainty of the scale
    """
    added = np.mean(np.sum(noise_mm**2, axis=1), axis=1)
    length = _take_off(vector_mm[:, :, None], added)
    value = _state(UM_PER_MM * length)[:, 0]
    # Adding noise to the apparent lengths shows the bias that remains.
    seems = vector_mm * length / np.linalg.norm(vector_mm, axis=1)[:, None]
    again = _state(UM_PER_MM * _take_off(seems[:, :, None] + noise_mm, added))
    bias = again.mean(axis=1) - value
    more = added * (1.0 + np.sqrt(2.0 / known_by))
    louder = _state(UM_PER_MM * _take_off(vector_mm[:, :, None], more))[:, 0] - value
    scaled = vector_mm[:, :, None] + scale_mm[:, :, None] * np.array(TWICE)
    common = compute_scale_uncertainty(
        value, _state(UM_PER_MM * _take_off(scaled, added))
    )
    spread = np.sqrt(
        again.var(axis=1) + (_TAKEN_OFF * bias) ** 2 + louder**2 + common**2
    )
    # Each is at least as long as the one before, whatever the noise.
    value = np.maximum.accumulate(np.maximum(value - bias, 0.0))
    return _name(value, spread)


def _take_off(
    vector_mm: Float64[np.ndarray, "n 3 d"], added: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n d"]:
    square = np.sum(vector_mm**2, axis=1) - added[:, None]
    return np.sqrt(np.maximum(square, 0.0))


def compute_predicted_statistics(
    vector_mm: Float64[np.ndarray, "n 3"], departure_mm: Float64[np.ndarray, "n 3 d"]
) -> LengthStatistics:
    """Statistics of vectors that may deviate from a prediction.

    departure_mm : sampled from the distribution of truth less prediction
    """
    length = np.linalg.norm(vector_mm[:, :, None] + departure_mm, axis=1)
    drawn = _state(UM_PER_MM * length)
    return _name(drawn.mean(axis=1), drawn.std(axis=1))


def _state(length: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "3 d"]:
    return np.stack(
        [length.mean(axis=0), np.quantile(length, _SHARE, axis=0), length.max(axis=0)]
    )


def _name(
    value: Float64[np.ndarray, "3"], spread: Float64[np.ndarray, "3"]
) -> LengthStatistics:
    pairs = zip(value.tolist(), spread.tolist(), strict=True)
    return {name: Statistic(*pair) for name, pair in zip(NAMES, pairs, strict=True)}
