"""Time limits of a measurement, and the clocks that measure them."""

from __future__ import annotations

import threading
from bisect import bisect_left
from dataclasses import dataclass, field, replace

from truepath_drivers import host_clock
from truepath_drivers.interfaces.tracker_records import Light


@dataclass(frozen=True, slots=True)
class StreamTimeouts:
    """Limits of a degraded stream, in seconds that the host has run.

    damaged_share : tolerated fraction of bad or lost samples in a second; damaged_s :
        time above it that ends the measurement
    late_s : most that counts of a time in which the host did not run: a suspended or
        starved process reads nothing, and finds all data waiting afterwards
    point_s : tolerated time of a point beyond its dwell, for a polled tracker
    search_s : time after a lost beam in which a tracker may find its target again for
        an automatic resume: too short for anybody to be at the machine; at 0 it never
        searches
    """

    silent_s: float = 0.5
    dead_s: float = 5.0
    beam_s: float = 0.25
    damaged_share: float = 0.01
    damaged_s: float = 10.0
    late_s: float = 0.25
    point_s: float = 20.0
    search_s: float = 10.0


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Times of the host in seconds unless a clock is named.

    confirm_s : limit for confirming a hold, a cycle start or a resume
    stale_s : a controller whose last valid status is older is not fed, and is held
    link_s : the controller may be out of reach for so long
    stuck_s : a running machine has to move within it, beyond the longest planned row
    lead_s : stream before the first and after the last motion, tracker's clock
    settle_s : between the end of a move and the dwell at a point, tracker's clock
    arrival : tolerated deviation of an axis from a commanded position, mm or deg
    point_tries : how often in a row a polled tracker may be out of reach
    axes_rows : controller positions that are written together
    allow_no_watchdog, light : as in `CellConfig`
    """

    poll_s: float = 0.1
    confirm_s: float = 5.0
    stale_s: float = 0.5
    link_s: float = 2.0
    stuck_s: float = 10.0
    first_sample_s: float = 5.0
    lead_s: float = 1.0
    settle_s: float = 0.3
    arrival: float = 0.02
    progress_s: float = 0.2
    point_tries: int = 3
    axes_rows: int = 10
    timeouts: StreamTimeouts = field(default_factory=StreamTimeouts)
    allow_no_watchdog: bool = False
    light: Light | None = None


class RunningClock:
    """Clock that counts only time in which this process ran. For any thread.

    Read many times per second, it follows the host's clock. Of a longer step, in which
    the process was suspended or starved, it counts `late_s` only.
    """

    def __init__(self, late_s: float) -> None:
        self._late_s = late_s
        self._lock = threading.Lock()
        self._read_s = self._now_s = host_clock.now_s()

    def __call__(self) -> float:
        """Seconds since an arbitrary origin."""
        with self._lock:
            read_s = host_clock.now_s()
            self._now_s += min(read_s - self._read_s, self._late_s)
            self._read_s = read_s
            return self._now_s


class Stopwatch:
    """Measures how long a condition has held, from the first look at it."""

    def __init__(self) -> None:
        self._begun_s: float | None = None

    def measure_s(self) -> float:
        """Seconds since the first call after `reset`."""
        now_s = host_clock.now_s()
        if self._begun_s is None:
            self._begun_s = now_s
        return now_s - self._begun_s

    def reset(self) -> None:
        """Begin again at the next call of `measure_s`."""
        self._begun_s = None


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
