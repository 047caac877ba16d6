"""What crosses the border of the cell process: its set-up, commands and events.

A command is a verb or the record that it is about; an event is a frozen record, one
class a kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from truepath.files.bundle.run import PointBlock
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.durations import Durations
from truepath.measurement.time_limits import StreamTimeouts
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
    """Where a cell is. The last four end an order; another may follow."""

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
    """Which drivers a cell uses, by their names as plug-ins, and how they are made.

    timeouts : for how long the tracker's stream may be less than good
    allow_no_watchdog : move a machine that does not hold the feed by itself
    thermometer_driver : empty where there are none
    light : of a tracker that does not correct for the air; None where it does, or its
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

    run_file : where the Run is recorded; must not exist
    commanded : a path is streamed on the fly, points are stepped through
    feed_mm_min : feed of the approach and between standstill points
    reserve_bytes : space that must stay free on the disk
    live : report recorded blocks, for an estimate and for eyes on the way
    grows : after the last row request a further part, and stand until there is one or
        the measurement is concluded
    job_id, machine_id, machine_version : of the job that measures and its machine, for
        the Run to name
    active_tables : SHA-256 by name of the files that the control is known to have
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
    """Listen to the tracker for a moment; nothing moves.

    duration_s : of the stream; a polled tracker measures one point instead, unless
        `streams_only`: then it measures nothing
    """

    rate_hz: float
    duration_s: float = 1.0
    streams_only: bool = False


class CellVerb(StrEnum):
    """Commands that need no argument."""

    CONNECT = "connect"  # to tracker and controller
    PAUSE = "pause"  # hold the feed; acknowledged by the state `paused`
    RESUME = "resume"  # go on after a hold; acknowledged by `running`
    CONCLUDE = "conclude"  # finish the line or point under way, leave out the rest
    ABORT = "abort"  # stop and forget the path; acknowledged by `aborted`
    BEAT = "beat"  # the service can be reached; who says it once has to go on
    CLOSE = "close"  # end the process


MeasurementCommand = CellVerb | Commanded
"""A verb for a measurement under way, or a further part to go on with."""
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
    """Event: what the tracker has sent in a trial.

    usable : samples that it calls valid; distance_mm : their mean distance from the
        tracker, None where none is usable
    rate_hz : of the samples by the device's clock, None where they are too few
    streams : false of a polled tracker that was not asked to measure
    """

    samples: int
    usable: int
    lost_samples: int
    distance_mm: float | None
    rate_hz: float | None = None
    streams: bool = True


@dataclass(frozen=True, slots=True)
class StateChanged:
    """Event: the cell is in another state; `text` says why."""

    state: CellState
    text: str = ""


@dataclass(frozen=True, slots=True)
class MeasurementProgress:
    """Event: how far a measurement is, several times a second.

    unit : what is counted, `lines` or `points`
    stage : `preparing`, `measuring`, `closing`
    line_s : time of the line or point under way, from its beginning, at the pace so far
    gaps : places where samples are missing; lost_samples : how many are
    crc_errors : since the tracker was connected
    queue_depth : what waits to be written; commits : how long each commit took
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
    commits: Durations = field(default_factory=Durations)


@dataclass(frozen=True, slots=True)
class LivePoints:
    """Event: some of the recorded points, for display.

    axes : controller position
    environment : newest reading of each sensor that shows one, by its channel
    """

    tracker_mm: list[list[float]]
    axes: list[float]
    device_time_s: float
    environment: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BlockRecorded:
    """Event: a block that is on disk, for estimate and eyes; only if asked for.

    block : of the stream, or points of a tracker that is polled
    """

    block: TrackerSamples | PointBlock


@dataclass(frozen=True, slots=True)
class PartRequested:
    """Event: the machine stands at the last row: go on with a part, or conclude."""

    row: int


@dataclass(frozen=True, slots=True)
class LinesDamaged:
    """Event: lines were driven without a whole stream; they are driven again.

    row : the first of them
    again : what is driven now; None where the order grows: who extends it decides
    """

    row: int
    again: Commanded | None


@dataclass(frozen=True, slots=True)
class ControllerRead:
    """Event: what the controller shows while nothing is measured.

    status : None where it did not answer; `text` then says why
    axes : names of the axes of its position, in their order
    """

    status: MotionStatus | None
    text: str = ""
    axes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TemperaturesRead:
    """Event: what thermometers show while nothing is measured, by their channels."""

    readings: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class SensorsTried:
    """Event: what each sensor shows by the ways to read it, as of the last connect.

    refused : why the driver does not read them; empty where it does
    """

    tries: tuple[ReadingTry, ...] = ()
    refused: str = ""


@dataclass(frozen=True, slots=True)
class FaultReported:
    """Event: something is wrong; the state says whether this is the end.

    code : for programs; text : what happened; action : what to do now
    """

    code: str
    text: str
    action: str


@dataclass(frozen=True, slots=True)
class RunClosed:
    """Event: the last one of a measurement, after its final state.

    run_file : one read-only file, or as much of it as could be written; empty if none
        was made
    outcome : the final state; empty of a repaired Run
    sha256 : of the file; empty if it could not be closed properly
    failure : why not; empty if all is well
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
"""Takes an event. Called from any thread; returns at once."""
