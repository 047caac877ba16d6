"""Messages across the border of the cell process: set-up, commands, events.

A command is a verb or a record of its subject; an event is a frozen record, one class
per kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from truepath.files.bundle.run import PointBlock
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.time_limits import DurationHistogram, StreamTimeouts
from truepath.motion.configurations import Commanded, Configurations
from truepath_drivers.interfaces.records import (
    Identity,
    MotionStatus,
    Path,
    TrackerSamples,
)
from truepath_drivers.interfaces.thermometers import ReadingTry
from truepath_drivers.interfaces.tracker_records import Light


class CellState(StrEnum):
    """State of a cell. The last four end an order; another may follow."""

    CONNECTING = "connecting"
    READY = "ready"
    RUNNING = "running"
    PAUSING = "pausing"
    PAUSED = "paused"
    RESUMING = "resuming"
    FINISHED = "finished"
    ABORTED = "aborted"
    FAILED = "failed"
    FAULTED = "faulted"


@dataclass(frozen=True, slots=True)
class CellConfig:
    """Drivers of a cell by plug-in name, with their options.

    timeouts : tolerated times of a degraded tracker stream
    allow_no_watchdog : move a machine that does not hold the feed automatically
    thermometer_driver : empty without thermometers
    light : of a tracker without correction for the air; None where it corrects, or its
        driver knows
    """

    tracker_driver: str
    tracker_options: Mapping[str, Any]
    motion_driver: str
    motion_options: Mapping[str, Any]
    timeouts: StreamTimeouts = field(default_factory=StreamTimeouts)
    allow_no_watchdog: bool = False
    thermometer_driver: str = ""
    thermometer_options: Mapping[str, Any] = field(default_factory=dict)
    light: Light | None = None


@dataclass(frozen=True, slots=True)
class MeasurementOrder:
    """One measurement to make.

    run_file : new file of the Run; must not exist
    commanded : a path is measured on the fly, points at rest
    feed_mm_min : feed of the approach and between standstill points
    reserve_bytes : space that must stay free on the disk
    live : report recorded blocks, for live estimate and display
    grows : after the last row request a further part, and wait at rest until there is
        one or the measurement is concluded
    job_id, machine_id, machine_version : of the job that measures and its machine, for
        the Run to name
    active_tables : SHA-256 by name of the compensation files known to be in the control
    """

    run_name: str
    run_file: str
    machine: Machine
    commanded: Path | Configurations
    rate_hz: float = 500.0
    feed_mm_min: float = 6000.0
    reserve_bytes: int = 500 << 20
    live: bool = False
    grows: bool = False
    job_id: str = ""
    machine_id: str = ""
    machine_version: int = 0
    active_tables: Mapping[str, str] = field(default_factory=dict[str, str])


@dataclass(frozen=True, slots=True)
class TrackerTrial:
    """Short test of the tracker without motion.

    duration_s : of the stream; a polled tracker measures one point instead, or nothing
        with `streams_only`
    """

    rate_hz: float
    duration_s: float = 1.0
    streams_only: bool = False


class CellVerb(StrEnum):
    """Commands without an argument."""

    CONNECT = "connect"  # to tracker and controller
    PAUSE = "pause"  # hold the feed; acknowledged by the state `paused`
    RESUME = "resume"  # resume after a hold; acknowledged by `running`
    CONCLUDE = "conclude"  # finish the current line or point, omit the rest
    ABORT = "abort"  # stop and discard the path; acknowledged by `aborted`
    BEAT = "beat"  # the service can be reached; once sent, has to be repeated
    CLOSE = "close"  # end the process


MeasurementCommand = CellVerb | Commanded
"""A verb for an active measurement, or a further part of it."""
CellCommand = MeasurementCommand | MeasurementOrder | TrackerTrial
"""The same, a measurement to begin, or a trial of the tracker."""


@dataclass(frozen=True, slots=True)
class Connected:
    """Event: tracker and controller have answered."""

    devices: Mapping[str, Identity]


@dataclass(frozen=True, slots=True)
class ConnectRefused:
    """Event: a device cannot be connected, or tried.

    family : name of the class of the error
    """

    family: str
    text: str


@dataclass(frozen=True, slots=True)
class TrackerTried:
    """Event: samples of a trial of the tracker.

    usable : valid samples; distance_mm : their mean distance from the tracker, None
        without any
    rate_hz : of the samples by the device's clock, None where they are too few
    streams : false of a polled tracker that was not requested to measure
    """

    samples: int
    usable: int
    lost_samples: int
    distance_mm: float | None
    rate_hz: float | None = None
    streams: bool = True


@dataclass(frozen=True, slots=True)
class StateChanged:
    """Event: new state of the cell, with its reason in `text`."""

    state: CellState
    text: str = ""


@dataclass(frozen=True, slots=True)
class MeasurementProgress:
    """Event: progress of a measurement, several times per second.

    unit : `lines` or `points`
    stage : `preparing`, `measuring`, `closing`
    line_s : expected duration of the current line or point, at the pace so far
    gaps : number of gaps in the stream; lost_samples : number of missing samples
    crc_errors : since the tracker was connected
    queue_depth : transactions waiting to be written; commits : duration of each
    """

    done: int
    total: int
    unit: str
    stage: str
    elapsed_s: float
    remaining_s: float
    line_s: float = 0.0
    position: tuple[float, ...] = ()
    samples: int = 0
    lost_samples: int = 0
    crc_errors: int = 0
    gaps: int = 0
    queue_depth: int = 0
    commits: DurationHistogram = field(default_factory=DurationHistogram)


@dataclass(frozen=True, slots=True)
class LivePoints:
    """Event: some of the recorded points, for display.

    axes : controller position
    environment : newest reading of each working sensor, by channel
    """

    tracker_mm: list[list[float]]
    axes: list[float]
    device_time_s: float
    environment: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BlockRecorded:
    """Event: a block that is on disk, for estimate and display; only if requested.

    block : of the stream, or points of a polled tracker
    """

    block: TrackerSamples | PointBlock


@dataclass(frozen=True, slots=True)
class PartRequested:
    """Event: the machine is at rest at the last row: extend or conclude."""

    row: int


@dataclass(frozen=True, slots=True)
class LinesDamaged:
    """Event: lines lack part of their stream and are repeated.

    row : the first of them
    again : rows to be repeated; None where the order grows: the service decides
    """

    row: int
    again: Commanded | None


@dataclass(frozen=True, slots=True)
class ControllerRead:
    """Event: controller status while no measurement is active.

    status : None without a reply; `text` gives the reason
    axes : names of the axes of its position, in their order
    """

    status: MotionStatus | None
    text: str = ""
    axes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TemperaturesRead:
    """Event: thermometer readings by channel while no measurement is active."""

    readings: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class SensorsTried:
    """Event: trial readings of each sensor at the last connect, by way to read it.

    refused : why the driver does not read them; else empty
    """

    tries: tuple[ReadingTry, ...] = ()
    refused: str = ""


@dataclass(frozen=True, slots=True)
class FaultReported:
    """Event: a fault; the state indicates whether it ends the measurement.

    code : for programs; text : description; action : remedy
    """

    code: str
    text: str
    action: str


@dataclass(frozen=True, slots=True)
class RunClosed:
    """Event: the last one of a measurement, after its final state.

    run_file : one read-only file, or as much of it as could be written; empty without
        one
    outcome : the final state; empty for a repaired Run
    sha256 : of the file; empty if it could not be closed properly
    failure : reason; empty if the file is complete
    """

    run_file: str
    outcome: str
    samples: int = 0
    lost_samples: int = 0
    sha256: str = ""
    failure: str = ""


CellEvent = (
    Connected
    | ConnectRefused
    | TrackerTried
    | StateChanged
    | MeasurementProgress
    | LivePoints
    | BlockRecorded
    | PartRequested
    | LinesDamaged
    | ControllerRead
    | TemperaturesRead
    | SensorsTried
    | FaultReported
    | RunClosed
)

ReportEvent = Callable[[CellEvent], None]
"""Called from any thread; must return at once."""
