"""Which samples of a stream can be used at all."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from drivers.interfaces.records import TrackerSamples

_SPIKE_MM = 0.03  # well above the noise of any tracker within its range
_ROUNDS = 3  # a spike beside a spike shows once the larger one is gone


def find_valid_samples(samples: TrackerSamples) -> Bool[np.ndarray, " n"]:
    """Tell which samples are measurements: status 0, finite, not a lone spike."""
    valid = (samples.status == 0) & np.isfinite(samples.position_mm).all(axis=1)
    for _ in range(_ROUNDS):
        kept = np.flatnonzero(valid)
        spikes = _spikes(samples.device_time_s[kept], samples.position_mm[kept])
        if not spikes.any():
            break
        valid[kept[spikes]] = False
    return valid


def _spikes(
    time_s: Float64[np.ndarray, " n"], position_mm: Float64[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Tell which samples lie off the straight motion between their two neighbours.

    In time, so that a gap in steady motion is none; the largest of three counts, as a
    spike lifts its neighbours half as far.
    """
    spikes = np.zeros(len(time_s), bool)
    if len(time_s) < 3:
        return spikes
    share = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    between = position_mm[:-2] + share[:, None] * (position_mm[2:] - position_mm[:-2])
    off = np.linalg.norm(position_mm[1:-1] - between, axis=1)
    limit = max(_SPIKE_MM, 10.0 * float(np.median(off)))
    around = np.pad(off, 1)
    spikes[1:-1] = (off > limit) & (off >= around[:-2]) & (off >= around[2:])
    return spikes
