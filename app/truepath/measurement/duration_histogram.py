"""Durations counted by class, for histograms of a monitoring system."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

BOUNDS_S = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)


@dataclass(frozen=True, slots=True)
class DurationHistogram:
    """Durations by class.

    counts : above the previous of `BOUNDS_S` and up to this one; the last class is open
    total_s : their sum
    """

    counts: tuple[int, ...] = (0,) * (len(BOUNDS_S) + 1)
    total_s: float = 0.0

    def add(self, duration_s: float) -> DurationHistogram:
        """A copy with one more duration."""
        counts = list(self.counts)
        counts[bisect_left(BOUNDS_S, duration_s)] += 1
        return replace(self, counts=tuple(counts), total_s=self.total_s + duration_s)

    def join(self, other: DurationHistogram) -> DurationHistogram:
        """Class by class sum."""
        counts = tuple(a + b for a, b in zip(self.counts, other.counts, strict=True))
        return DurationHistogram(counts, self.total_s + other.total_s)
