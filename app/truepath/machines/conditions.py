"""Conditions before the machine may move, as levels and not as events.

Each condition is derived from readings of the cell in its own cycle: a device that does
not answer delays no request. `ConditionLog` reads once a second, so that `since` is
when a level changed and not when it was requested. What a device does not report is
unknown; only a known fault is an obstacle, and a controller that the cell has not read
for a while is a fault. The measurement checks everything again before it moves.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import structlog

from truepath.catalogue.calibrations import CalibrationStatus
from truepath.catalogue.job import format_utc_now
from truepath.errors import JobError
from truepath.machines.cell_status import (
    COURSE_S,
    LATELY_S,
    MOVING,
    CellStatus,
    ControllerLevels,
    StreamLevels,
    Temperature,
)
from truepath.measurement.faults import MOTION_BUSY
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import UNABLE, MotionStatus


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
    AXES_REFERENCED = "axes-referenced"
    COMPENSATION_AS_ASKED = "compensation-as-asked"
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
        ConditionType.AXES_REFERENCED,
        ConditionType.COMPENSATION_AS_ASKED,
        ConditionType.FEED_OVERRIDE_FULL,
        ConditionType.WATCHDOG_THERE,
        ConditionType.DISK_HAS_ROOM,
        ConditionType.PATH_WITHIN_TRAVEL,
        ConditionType.TARGET_IN_SIGHT,
        ConditionType.STREAM_HEALTHY,
    }
)
LEFT_TO_MEASUREMENT = frozenset(
    {ConditionType.TARGET_IN_SIGHT, ConditionType.STREAM_HEALTHY}
)
"""During a measurement it decides itself: it holds, and checks before it continues."""


@dataclass(frozen=True, slots=True)
class Finding:
    """State of one condition.

    reason : for programs; message : for people, with the remedy where there is one
    """

    level: Level
    reason: str = ""
    message: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition as it is now.

    since : UTC, when it reached its level
    temperatures : that it was derived from, if any
    """

    type: ConditionType
    level: Level
    reason: str
    message: str
    is_required: bool
    since: str
    temperatures: tuple[Temperature, ...] = ()

    @property
    def is_obstacle(self) -> bool:
        """Whether it prevents the machine from moving."""
        return self.is_required and self.level is Level.FALSE


class NotInOrder(JobError):
    """A known fault prevents the machine from moving."""

    def __init__(self, obstacles: Sequence[Condition]) -> None:
        super().__init__("; ".join(one.message for one in obstacles))
        self.obstacles = tuple(obstacles)


@dataclass(frozen=True, slots=True)
class Observed:
    """Inputs of all conditions.

    controller : its last reading at rest; None where there is none
    free_bytes, least_bytes : room on the disk, and how much has to stay
    clock_step_s : by how much the wall clock has left the monotonic one
    calibration_status : of the machine; None where it was not evaluated
    stream : recent state of the tracker's stream
    drift_limit_degC : by which a temperature may change; None where none is stated
    """

    cell: CellStatus
    controller: ControllerLevels | None
    allow_no_watchdog: bool
    free_bytes: int
    least_bytes: int
    clock_step_s: float = 0.0
    calibration_status: CalibrationStatus | None = None
    stream: StreamLevels = field(default_factory=StreamLevels)
    drift_limit_degC: float | None = None  # noqa: N815

    def requires(self, kind: ConditionType) -> bool:
        """Whether a condition has to hold before the machine may move."""
        if kind is ConditionType.TEMPERATURE_STEADY:
            return self.drift_limit_degC is not None
        is_left = kind in LEFT_TO_MEASUREMENT and self.cell.state in MOVING
        return kind in REQUIRED and not is_left


NO_JOB = Finding(Level.UNKNOWN, "no-job")
"""Of the path, while no job waits to be armed."""


log = structlog.get_logger(__name__)

LOOK_S = 1.0
LATE_S = 10.0
"""The cell reads a controller at rest more often; an older reading says nothing."""
FULL_OVERRIDE = (0.9995, 1.0005)
CLOCK_STEP_S = 2.0
STEADY_DEGC = 1.0
"""A steel machine of a metre grows by 12 µm in that."""
LEAST_USABLE = 0.95
"""Of the samples at rest; where nothing moves, a good signal has nearly all."""
RATE_TOLERANCE = 0.1
"""By which a stream may differ from the rate that was asked, as a share of it."""

YES, UNTOLD = Finding(Level.TRUE), Finding(Level.UNKNOWN, "not-told")


@dataclass(slots=True)
class ConditionLog:
    """Keeps since when each condition has its level; thread-safe.

    observe : reads the present state, at once
    look_s : between two readings, once it has been started
    on_change : receives each condition whose level has changed; returns at once
    path : of the job that waits to be armed, as checked by its thread
    judge_approach : checks the approach to that path from the present position
    wants_compensation : what that job requires of the control, None for nothing
    """

    observe: Callable[[], Observed]
    look_s: float = LOOK_S
    on_change: Callable[[Condition], None] = lambda _: None
    path: Finding = NO_JOB
    assess_approach: Callable[[Mapping[str, float]], Finding] | None = None
    wants_compensation: bool | None = None
    _since: dict[ConditionType, tuple[Level, str]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _closing: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        """Read periodically, so that each change has its time."""
        threading.Thread(target=self._run, name="conditions", daemon=True).start()

    def close(self) -> None:
        """Stop the periodic reading."""
        self._closing.set()

    def _run(self) -> None:
        while not host_clock.wait(self._closing, self.look_s):
            try:
                self.read()
            except OSError as error:  # the disk of the data cannot be read
                log.warning("conditions are not read", reason=str(error))

    def read(self) -> list[Condition]:
        """Every condition as it is now."""
        with self._lock:
            now_s, seen = host_clock.now_s(), self.observe()
            wants = self.wants_compensation
            found = {
                **find_conditions(seen, now_s, wants_compensation=wants),
                ConditionType.PATH_WITHIN_TRAVEL: self._find_path(seen),
            }
            return [self._note(kind, one, seen) for kind, one in found.items()]

    def _find_path(self, seen: Observed) -> Finding:
        judge = self.assess_approach
        if self.path.level is not Level.TRUE or judge is None:
            return self.path
        return judge(
            {} if seen.controller is None else seen.controller.position_by_axis
        )

    def list_obstacles(self) -> list[Condition]:
        """Conditions that prevent the machine from moving."""
        return [condition for condition in self.read() if condition.is_obstacle]

    def _note(self, kind: ConditionType, found: Finding, seen: Observed) -> Condition:
        level, since = self._since.get(kind, (None, ""))
        if level is not found.level:
            since = format_utc_now()
            self._since[kind] = (found.level, since)
        is_temperature = kind is ConditionType.TEMPERATURE_STEADY
        condition = Condition(
            kind,
            found.level,
            found.reason,
            found.message,
            seen.requires(kind),
            since,
            seen.stream.temperatures if is_temperature else (),
        )
        if level not in (None, found.level):
            self.on_change(condition)
        return condition


def find_conditions(
    seen: Observed, now_s: float, *, wants_compensation: bool | None = None
) -> Mapping[ConditionType, Finding]:
    """Findings by condition.

    now_s : of the monotonic clock
    wants_compensation : what the job that waits requires of the control, if anything
    """
    answers, status = _read_controller(seen, now_s)
    return {
        ConditionType.DEVICES_CONNECTED: _find_connection(seen.cell),
        ConditionType.CONTROLLER_ANSWERS: answers,
        ConditionType.CONTROLLER_ABLE: _find_ability(status),
        ConditionType.CONTROLLER_FREE: _find_freedom(status),
        ConditionType.AXES_REFERENCED: _find_reference(status),
        ConditionType.COMPENSATION_AS_ASKED: _find_compensation(
            status, wants_compensation
        ),
        ConditionType.FEED_OVERRIDE_FULL: _find_override(status),
        ConditionType.WATCHDOG_THERE: _find_watchdog(seen),
        ConditionType.DISK_HAS_ROOM: _find_room(seen),
        ConditionType.CLOCK_STEADY: _find_clock(seen.clock_step_s),
        ConditionType.TARGET_IN_SIGHT: _find_beam(seen.stream),
        ConditionType.STREAM_HEALTHY: _find_stream(seen.stream),
        ConditionType.TEMPERATURE_STEADY: _find_drift(
            seen.stream, seen.drift_limit_degC
        ),
        **_assess_calibration(seen.calibration_status),
    }


def _find_connection(cell: CellStatus) -> Finding:
    if cell.connected:
        return YES
    text = cell.text or "tracker and controller have not been connected"
    return Finding(Level.FALSE, cell.state, f"{text}; connect them")


def _read_controller(
    seen: Observed, now_s: float
) -> tuple[Finding, MotionStatus | None]:
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
        return Finding(Level.FALSE, "no-answer", read.text), None
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
    if status.is_busy:
        return Finding(Level.FALSE, MOTION_BUSY.code, str(MOTION_BUSY))
    return YES


def _find_reference(status: MotionStatus | None) -> Finding:
    if status is None or status.referenced is None:
        return UNTOLD
    text = "the controller does not know where its axes are; reference (home) them"
    return YES if status.referenced else Finding(Level.FALSE, "unreferenced", text)


def _find_compensation(status: MotionStatus | None, wants: bool | None) -> Finding:
    if status is None or status.compensation is None:
        if wants is None:
            return UNTOLD
        text = f"the job asks for compensation {_on_or_off(wants)}; see to it yourself"
        return Finding(Level.UNKNOWN, f"not-told-{_on_or_off(wants)}", text)
    now = _on_or_off(status.compensation)
    text = f"the error compensation of the control is {now}"
    if wants in (None, status.compensation):
        return Finding(Level.TRUE, f"compensation-{now}", text)
    asked = _on_or_off(not status.compensation)
    text = f"{text}, the job asks for it {asked}; switch it {asked} at the control"
    return Finding(Level.FALSE, f"compensation-not-{asked}", text)


def _on_or_off(state: bool) -> str:
    return "on" if state else "off"


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
    motion = seen.cell.devices.get("motion", {})
    if motion.get("has_watchdog"):
        return YES
    text = "the controller has no watchdog: it would move on if the service died"
    if seen.allow_no_watchdog and motion.get("stops_unasked"):
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


def _assess_calibration(
    calibration_status: CalibrationStatus | None,
) -> Mapping[ConditionType, Finding]:
    found: dict[ConditionType, Finding] = {}
    if calibration_status is not None and calibration_status.tolerance is not None:
        tolerance = calibration_status.tolerance
        level = {"within": Level.TRUE, "over": Level.FALSE}.get(tolerance.state)
        reason = "" if level is Level.TRUE else f"tolerance-{tolerance.state}"
        found[ConditionType.WITHIN_TOLERANCE] = Finding(
            level or Level.UNKNOWN, reason, tolerance.text if reason else ""
        )
    if calibration_status is not None and calibration_status.is_reference_lost:
        lost = Finding(Level.UNKNOWN, "reference-not-usable", calibration_status.text)
        found[ConditionType.UNCHANGED] = lost
    elif calibration_status is not None and calibration_status.has_changed is not None:
        changed = Finding(Level.FALSE, "changed", calibration_status.text)
        found[ConditionType.UNCHANGED] = (
            changed if calibration_status.has_changed else YES
        )
    return found


def _find_beam(stream: StreamLevels) -> Finding:
    if stream.has_beam is None:
        return UNTOLD
    text = "the tracker does not see its target; lock the beam on the reflector"
    return YES if stream.has_beam else Finding(Level.FALSE, "beam-lost", text)


def _find_stream(stream: StreamLevels) -> Finding:
    if stream.failure:
        return Finding(Level.FALSE, "stream-silent", stream.failure)
    share = stream.rate_share
    if share is not None and abs(share - 1.0) > RATE_TOLERANCE:
        text = (
            f"the tracker sends {100 * share:.0f} % of the samples that were asked "
            "for; set its rate, or that of the machine file"
        )
        return Finding(Level.FALSE, "stream-rate", text)
    if stream.has_beam and stream.usable_share < LEAST_USABLE:
        text = (
            f"{100 * stream.usable_share:.0f} % of the samples are usable; clean the "
            "reflector and clear the line of sight"
        )
        return Finding(Level.FALSE, "signal-poor", text)
    return _find_losses(stream)


def _find_losses(stream: StreamLevels) -> Finding:
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


def _find_drift(stream: StreamLevels, limit_degc: float | None) -> Finding:
    if stream.drift_degC is None:
        return UNTOLD
    most_degc = STEADY_DEGC if limit_degc is None else limit_degc
    if stream.drift_degC <= most_degc:
        return YES
    text = (
        f"{stream.drifting.removesuffix('_degC')} has changed by "
        f"{stream.drift_degC:.1f} °C in {COURSE_S / 60.0:.0f} min, more than "
        f"{most_degc:g} °C; let the machine reach its temperature"
    )
    return Finding(Level.FALSE, "temperature-drifts", text)
