"""Quality of samples as reported by the instrument, over a whole Run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath_drivers.interfaces.records import TrackerSamples

_LOW_PERCENT = 5.0


@dataclass(frozen=True, slots=True)
class SampleQuality:
    """Quality of the valid samples, 1 is best.

    low : one of twenty samples is worse
    told : share of the samples with a reported quality
    """

    mean: float
    low: float
    told: float


def state_quality(samples: TrackerSamples) -> SampleQuality | None:
    """None where the instrument reports none for any valid sample."""
    if samples.quality is None:
        return None
    valid = samples.quality[samples.status == 0].astype(np.float64)
    told = valid[np.isfinite(valid)]
    if not len(told):
        return None
    low = float(np.percentile(told, _LOW_PERCENT))
    return SampleQuality(float(told.mean()), low, len(told) / len(valid))
