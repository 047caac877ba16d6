"""How long a measurement waits for what, and the clocks that measure it."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

from truepath_drivers import host_clock
from truepath_drivers.interfaces.tracker_records import Light


@dataclass(frozen=True, slots=True)
class StreamTimeouts:
    """For how long, in seconds that the host has run, a stream may be less than good.

    damaged_share : of a second's samples that may be bad or lost; damaged_s : for how
        long more may be, before the measurement ends
    late_s : what counts at most of a time in which the host did not run: a suspended or
        starved process reads nothing, and finds all data waiting afterwards
    point_s : how much longer than its dwell a point of a polled tracker may take
    search_s : how long after a lost beam a tracker may find its target again for the
        measurement to go on by itself: too short for anybody to be at the machine; at
        0 it is never asked to
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
    """Times of the host in seconds where nothing else is said.

    confirm_s : a hold, a cycle start or a resume is confirmed by then
    stale_s : a controller whose last valid status is older is not fed, and is held
    link_s : the controller may be out of reach for so long
    stuck_s : a machine that runs moves, beyond the longest planned row
    lead_s : stream before the first and after the last motion, tracker's clock
    settle_s : between the end of a move and the dwell at a point, tracker's clock
    arrival : how far from a commanded position an axis may stand, mm or deg
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
    """Counts the time in which this process ran. For any thread.

    Read many times a second, it keeps up with the computer's. Of a longer step,
    in which the process was suspended or starved, it counts `late_s` only.
    """

    def __init__(self, late_s: float) -> None:
        self._late_s = late_s
        self._lock = threading.Lock()
        self._read_s = self._now_s = host_clock.now_s()

    def __call__(self) -> float:
        """Return seconds."""
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
        """Return the seconds since the first call after `reset`."""
        now_s = host_clock.now_s()
        if self._begun_s is None:
            self._begun_s = now_s
        return now_s - self._begun_s

    def reset(self) -> None:
        """Begin again at the next look."""
        self._begun_s = None
