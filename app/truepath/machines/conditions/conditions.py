"""Conditions before the machine may move, as levels and not as events.

Each condition is derived from readings of the cell in its own cycle: a device that does
not answer delays no request (`condition_log`). The board reads once a second, so that
`since` is when a level changed and not when it was requested. What a device does not
report is unknown; only a known fault is an obstacle, and a controller that the cell has
not read for a while is a fault. The measurement checks everything again before it
moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from truepath.catalogue.calibrations import CalibrationStatus
from truepath.errors import JobError
from truepath.machines.cell_status import MOVING, CellStatus, ControllerLevels
from truepath.machines.conditions.stream_status import StreamLevels, Temperature


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
    standing : status by the calibrations of the machine; None where it was not
        evaluated
    stream : recent state of the tracker's stream
    drift_limit_degC : by which a temperature may change; None where none is stated
    """

    cell: CellStatus
    controller: ControllerLevels | None
    allow_no_watchdog: bool
    free_bytes: int
    least_bytes: int
    clock_step_s: float = 0.0
    standing: CalibrationStatus | None = None
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
