"""Last known state of a cell, its controller, and the tracker's stream.

Beam, stream and temperatures come from the events of a measurement. At rest a stream is
read for a moment periodically, and thermometers are read.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from truepath.measurement.messages import (
    CellEvent,
    CellState,
    FaultReported,
    LivePoints,
    MeasurementProgress,
    StateChanged,
    TemperaturesRead,
    TrackerTried,
)
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import MotionState, MotionStatus

MOVING = frozenset(
    {CellState.RUNNING, CellState.PAUSING, CellState.PAUSED, CellState.RESUMING}
)

FRESH_S = 2.5  # a reading of the controller at rest, made once a second
_GOES_ON = frozenset({MotionState.RUNNING, MotionState.HELD})

NOT_READ = "its controller has not been read since; ask again"

Devices = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class CellStatus:
    """The cell's last known state.

    state : starting, down, disconnected, connecting, ready, or as the cell names it
    """

    state: str = "starting"
    text: str = ""
    restarts: int = 0
    devices: Devices = field(default_factory=dict)

    @property
    def connected(self) -> bool:
        """Whether tracker and controller have answered and nothing was lost since."""
        return bool(self.devices)


@dataclass(frozen=True, slots=True)
class ControllerLevels:
    """Last reading of the controller while nothing was measured.

    read_s : when, by the monotonic clock
    axes : names of the axes of its position, in their order
    """

    status: MotionStatus | None
    text: str
    read_s: float
    axes: tuple[str, ...] = ()

    @property
    def position_by_axis(self) -> dict[str, float]:
        """Position of the machine, mm or deg; empty where that is not known."""
        place = () if self.status is None else self.status.position
        return dict(zip(self.axes, place, strict=True)) if self.axes and place else {}

    @property
    def is_still(self) -> bool | None:
        """Whether the controller has just reported a stop; None if unknown."""
        if self.status is None or host_clock.now_s() - self.read_s > FRESH_S:
            return None
        return self.status.state not in _GOES_ON

    def describe_standstill(self) -> str:
        """`is_still` as a clause on the machine, with the remedy."""
        still = self.is_still
        if self.status is None or still is None:
            return NOT_READ
        if still:
            return f"it has stopped ({self.status.state})"
        if self.status.state is MotionState.HELD:
            return (
                f"it stands by a feed hold alone ({self.status.hold_reason or 'held'}) "
                "and its program could go on; end that at the machine"
            )
        return "it moves; stop it at the machine if it does not come to a stand"


LATELY_S = 5.0
"""Period over which lost or damaged samples are counted."""
EVENT_FRESH_S = 3.0
"""Events come several times a second while a stream runs; older ones do not count."""
AT_REST_S = 15.0
"""How long a reading of the stream at rest counts."""
LEAST_SEEN = 0.5
"""Share of usable samples from which on the target is in sight."""
FEW_LOST = 0.01
"""Share of samples lost at rest that a busy computer may account for."""
COURSE_S, LEAST_COURSE_S = 600.0, 60.0
"""Longest and shortest period of temperatures from which a drift is computed."""
READING_S = 5.0  # between two readings that are kept
_TEMPERATURE = "_degC"
_BEAM_FAULTS = frozenset({"beam-lost", "not-resumed"})


@dataclass(frozen=True, slots=True)
class Temperature:
    """Reading of one thermometer.

    change_degC : highest less lowest reading in the last `over_s`, `COURSE_S` at most
    """

    channel: str
    value_degC: float  # noqa: N815
    change_degC: float  # noqa: N815
    over_s: float


@dataclass(frozen=True, slots=True)
class StreamLevels:
    """State of a tracker's stream.

    has_beam : None where unknown
    lost_samples, crc_errors : in the last `LATELY_S`; None while no stream runs
    drift_degC : largest change of one thermometer in the last `COURSE_S`; None without
        readings, or not for long enough; drifting : its channel
    usable_share, rate_share : of the samples read at rest those that are usable, and
        their rate as a share of the requested one; None for a rate that is not known
    failure : why nothing could be read at rest; else empty
    temperatures : newest reading of each thermometer
    """

    has_beam: bool | None = None
    lost_samples: int | None = None
    crc_errors: int | None = None
    drift_degC: float | None = None  # noqa: N815
    drifting: str = ""
    usable_share: float = 1.0
    rate_share: float | None = None
    failure: str = ""
    temperatures: tuple[Temperature, ...] = ()


@dataclass(slots=True)
class StreamStatus:
    """Follows the events of a cell; thread-safe."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    _is_running: bool = False
    _beam_fault: bool = False
    _seen_s: float = -float("inf")
    _counts: deque[tuple[float, int, int]] = field(default_factory=deque)
    _course: deque[tuple[float, Mapping[str, float]]] = field(default_factory=deque)
    _at_rest: StreamLevels = field(default_factory=StreamLevels)
    _at_rest_s: float = -float("inf")

    def follow(self, event: CellEvent) -> None:
        """Update from an event of the cell."""
        now_s = host_clock.now_s()
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
                case TemperaturesRead(readings):
                    self._read(now_s, readings)
                case _:
                    pass

    def record_trial(self, tried: TrackerTried, rate_hz: float, *, aims: bool) -> None:
        """Update from a reading of the stream at rest.

        rate_hz : requested; aims : the measurement points the beam at its targets
            itself, so that a missing beam now means nothing
        """
        self._store_at_rest(_assess_trial(tried, rate_hz, aims=aims))

    def record_failure(self, text: str) -> None:
        """Update from a failed reading of the stream at rest."""
        self._store_at_rest(StreamLevels(failure=text))

    def _store_at_rest(self, levels: StreamLevels) -> None:
        with self._lock:
            self._at_rest, self._at_rest_s = levels, host_clock.now_s()

    def read(self) -> StreamLevels:
        """State at the present moment."""
        now_s = host_clock.now_s()
        with self._lock:
            drift_degC, drifting = self._find_drift(now_s)  # noqa: N806
            return replace(
                self._find_stream(now_s),
                drift_degC=drift_degC,
                drifting=drifting,
                temperatures=self._list_temperatures(now_s),
            )

    def _find_stream(self, now_s: float) -> StreamLevels:
        if now_s - self._at_rest_s <= AT_REST_S:
            return self._at_rest
        return StreamLevels(self._find_beam(now_s), *self._sum_lately(now_s))

    def _follow_state(self, state: CellState) -> None:
        if state is CellState.RUNNING:
            self._beam_fault = False
            self._at_rest_s = -float("inf")
        self._is_running = state is CellState.RUNNING
        if state is CellState.READY:
            self._beam_fault = False
            self._counts.clear()

    def _find_beam(self, now_s: float) -> bool | None:
        if self._beam_fault:
            return False
        is_fresh = now_s - self._seen_s <= EVENT_FRESH_S
        return True if self._is_running and is_fresh else None

    def _count(self, now_s: float, lost: int, damaged: int) -> None:
        newest = self._counts[-1] if self._counts else (0.0, 0, 0)
        if lost < newest[1] or damaged < newest[2]:  # another measurement counts from 0
            self._counts.clear()
        self._counts.append((now_s, lost, damaged))
        while now_s - self._counts[0][0] > LATELY_S and len(self._counts) > 1:
            self._counts.popleft()

    def _sum_lately(self, now_s: float) -> tuple[int | None, int | None]:
        if not self._counts or now_s - self._counts[-1][0] > EVENT_FRESH_S:
            return None, None
        first, last = self._counts[0], self._counts[-1]
        return last[1] - first[1], last[2] - first[2]

    def _read(self, now_s: float, readings: Mapping[str, float]) -> None:
        shown = {
            k: v
            for k, v in readings.items()
            if k.endswith(_TEMPERATURE) and math.isfinite(v)
        }
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

    def _list_temperatures(self, now_s: float) -> tuple[Temperature, ...]:
        recent = [one for one in self._course if now_s - one[0] <= COURSE_S]
        if not recent:
            return ()
        found: list[Temperature] = []
        for channel, value in recent[-1][1].items():
            shown = [(at, r[channel]) for at, r in recent if channel in r]
            values = [one for _, one in shown]
            change, over_s = max(values) - min(values), recent[-1][0] - shown[0][0]
            found.append(Temperature(channel, value, change, over_s))
        return tuple(found)


def _assess_trial(tried: TrackerTried, rate_hz: float, *, aims: bool) -> StreamLevels:
    if not tried.streams:
        return StreamLevels()
    if not tried.samples:
        return StreamLevels(failure="the tracker sends no samples")
    usable_share = tried.usable / tried.samples
    has_beam = usable_share >= LEAST_SEEN
    share_lost = tried.lost_samples / (tried.samples + tried.lost_samples)
    return StreamLevels(
        has_beam or (None if aims else False),
        tried.lost_samples if share_lost > FEW_LOST else 0,
        0,
        usable_share=usable_share,
        rate_share=tried.rate_hz and tried.rate_hz / rate_hz,
    )
