"""Which samples of a stream can be used at all."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import median_filter

from drivers.interfaces.records import TrackerSamples

_SPIKE_MM = 0.03  # well above the noise of any tracker within its range


def valid_samples(samples: TrackerSamples) -> Bool[np.ndarray, " n"]:
    """Tell which samples are measurements: status 0, finite, not a lone spike."""
    valid = (samples.status == 0) & np.isfinite(samples.position_mm).all(axis=1)
    kept = np.flatnonzero(valid)
    valid[kept[_is_spike(samples.position_mm[kept])]] = False
    return valid


def _is_spike(position_mm: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    # A running median leaves steady motion alone, and a jump across a gap as well.
    excess = np.abs(
        position_mm - median_filter(position_mm, size=(5, 1), mode="nearest")
    )
    scale = 1.4826 * np.median(excess, axis=0) if len(excess) else np.zeros(3)
    return np.any(excess > np.maximum(_SPIKE_MM, 10.0 * scale), axis=1)
