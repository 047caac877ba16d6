"""How long something took, counted by classes: what a histogram of a plant shows."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

BOUNDS_S = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)


@dataclass(frozen=True, slots=True)
class Durations:
    """Durations by class.

    counts : up to each of `BOUNDS_S` and above the one before, then those above all
    total_s : their sum
    """

    counts: tuple[int, ...] = (0,) * (len(BOUNDS_S) + 1)
    total_s: float = 0.0

    def add(self, duration_s: float) -> Durations:
        """Return these and one more."""
        counts = list(self.counts)
        counts[bisect_left(BOUNDS_S, duration_s)] += 1
        return replace(self, counts=tuple(counts), total_s=self.total_s + duration_s)

    def join(self, other: Durations) -> Durations:
        """Return these and the others."""
        counts = tuple(a + b for a, b in zip(self.counts, other.counts, strict=True))
        return Durations(counts, self.total_s + other.total_s)
