"""Records that cross the border of a device: one per block, not per sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of the device on the port.

    serial_number : empty where the device reports none
    has_watchdog : a motion controller that holds the feed automatically without
        heartbeats; a driver claims it only where it has seen a sign of it at `connect`
    drives_arcs : a motion controller whose paths may have arcs
    stops_unasked : a motion controller without a watchdog whose driver feeds the motion
        piece by piece, and stops after a second without requests
    """

    maker: str
    model: str
    serial_number: str
    firmware: str
    has_watchdog: bool = False
    drives_arcs: bool = False
    stops_unasked: bool = False


FARTHEST_MM = 1e7
"""Beyond the range of any beam."""
LOST = 0x0080
"""The status of a sample that was reported valid but has no possible position."""


def is_seen(position_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each position is possible: finite, and within a beam's range."""
    return np.all(np.abs(position_mm) < FARTHEST_MM, axis=-1)


@dataclass(frozen=True, slots=True)
class TrackerSamples:
    """A block of tracker samples in the tracker's own frame and clock.

    sequence : (n,) int64, unwrapped counter of the device; a step above 1 is a loss
    device_time_s : (n,) float64, unwrapped clock of the device
    position_mm : (n, 3) float64
    status : (n,) int64, 0 is a valid sample, anything else is not to be used
    quality : (n,) float32, as the instrument reports it, 1 is best; NaN where it does
        not, None where it never does
    """

    sequence: NDArray[np.int64]
    device_time_s: NDArray[np.float64]
    position_mm: NDArray[np.float64]
    status: NDArray[np.int64]
    quality: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        """Mark impossible positions as lost, whatever their status."""
        seen = is_seen(self.position_mm)
        if not seen.all():
            position_mm = np.where(seen[:, None], self.position_mm, np.nan)
            status = np.where(seen | (self.status != 0), self.status, LOST)
            object.__setattr__(self, "position_mm", position_mm)
            object.__setattr__(self, "status", status)

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def lost(self) -> int:
        """Samples that are missing between the first and the last, by the numbers."""
        return int(np.diff(self.sequence).sum()) - max(len(self) - 1, 0)

    @classmethod
    def empty(cls) -> TrackerSamples:
        """A block of no samples."""
        none = np.empty(0, np.int64)
        return cls(none, np.empty(0), np.empty((0, 3)), none)

    @classmethod
    def join(cls, blocks: Sequence[TrackerSamples]) -> TrackerSamples:
        """The blocks one after another."""
        if not blocks:
            return cls.empty()
        return cls(
            np.concatenate([b.sequence for b in blocks]),
            np.concatenate([b.device_time_s for b in blocks]),
            np.concatenate([b.position_mm for b in blocks]),
            np.concatenate([b.status for b in blocks]),
            _join_quality(blocks),
        )

    def select(self, rows: slice | NDArray[np.integer | np.bool_]) -> TrackerSamples:
        """Samples of some rows, by slice, indices or mask."""
        return TrackerSamples(
            self.sequence[rows],
            self.device_time_s[rows],
            self.position_mm[rows],
            self.status[rows],
            None if self.quality is None else self.quality[rows],
        )


def _join_quality(blocks: Sequence[TrackerSamples]) -> NDArray[np.float32] | None:
    if all(b.quality is None for b in blocks):
        return None
    untold = (np.full(len(b), np.nan, np.float32) for b in blocks)
    told = zip(blocks, untold, strict=True)
    return np.concatenate([u if b.quality is None else b.quality for b, u in told])


@dataclass(frozen=True, slots=True)
class AxisSamples:
    """Controller positions by host arrival time, never paired with samples.

    host_time_s : (n,) monotonic clock of the host
    position_mm : (n, axes), degrees for rotary axes
    """

    axes: tuple[str, ...]
    host_time_s: NDArray[np.float64]
    position_mm: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TemperatureSamples:
    """Temperatures on the tracker's clock.

    names : columns of `environment.csv` without their `_degC`
    time_s : (n,)
    celsius : (n, sensors), NaN where a sensor has no plausible reading
    """

    names: tuple[str, ...]
    time_s: NDArray[np.float64]
    celsius: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AirSamples:
    """Pressure and humidity of the air on the tracker's clock, NaN where not known.

    time_s, pressure_hpa, humidity_percent : (n,)
    """

    time_s: NDArray[np.float64]
    pressure_hpa: NDArray[np.float64]
    humidity_percent: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Arc:
    """A circular motion towards a row, in the plane of two linear axes.

    axes : XY, YZ or ZX; other axes are at rest
    centre_mm : in both axes
    turn_deg : positive from the first axis towards the second, G3; may exceed a turn
    """

    axes: str
    centre_mm: tuple[float, float]
    turn_deg: float


ARC_PLANES = ("XY", "YZ", "ZX")


@dataclass(frozen=True, slots=True)
class Path:
    """Commanded motions between waypoints, an exact stop and a dwell at each.

    Straight lines, except where there is an arc.

    position : (n, axes) axis positions, mm for linear and deg for rotary axes
    feed_mm_min : (n,) feed towards that row; the first row is approached at its feed
    dwell_s : (n,) dwell at that row
    target : name of the target measured during the motion to each row; empty for a
        single one
    arc : motion to each row, None on a straight line; empty where all are straight. The
        first row is approached straight in any case
    """

    axes: tuple[str, ...]
    position: NDArray[np.float64]
    feed_mm_min: NDArray[np.float64]
    dwell_s: NDArray[np.float64]
    target: tuple[str, ...] = ()
    arc: tuple[Arc | None, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """Damage on a link since it was opened. Losses are told by the numbers of samples.

    crc_errors : frames or lines that came damaged and gave no sample
    doubled, late : intact ones that came again, or after a later one, and were dropped
    frames, skipped_bytes, device_overflows : for diagnosis, where a driver has them
    lost_samples : reported by earlier drivers, read by nobody
    """

    frames: int = 0
    lost_samples: int = 0
    crc_errors: int = 0
    skipped_bytes: int = 0
    device_overflows: int = 0
    doubled: int = 0
    late: int = 0


class MotionState(StrEnum):
    """State of a controller; in all but RUNNING the axes are at rest."""

    IDLE = "idle"
    READY = "ready"  # a path is loaded
    RUNNING = "running"
    HELD = "held"
    FINISHED = "finished"
    ABORTED = "aborted"
    ALARM = "alarm"
    NOT_READY = "not-ready"  # drives off
    UNHOMED = "unhomed"
    ESTOP = "estop"
    DOOR = "door"


@dataclass(frozen=True, slots=True)
class Hindrance:
    """Why a machine cannot be moved, and the remedy."""

    text: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.text}; {self.remedy}"


HELD_BY_PERSON = "operator"
"""The hold reason of a feed that an operator holds at the panel."""

# The states in which a machine cannot be driven.
UNABLE: Mapping[MotionState, Hindrance] = MappingProxyType(
    {
        MotionState.ALARM: Hindrance(
            "the controller is in alarm", "clear the alarm at the machine"
        ),
        MotionState.NOT_READY: Hindrance(
            "the drives are off", "switch the machine on, or reset it"
        ),
        MotionState.UNHOMED: Hindrance("the machine is not homed", "home it"),
        MotionState.ESTOP: Hindrance(
            "the emergency stop is active", "release it at the machine, then reset"
        ),
        MotionState.DOOR: Hindrance("a door is open", "close it"),
    }
)


@dataclass(frozen=True, slots=True)
class MotionStatus:
    """One reading of a controller.

    position : of each axis, mm or deg
    line : row of the loaded path, from 0, that the machine moves towards or dwells at;
        0 before the path was started, its last value after the motion
    alarm : text of the controller where it cannot be moved
    hold_reason : "operator", "watchdog" or "command"; empty if it is not held
    override : factor on the feed, None where the controller does not report it
    referenced : whether its axes are homed, None where it does not report it
    compensation : whether it corrects the axes by its own error tables, None where it
        does not report it
    """

    state: MotionState
    position: tuple[float, ...]
    line: int
    alarm: str = ""
    hold_reason: str = ""
    override: float | None = None
    referenced: bool | None = None
    compensation: bool | None = None

    @property
    def is_busy(self) -> bool:
        """Whether it runs a program, or an operator holds one at the panel.

        The program may be any client's, with the tool in the work; a hold by command or
        watchdog is the rest of a motion of the service.
        """
        held = self.state is MotionState.HELD and self.hold_reason == HELD_BY_PERSON
        return held or self.state is MotionState.RUNNING
