"""Which samples of a stream can be used at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from heapq import heapify, heappop, heappush

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.lib.stride_tricks import sliding_window_view

from truepath.errors import AlignmentError
from truepath_drivers.interfaces.records import TrackerSamples

_SPIKE_MM = 0.03  # well above the noise of any tracker within its range
_FASTEST_MM_S2 = 5000.0  # acceleration of a machine: no spike, however rare samples are
_AROUND_S, _FEWEST = 0.042, 5  # of samples: hardly changes the speed of a machine
_BESIDE = 0.1  # of the largest step nearby
_CLOSED = 0.3  # of the jumps: tolerance of a continuous motion
_REPEATED = 5  # equal values, or almost equal times, in a row: not measured
STALLED = 0.1  # of the typical time from sample to sample
_MOSTLY = 0.2  # of the samples: such time stamps are normal
_NOISELESS_MM = 1e-3  # change from step to step; of an arc without noise
_BRIEF_S = 5.0  # a target, if there are several, is measured for longer
_ROUNDS = 3  # a spike next to a spike shows once the larger one is removed
IsContinuous = Callable[
    [Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]], Bool[np.ndarray, " k"]
]
"""Whether the motion is continuous without stretches, by their first samples and
ends.
"""


def detect_valid_samples(
    samples: TrackerSamples, targets: Sequence[str] = ()
) -> Bool[np.ndarray, " n"]:
    """Mask of samples with status 0 on a continuous motion.

    Excludes lone spikes, bursts that jump aside and back, repeated values, and samples
    with almost equal time stamps.

    targets : of the rows; a change of target is a jump as well, and may return
    """
    longest_s = _BRIEF_S if len(set(targets)) > 1 else np.inf
    valid = samples.status == 0
    kept = np.flatnonzero(valid)
    valid[kept[_mark_frozen(samples.position_mm[kept])]] = False
    kept = np.flatnonzero(valid)
    valid[kept[_mark_stalled(samples.device_time_s[kept])]] = False
    for _ in range(_ROUNDS):
        kept = np.flatnonzero(valid)
        spikes = _mark_spikes(samples.device_time_s[kept], samples.position_mm[kept])
        if not spikes.any():
            break
        valid[kept[spikes]] = False
    kept = np.flatnonzero(valid)
    time_s, position_mm = samples.device_time_s[kept], samples.position_mm[kept]
    valid[kept[_mark_jumps_aside(time_s, position_mm, longest_s)]] = False
    return valid


def _mark_frozen(position_mm: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Mask of samples that repeat one value, where the others do not.

    No tracker measures the same point to the last digit twice in a row. A stream
    without any noise, as of a calculation, repeats itself at every standstill.
    """
    frozen = np.zeros(len(position_mm), bool)
    if len(position_mm) < 4 * _REPEATED:
        return frozen
    step = np.diff(position_mm, axis=0)
    if np.median(np.linalg.norm(np.diff(step, axis=0), axis=1)) < _NOISELESS_MM:
        return frozen
    return _mark_repeats(np.abs(step).max(axis=1) == 0.0)


def _mark_stalled(time_s: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Mask of samples with almost equal time stamps, unlike the others.

    They were stamped late, when they arrived, so their position at that time is
    unknown.
    """
    if len(time_s) < 4 * _REPEATED:
        return np.zeros(len(time_s), bool)
    step = np.diff(time_s)
    short = step < STALLED * float(np.median(step))
    return _mark_repeats(short & bool(short.mean() < _MOSTLY))


def _mark_repeats(same: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " n"]:
    """Mask of samples equal to their neighbours, several in a row.

    same : whether each but the first equals the one before
    """
    repeats = np.zeros(len(same) + 1, bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        repeats[first : last + 1] = last - first >= _REPEATED
    return repeats


def _mark_jumps_aside(
    time_s: Float64[np.ndarray, " n"],
    position_mm: Float64[np.ndarray, "n 3"],
    longest_s: float,
) -> Bool[np.ndarray, " n"]:
    """Mask of samples between a jump aside and the jump back, soon after.

    A jump is a step that no speed nearby explains. The shortest stretches between jumps
    go first; without them the motion must continue from where it was.
    """
    aside = np.zeros(len(time_s), bool)
    if len(time_s) < 2 * _FEWEST:
        return aside
    step_s = np.diff(time_s)
    around = max(_FEWEST, round(_AROUND_S / float(np.median(step_s))))
    if len(time_s) < 2 * around:
        return aside
    speed = np.diff(position_mm, axis=0) / step_s[:, None]
    typical = _block_medians(speed, around)
    off = np.linalg.norm(speed - typical, axis=1) * step_s
    limit = _limit_mm(off, time_s)
    # The typical speed deviates next to a jump as well, by far less.
    jumps = np.flatnonzero(off > limit)
    nearby = sliding_window_view(np.pad(off, around), 2 * around + 1)[jumps]
    jumps = jumps[off[jumps] > _BESIDE * nearby.max(axis=1, initial=0.0)]
    begin = np.concatenate([[0], jumps + 1])

    def is_continuous(
        first: Int64[np.ndarray, " k"], after: Int64[np.ndarray, " k"]
    ) -> Bool[np.ndarray, " k"]:
        # From the last sample before each stretch to the first one after it.
        a = first - 1
        later = typical[np.minimum(after + around, len(typical) - 1)]
        mean = 0.5 * (typical[np.maximum(a - around, 0)] + later)
        left = position_mm[after] - position_mm[a]
        left = left - mean * (time_s[after] - time_s[a])[:, None]
        least = np.minimum(off[a], off[after - 1])
        is_brief = time_s[after] - time_s[first] <= longest_s
        return is_brief & (np.linalg.norm(left, axis=1) < _CLOSED * least)

    for first, after in _list_jumps_aside(begin, len(time_s), is_continuous):
        aside[first:after] = True
    return aside


def _list_jumps_aside(
    begin: Int64[np.ndarray, " s"], end: int, is_continuous: IsContinuous
) -> Iterator[tuple[int, int]]:
    """Stretches without which the motion is continuous, the shortest first.

    The neighbours of a removed stretch are merged. Neither the first nor the last lies
    between two jumps.
    """
    first, last = begin.tolist(), len(begin) - 1
    after = [*first[1:], end]
    before, beyond = list(range(-1, last)), list(range(1, last + 2))
    inner = np.arange(1, last)
    kept = inner[is_continuous(begin[inner], begin[inner + 1])] if len(inner) else inner
    queue = [(after[k] - first[k], first[k], k) for k in kept.tolist()]
    heapify(queue)
    while queue:
        length, _, k = heappop(queue)
        if length != after[k] - first[k]:
            continue  # another one by now
        yield first[k], after[k]
        a, b = before[k], beyond[k]
        after[a], beyond[a] = after[b], beyond[b]
        if beyond[b] <= last:
            before[beyond[b]] = a
        after[k], after[b] = first[k], first[b]
        is_inner = a > 0 and beyond[a] <= last
        if is_inner and is_continuous(np.array([first[a]]), np.array([after[a]]))[0]:
            heappush(queue, (after[a] - first[a], first[a], a))


def _limit_mm(
    off_mm: Float64[np.ndarray, " m"], time_s: Float64[np.ndarray, " n"]
) -> float:
    bent = 0.5 * _FASTEST_MM_S2 * float(np.median(np.diff(time_s))) ** 2
    return max(_SPIKE_MM, 10.0 * float(np.median(off_mm)), bent)


def _block_medians(
    speed: Float64[np.ndarray, "m 3"], around: int
) -> Float64[np.ndarray, "m 3"]:
    blocks = len(speed) // around
    medians = np.median(speed[: blocks * around].reshape(blocks, around, 3), axis=1)
    middle = around * (np.arange(blocks) + 0.5) - 0.5
    at = np.arange(len(speed))
    straight = np.empty_like(speed)
    for axis in range(3):
        straight[:, axis] = np.interp(at, middle, medians[:, axis])
    return straight


def _mark_spikes(
    time_s: Float64[np.ndarray, " n"], position_mm: Float64[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Mask of samples off the straight motion between their two neighbours.

    In time, so that a gap in steady motion is none; the largest of three counts, as a
    spike lifts its neighbours half as far.
    """
    spikes = np.zeros(len(time_s), bool)
    if len(time_s) < 3:
        return spikes
    share = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    between = position_mm[:-2] + share[:, None] * (position_mm[2:] - position_mm[:-2])
    off = np.linalg.norm(position_mm[1:-1] - between, axis=1)
    limit = _limit_mm(off, time_s)
    around = np.pad(off, 1)
    spikes[1:-1] = (off > limit) & (off >= around[:-2]) & (off >= around[2:])
    return spikes


_CLOSE = 2.0  # a size within this factor of a unit's has that unit
_FAR = 8.0  # no path, hand-carried part or pause changes a size by this factor
_LENGTHS = {"m": 1e-3, "inch": 1.0 / 25.4, "µm": 1e3}
_TIMES = {"ms": 1e3, "µs": 1e6, "ns": 1e9}


def require_mm(
    tracker_mm: Float64[np.ndarray, "n 3"],
    place_mm: Float64[np.ndarray, "m 3"],
    file: str,
) -> None:
    """Reject a stream in metres or inches, by its size.

    place_mm : nominal target points of the path
    Raises AlignmentError naming the file, the columns and the unit that would fit.
    """
    size = _measure_size(np.percentile(tracker_mm, [1.0, 99.0], axis=0))
    ratio = size / max(
        _measure_size(np.array([place_mm.min(axis=0), place_mm.max(axis=0)])), 1.0
    )
    unit = _guess_unit(ratio, _LENGTHS)
    if unit:
        raise AlignmentError(
            f"{file}: the stream spans {size:.3g} mm, {ratio:.2g} times what the path "
            f"does: x_mm, y_mm and z_mm look like {unit}; convert them to mm, "
            f"{1.0 / _LENGTHS[unit]:g} times as much"
        )


def require_seconds(time_s: Float64[np.ndarray, " n"], rate_hz: float) -> None:
    """Reject a stream in milliseconds or less, by its steps.

    Raises AlignmentError naming the column and the unit that would fit.
    """
    step = float(np.median(np.diff(time_s)))
    unit = _guess_unit(step * rate_hz, _TIMES)
    if unit:
        raise AlignmentError(
            f"t_s steps by {step:.3g} at rate_hz {rate_hz:g}: it looks like {unit}; "
            "convert it to s"
        )


def _measure_size(ends: Float64[np.ndarray, "2 3"]) -> float:
    return float(np.linalg.norm(ends[1] - ends[0]))


def _guess_unit(ratio: float, units: dict[str, float]) -> str:
    if 1.0 / _FAR < ratio < _FAR:
        return ""
    fitting = (u for u, r in units.items() if 1.0 / _CLOSE < ratio / r < _CLOSE)
    return next(fitting, "")
