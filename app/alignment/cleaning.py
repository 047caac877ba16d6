"""Which samples of a stream can be used at all."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from app.errors import AlignmentError
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


_CLOSE = 2.0  # a size within this factor of a unit's is of that unit
_FAR = 8.0  # no path, hand-carried part or pause changes a size by this factor
_LENGTHS = {"m": 1e-3, "inch": 1.0 / 25.4, "µm": 1e3}
_TIMES = {"ms": 1e3, "µs": 1e6, "ns": 1e9}


def require_units(
    time_s: Float64[np.ndarray, " n"],
    tracker_mm: Float64[np.ndarray, "n 3"],
    place_mm: Float64[np.ndarray, "m 3"],
    rate_hz: float,
) -> None:
    """Refuse a stream in metres, inches or milliseconds, by its size.

    place_mm : nominal target points of the path
    Raises AlignmentError naming the column and the unit that would fit.
    """
    size = _size(np.percentile(tracker_mm, [1.0, 99.0], axis=0))
    ratio = size / max(
        _size(np.array([place_mm.min(axis=0), place_mm.max(axis=0)])), 1.0
    )
    unit = _unit(ratio, _LENGTHS)
    if unit:
        raise AlignmentError(
            f"the stream spans {size:.3g} mm, {ratio:.2g} times what the path does: "
            f"x_mm, y_mm and z_mm look like {unit}; convert them to mm"
        )
    step = float(np.median(np.diff(time_s)))
    unit = _unit(step * rate_hz, _TIMES)
    if unit:
        raise AlignmentError(
            f"t_s steps by {step:.3g} at rate_hz {rate_hz:g}: it looks like {unit}; "
            "convert it to s"
        )


def _size(ends: Float64[np.ndarray, "2 3"]) -> float:
    return float(np.linalg.norm(ends[1] - ends[0]))


def _unit(ratio: float, units: dict[str, float]) -> str:
    """Return the unit that makes a size `ratio` times too large, else nothing."""
    if 1.0 / _FAR < ratio < _FAR:
        return ""
    fitting = (u for u, r in units.items() if 1.0 / _CLOSE < ratio / r < _CLOSE)
    return next(fitting, "")
