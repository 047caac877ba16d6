"""Valid samples that are not used: which, how far off, and why.

A measurement may contain samples that the tracker calls valid and that are wrong: the
beam jumps to another reflection, a sign is lost, the head freezes. They are excluded,
and each exclusion is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.alignment.stream.cleaning import STALLED
from truepath_drivers.interfaces.records import TrackerSamples

Cause = Literal[
    "spikes",
    "burst",
    "frozen",
    "stalled",
    "off-line",
    "outliers",
    "cells",
    "line",
    "no-pass",
    "no-stop",
    "astray",
    "before",
    "after",
    "again",
]
NOT_MEASURED = frozenset(("no-pass", "no-stop"))
_LONGEST_SPIKE = 3  # samples; more in a row are a burst
_MOSTLY = 0.5  # of the samples repeat the one before: frozen
_FEWEST_OUTLIERS = 5  # of one line; fewer are counted with the spikes


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Samples that are not used although the tracker calls them valid.

    cause : `spikes` (lone samples, all together), `burst`, `frozen` (one value
        repeated), `stalled` (almost equal time stamps), `off-line` (beside the
        commanded line), `outliers` (samples far from their neighbours), `cells`
        (stretches far from their neighbours, or from the machine's errors on all other
        lines), `line` (all of a line), `no-pass` (a line without a stretch at constant
        feed), `no-stop` (a point without a standstill), `astray` (a part whose
        standstills match no point, from this row on), `before`, `after` (data outside
        the path, `samples` being its standstills), `again` (also outside, but the same
        program, run once more)
    row : of the commanded path or points; −1 where there is none
    begin_s, end_s : on the tracker's clock; NaN where there is no data
    off_mm : largest deviation
    """

    cause: Cause
    row: int
    begin_s: float
    end_s: float
    samples: int
    off_mm: float


def describe_unusable(
    samples: TrackerSamples, usable: Bool[np.ndarray, " n"]
) -> list[LeftOut]:
    """Records of the valid samples that cleaning has excluded."""
    valid = samples.status == 0
    lost = np.flatnonzero(valid & ~usable)
    kept = np.flatnonzero(usable)
    if not len(lost) or len(kept) < 2:
        return []
    time_s, position_mm = samples.device_time_s, samples.position_mm
    # Stretches between which no sample is kept belong together.
    after = np.searchsorted(kept, lost)
    stretches = np.split(lost, np.flatnonzero(np.diff(after)) + 1)
    a = kept[np.clip(after - 1, 0, len(kept) - 2)]
    b = kept[np.clip(after, 1, len(kept) - 1)]
    share = (time_s[lost] - time_s[a]) / np.maximum(time_s[b] - time_s[a], 1e-9)
    stalled_s = STALLED * float(np.median(np.diff(time_s)))
    between = position_mm[a] + share[:, None] * (position_mm[b] - position_mm[a])
    off = np.linalg.norm(position_mm[lost] - between, axis=1)
    found: list[LeftOut] = []
    begin = 0
    for stretch in stretches:
        mine = off[begin : begin + len(stretch)]
        begin += len(stretch)
        same = np.diff(position_mm[stretch], axis=0).any(axis=1) == 0
        frozen = len(stretch) > 1 and bool(same.mean() > _MOSTLY)
        cause: Cause = "frozen" if frozen else "burst"
        if len(stretch) > 1 and np.diff(time_s[stretch]).mean() < stalled_s:
            cause = "stalled"
        if len(stretch) <= _LONGEST_SPIKE:
            cause = "spikes"
        found.append(_describe(cause, -1, time_s[stretch], mine))
    return found


def describe_samples(
    cause: Cause,
    row: int,
    time_s: Float64[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
) -> list[LeftOut]:
    """At most one record; fewer than five outliers count as spikes."""
    if not len(time_s):
        return []
    if cause == "outliers" and len(time_s) < _FEWEST_OUTLIERS:
        cause = "spikes"
    return [_describe(cause, row, time_s, off_mm)]


def _describe(
    cause: Cause,
    row: int,
    time_s: Float64[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
) -> LeftOut:
    begin, end = float(time_s.min()), float(time_s.max())
    return LeftOut(cause, row, begin, end, len(time_s), float(off_mm.max()))


def gather(
    records: list[LeftOut],
    time_s: Float64[np.ndarray, " n"],
    row: Int64[np.ndarray, " n"],
) -> tuple[LeftOut, ...]:
    """Records in order of time, lone spikes merged, each with its line.

    time_s, row : of the cells, in order of time; they assign a burst to its line
    """
    spikes = [each for each in records if each.cause == "spikes"]
    found = [each for each in records if each.cause != "spikes"]
    for k, each in enumerate(found):
        if each.row < 0 and len(time_s):
            middle = 0.5 * (each.begin_s + each.end_s)
            near = int(np.argmin(np.abs(time_s - middle)))
            found[k] = replace(each, row=int(row[near]))
    if spikes:
        found.append(
            LeftOut(
                "spikes",
                -1,
                min(each.begin_s for each in spikes),
                max(each.end_s for each in spikes),
                sum(each.samples for each in spikes),
                max(each.off_mm for each in spikes),
            )
        )
    return tuple(
        sorted(found, key=lambda each: (np.nan_to_num(each.begin_s), each.row))
    )
