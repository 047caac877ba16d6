"""Where a stream has no usable samples: a broken beam, samples that are lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath.drivers.interfaces.records import TrackerSamples


@dataclass(frozen=True, slots=True)
class Interruptions:
    """How often a stream was not usable, and for how long altogether.

    breaks, broken_s : stretches of samples that the tracker calls invalid
    gaps, lost_samples : places where the counter steps by more than one
    searches, found : tries of the tracker to find a lost target by itself that failed,
        and that have found it
    """

    breaks: int = 0
    broken_s: float = 0.0
    gaps: int = 0
    lost_samples: int = 0
    searches: int = 0
    found: int = 0


NO_INTERRUPTIONS = Interruptions()


def find_interruptions(
    tracker: TrackerSamples, searches: int = 0, found: int = 0
) -> Interruptions:
    """Return the interruptions of a stream, with the searches that were recorded."""
    if len(tracker) < 2:
        return Interruptions(searches=searches, found=found)
    is_bad = np.concatenate([[False], tracker.status != 0, [False]])
    begin, end = np.flatnonzero(np.diff(is_bad.astype(int))).reshape(-1, 2).T
    step_s = float(np.median(np.diff(tracker.device_time_s)))
    skipped = np.diff(tracker.sequence) - 1
    return Interruptions(
        len(begin),
        float((end - begin).sum()) * step_s,
        int((skipped > 0).sum()),
        int(skipped[skipped > 0].sum()),
        searches,
        found,
    )
