"""What crosses the border of the cell process: its set-up, its orders, its events."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from app.kinematics.machine import Machine
from app.measurement.stream_watch import Patience
from app.motion.configurations import Configurations
from drivers.interfaces.records import Path


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

    patience : for how long the tracker's stream may be less than good
    """

    tracker_driver: str
    tracker_options: Mapping[str, Any]
    motion_driver: str
    motion_options: Mapping[str, Any]
    patience: Patience = field(default_factory=Patience)


@dataclass(frozen=True, slots=True)
class Order:
    """One measurement to make.

    run_file : where the Run is recorded; must not exist
    commanded : a path is streamed on the fly, points are stepped through
    feed_mm_min : feed of the approach and between standstill points
    reserve_bytes : space that must stay free on the disk
    live : report committed blocks as events `block`, for an estimate on the way
    grows : after the last row ask for a further part, by the event `part`, and stand
        until there is one or the measurement is concluded
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


@dataclass(frozen=True, slots=True)
class CellEvent:
    """Something a cell says; kinds and bodies are listed in docs/measurement.md."""

    kind: str
    body: dict[str, Any] = field(default_factory=dict)
    mono_ns: int = 0


Report = Callable[[str, dict[str, Any]], None]
"""Takes kind and body of an event. Called from any thread; returns at once."""
