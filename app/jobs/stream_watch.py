"""What the events of a cell tell of beam, stream and temperatures, now and lately."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from truepath.app.measurement.messages import (
    CellEvent,
    CellState,
    FaultReported,
    LivePoints,
    MeasurementProgress,
    StateChanged,
)

LATELY_S = 5.0
"""Over which samples that were lost or damaged are counted."""
FRESH_S = 3.0
"""Events come several times a second while a stream runs; older ones tell nothing."""
COURSE_S, LEAST_COURSE_S = 600.0, 60.0
"""Over which temperatures are held against each other, and what tells a drift."""
READING_S = 5.0  # between two readings that are kept
_TEMPERATURE = "_degC"
_BEAM_FAULTS = frozenset({"beam-lost", "not-resumed"})


@dataclass(frozen=True, slots=True)
class StreamLevels:
    """What was seen of a tracker's stream.

    has_beam : None where nothing tells it
    lost_samples, crc_errors : in the last `LATELY_S`; None while no stream runs
    drift_degC : the most that one thermometer has changed by in the last `COURSE_S`;
        None where none shows anything, or not for long enough; drifting : its channel
    """

    has_beam: bool | None = None
    lost_samples: int | None = None
    crc_errors: int | None = None
    drift_degC: float | None = None  # noqa: N815
    drifting: str = ""


@dataclass(slots=True)
class StreamWatch:
    """Follows the events of a cell; any thread may ask."""

    clock: Callable[[], float] = time.monotonic
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _is_running: bool = False
    _beam_fault: bool = False
    _seen_s: float = -float("inf")
    _counts: deque[tuple[float, int, int]] = field(default_factory=deque)
    _course: deque[tuple[float, Mapping[str, float]]] = field(default_factory=deque)

    def follow(self, event: CellEvent) -> None:
        """Take note of an event."""
        now_s = self.clock()
        with self._lock:
            match event:
                case StateChanged(state):
                    self._follow_state(state)
                case FaultReported(code=code) if code in _BEAM_FAULTS:
                    self._beam_fault = True
                case MeasurementProgress(lost_samples=lost, crc_errors=damaged):
                    self._count(now_s, lost, damaged)
                case LivePoints(environment=readings):
                    self._seen_s = now_s
                    self._read(now_s, readings)
                case _:
                    pass

    def read(self) -> StreamLevels:
        """Return what was seen, as it is now."""
        now_s = self.clock()
        with self._lock:
            lost, damaged = self._sum_lately(now_s)
            drift_degC, drifting = self._find_drift(now_s)  # noqa: N806
            return StreamLevels(
                self._find_beam(now_s), lost, damaged, drift_degC, drifting
            )

    def _follow_state(self, state: CellState) -> None:
        if state is CellState.RUNNING:
            self._beam_fault = False
        self._is_running = state is CellState.RUNNING
        if state is CellState.READY:
            self._beam_fault = False
            self._counts.clear()

    def _find_beam(self, now_s: float) -> bool | None:
        if self._beam_fault:
            return False
        is_fresh = now_s - self._seen_s <= FRESH_S
        return True if self._is_running and is_fresh else None

    def _count(self, now_s: float, lost: int, damaged: int) -> None:
        newest = self._counts[-1] if self._counts else (0.0, 0, 0)
        if lost < newest[1] or damaged < newest[2]:  # another measurement counts anew
            self._counts.clear()
        self._counts.append((now_s, lost, damaged))
        while now_s - self._counts[0][0] > LATELY_S and len(self._counts) > 1:
            self._counts.popleft()

    def _sum_lately(self, now_s: float) -> tuple[int | None, int | None]:
        if not self._counts or now_s - self._counts[-1][0] > FRESH_S:
            return None, None
        first, last = self._counts[0], self._counts[-1]
        return last[1] - first[1], last[2] - first[2]

    def _read(self, now_s: float, readings: Mapping[str, float]) -> None:
        shown = {k: v for k, v in readings.items() if k.endswith(_TEMPERATURE)}
        if not shown or (self._course and now_s - self._course[-1][0] < READING_S):
            return
        self._course.append((now_s, shown))
        while now_s - self._course[0][0] > COURSE_S:
            self._course.popleft()

    def _find_drift(self, now_s: float) -> tuple[float | None, str]:
        recent = [one for one in self._course if now_s - one[0] <= COURSE_S]
        if not recent or recent[-1][0] - recent[0][0] < LEAST_COURSE_S:
            return None, ""
        spans: dict[str, float] = {}
        for channel in recent[-1][1]:
            shown = [readings[channel] for _, readings in recent if channel in readings]
            spans[channel] = max(shown) - min(shown)
        worst = max(spans, key=lambda channel: spans[channel])
        return spans[worst], worst
