"""What has to be so before the machine may be let move, as levels and not as events.

Each condition is read from what the cell has read in its own cycle: a device that does
not answer delays nobody. The board looks once a second, so that `since` is when a level
changed and not when somebody asked. What a device does not tell is unknown; only what
is known to be wrong stands in the way, and a controller that the cell has not read for
a while is wrong. The measurement looks at everything again before it moves.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import structlog

from truepath.app.jobs.calibrations import Standing
from truepath.app.jobs.cell_supervisor import MOVING, CellStatus, ControllerLevels
from truepath.app.jobs.job import format_utc_now
from truepath.app.jobs.stream_watch import COURSE_S, LATELY_S, StreamLevels
from truepath.drivers.interfaces.records import UNABLE, MotionState, MotionStatus

log = structlog.get_logger(__name__)

LATE_S = 10.0
"""The cell reads a controller at rest more often; an older reading says nothing."""
LOOK_S = 1.0
FULL_OVERRIDE = (0.9995, 1.0005)
CLOCK_STEP_S = 2.0
STEADY_DEGC = 1.0
"""A steel machine of a metre grows by 12 µm in that."""


class Level(StrEnum):
    """Whether a condition holds."""

    TRUE = "true"
    FALSE = "false"
    UNKNOWN = "unknown"


class ConditionType(StrEnum):
    """What is looked at; those of `REQUIRED` keep the machine from being let move."""

    DEVICES_CONNECTED = "devices-connected"
    CONTROLLER_ANSWERS = "controller-answers"
    CONTROLLER_ABLE = "controller-able"
    CONTROLLER_FREE = "controller-free"
    FEED_OVERRIDE_FULL = "feed-override-full"
    WATCHDOG_THERE = "watchdog-there"
    DISK_HAS_ROOM = "disk-has-room"
    CLOCK_STEADY = "clock-steady"
    WITHIN_TOLERANCE = "within-tolerance"
    UNCHANGED = "unchanged"
    TARGET_IN_SIGHT = "target-in-sight"
    STREAM_HEALTHY = "stream-healthy"
    TEMPERATURE_STEADY = "temperature-steady"
    PATH_WITHIN_TRAVEL = "path-within-travel"


REQUIRED = frozenset(
    {
        ConditionType.DEVICES_CONNECTED,
        ConditionType.CONTROLLER_ANSWERS,
        ConditionType.CONTROLLER_ABLE,
        ConditionType.CONTROLLER_FREE,
        ConditionType.WATCHDOG_THERE,
        ConditionType.DISK_HAS_ROOM,
        ConditionType.PATH_WITHIN_TRAVEL,
    }
)


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of one condition.

    reason : for programs; message : for people, with the remedy where there is one
    """

    level: Level
    reason: str = ""
    message: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition as it is now.

    since : UTC, when its level became what it is
    """

    type: ConditionType
    level: Level
    reason: str
    message: str
    is_required: bool
    since: str

    @property
    def is_obstacle(self) -> bool:
        """Whether it keeps the machine from being let move."""
        return self.is_required and self.level is Level.FALSE


@dataclass(frozen=True, slots=True)
class Observed:
    """All that conditions are read from.

    controller : its last reading at rest; None where there is none
    free_bytes, least_bytes : room on the disk, and how much has to stay
    clock_step_s : by how much the wall clock has left the monotonic one
    standing : of the machine by its calibrations; None where nobody has looked
    stream : what was seen of the tracker's stream lately
    """

    cell: CellStatus
    controller: ControllerLevels | None
    allow_no_watchdog: bool
    free_bytes: int
    least_bytes: int
    clock_step_s: float = 0.0
    standing: Standing | None = None
    stream: StreamLevels = field(default_factory=StreamLevels)


YES, UNTOLD = Finding(Level.TRUE), Finding(Level.UNKNOWN, "not-told")
NO_JOB = Finding(Level.UNKNOWN, "no-job")
"""Of the path, while no job waits to be armed."""


def find_conditions(seen: Observed, now_s: float) -> Mapping[ConditionType, Finding]:
    """Return what is found; `now_s` is of the monotonic clock."""
    answers, status = _read_controller(seen, now_s)
    return {
        ConditionType.DEVICES_CONNECTED: _find_connection(seen.cell),
        ConditionType.CONTROLLER_ANSWERS: answers,
        ConditionType.CONTROLLER_ABLE: _find_ability(status),
        ConditionType.CONTROLLER_FREE: _find_freedom(status),
        ConditionType.FEED_OVERRIDE_FULL: _find_override(status),
        ConditionType.WATCHDOG_THERE: _find_watchdog(seen),
        ConditionType.DISK_HAS_ROOM: _find_room(seen),
        ConditionType.CLOCK_STEADY: _find_clock(seen.clock_step_s),
        ConditionType.TARGET_IN_SIGHT: _find_beam(seen.stream),
        ConditionType.STREAM_HEALTHY: _find_stream(seen.stream),
        ConditionType.TEMPERATURE_STEADY: _find_drift(seen.stream),
        **_find_standing(seen.standing),
    }


def _find_connection(cell: CellStatus) -> Finding:
    if cell.connected:
        return YES
    text = cell.text or "tracker and controller have not been connected"
    return Finding(Level.FALSE, cell.state, f"{text}; connect them")


def _read_controller(
    seen: Observed, now_s: float
) -> tuple[Finding, MotionStatus | None]:
    """Return whether it answers, and what it shows where that is fresh."""
    read = seen.controller
    if seen.cell.state in MOVING:
        return Finding(Level.TRUE, "measuring"), None
    if read is None or not seen.cell.connected:
        return UNTOLD, None
    if now_s - read.read_s > LATE_S:
        text = (
            f"the controller was read {now_s - read.read_s:.0f} s ago; "
            "look at its link, then connect again"
        )
        return Finding(Level.FALSE, "late", text), None
    if read.status is None:
        text = f"{read.text}; check cable and power, then connect again"
        return Finding(Level.FALSE, "no-answer", text), None
    return YES, read.status


def _find_ability(status: MotionStatus | None) -> Finding:
    if status is None:
        return UNTOLD
    if status.state in UNABLE:
        said = f" ({status.alarm.strip()})" if status.alarm.strip() else ""
        why = UNABLE[status.state]
        return Finding(
            Level.FALSE, str(status.state), f"{why.text}{said}; {why.remedy}"
        )
    return YES


def _find_freedom(status: MotionStatus | None) -> Finding:
    if status is None:
        return UNTOLD
    if status.state is MotionState.RUNNING:
        text = (
            "the controller runs something else; let it end or stop it at the machine"
        )
        return Finding(Level.FALSE, "motion-busy", text)
    return YES


def _find_override(status: MotionStatus | None) -> Finding:
    if status is None or status.override is None:
        return UNTOLD
    if FULL_OVERRIDE[0] <= status.override <= FULL_OVERRIDE[1]:
        return YES
    text = f"the feed override is {100 * status.override:.0f} %; set it to 100 %"
    return Finding(Level.FALSE, "feed-override", text)


def _find_watchdog(seen: Observed) -> Finding:
    if not seen.cell.connected:
        return UNTOLD
    if seen.cell.devices.get("motion", {}).get("has_watchdog"):
        return YES
    text = "the controller has no watchdog: it would move on if the service died"
    if seen.allow_no_watchdog:
        return Finding(Level.TRUE, "allowed-without", f"{text}; that is allowed")
    return Finding(Level.FALSE, "no-watchdog", f"{text}; give it one")


def _find_room(seen: Observed) -> Finding:
    if seen.free_bytes > seen.least_bytes:
        return YES
    text = (
        f"{seen.free_bytes / 1e6:.0f} MB are free on the disk of the Runs, "
        f"{seen.least_bytes / 1e6:.0f} MB have to be; free some space"
    )
    return Finding(Level.FALSE, "disk-full", text)


def _find_clock(step_s: float) -> Finding:
    if abs(step_s) < CLOCK_STEP_S:
        return YES
    text = (
        f"the clock of this computer was set by {step_s:+.0f} s since the service "
        "began; times of day before that are off, durations are not"
    )
    return Finding(Level.FALSE, "clock-set", text)


def _find_standing(standing: Standing | None) -> Mapping[ConditionType, Finding]:
    """Return what the calibrations say, where there is anything to be held against."""
    found: dict[ConditionType, Finding] = {}
    if standing is not None and standing.tolerance is not None:
        tolerance = standing.tolerance
        level = {"within": Level.TRUE, "over": Level.FALSE}.get(tolerance.state)
        reason = "" if level is Level.TRUE else f"tolerance-{tolerance.state}"
        found[ConditionType.WITHIN_TOLERANCE] = Finding(
            level or Level.UNKNOWN, reason, tolerance.text if reason else ""
        )
    if standing is not None and standing.has_changed is not None:
        changed = Finding(Level.FALSE, "changed", standing.text)
        found[ConditionType.UNCHANGED] = changed if standing.has_changed else YES
    return found


def _find_beam(stream: StreamLevels) -> Finding:
    if stream.has_beam is None:
        return UNTOLD
    text = "the tracker does not see its target; lock the beam on the reflector"
    return YES if stream.has_beam else Finding(Level.FALSE, "beam-lost", text)


def _find_stream(stream: StreamLevels) -> Finding:
    lost, damaged = stream.lost_samples, stream.crc_errors
    if lost is None or damaged is None:
        return UNTOLD
    if not lost and not damaged:
        return YES
    text = (
        f"in the last {LATELY_S:.0f} s {lost} samples were lost and {damaged} frames "
        "damaged; look at the tracker's cable and at the load of this computer"
    )
    return Finding(Level.FALSE, "stream-damaged", text)


def _find_drift(stream: StreamLevels) -> Finding:
    if stream.drift_degC is None:
        return UNTOLD
    if stream.drift_degC <= STEADY_DEGC:
        return YES
    text = (
        f"{stream.drifting.removesuffix('_degC')} has changed by "
        f"{stream.drift_degC:.1f} °C in {COURSE_S / 60.0:.0f} min; let the machine "
        "reach its temperature"
    )
    return Finding(Level.FALSE, "temperature-drifts", text)


@dataclass(slots=True)
class ConditionBoard:
    """Keeps since when each condition is as it is; for any thread.

    observe : reads what there is, at once
    look_s : between two looks, once it has been started
    on_change : receives each condition whose level has changed; returns at once
    path : of the job that waits to be armed, as its thread has judged it
    """

    observe: Callable[[], Observed]
    clock: Callable[[], float] = time.monotonic
    look_s: float = LOOK_S
    on_change: Callable[[Condition], None] = lambda _: None
    path: Finding = NO_JOB
    _since: dict[ConditionType, tuple[Level, str]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _closing: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        """Look every so often, so that each change has its time."""
        threading.Thread(target=self._run, name="conditions", daemon=True).start()

    def close(self) -> None:
        """Look no more."""
        self._closing.set()

    def _run(self) -> None:
        """Body of the thread."""
        while not self._closing.wait(self.look_s):
            try:
                self.read()
            except OSError as error:  # the disk of the data cannot be asked
                log.warning("conditions are not read", reason=str(error))

    def read(self) -> list[Condition]:
        """Return every condition as it is now."""
        with self._lock:
            now_s = self.clock()
            found = {
                **find_conditions(self.observe(), now_s),
                ConditionType.PATH_WITHIN_TRAVEL: self.path,
            }
            return [self._note(kind, one) for kind, one in found.items()]

    def list_obstacles(self) -> list[Condition]:
        """Return what keeps the machine from being let move."""
        return [condition for condition in self.read() if condition.is_obstacle]

    def _note(self, kind: ConditionType, found: Finding) -> Condition:
        level, since = self._since.get(kind, (None, ""))
        if level is not found.level:
            since = format_utc_now()
            self._since[kind] = (found.level, since)
        is_required = kind in REQUIRED
        condition = Condition(
            kind, found.level, found.reason, found.message, is_required, since
        )
        if level not in (None, found.level):
            self.on_change(condition)
        return condition
