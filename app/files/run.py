"""A Run: what was commanded, what was recorded; its facts, the digest of its data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from app.files.machine_file import machine_to_json
from app.kinematics.machine import Machine
from app.motion.configurations import Configurations
from drivers.interfaces.records import (
    AxisSamples,
    Path,
    TemperatureSamples,
    TrackerSamples,
)
from drivers.interfaces.tracker_records import TrackerEventKind

_TOLD = frozenset(map(str, TrackerEventKind))


@dataclass(frozen=True, slots=True)
class DirectMeasurement:
    """One error measured directly, in one direction of approach, to compare with.

    position_mm, value : (n,), value in `unit`; direction `+` or `-`
    """

    error: str
    direction: str
    unit: str
    position_mm: np.ndarray
    value: np.ndarray


@dataclass(frozen=True, slots=True)
class PointRows:
    """What is known of each sample where each is the mean of a standstill point.

    row : (n,) int64, of the commanded points, from 0
    count : (n,) int64, shots in the mean
    covariance_mm2 : (n, 3, 3) of one shot about the mean; zero where it is not known
    """

    row: np.ndarray
    count: np.ndarray
    covariance_mm2: np.ndarray


@dataclass(frozen=True, slots=True)
class RunEvent:
    """Something that happened during a Run, by the host's monotonic clock."""

    mono_ns: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Run:
    """One measurement, whole or as far as it got.

    points : of a tracker that measures point by point; None where it streams
    """

    name: str
    machine: Machine
    commanded: Path | Configurations
    tracker: TrackerSamples
    temperature: TemperatureSamples | None = None
    axis_samples: AxisSamples | None = None
    points: PointRows | None = None
    reference: tuple[DirectMeasurement, ...] = ()
    events: tuple[RunEvent, ...] = ()
    provenance: dict[str, str] = field(default_factory=dict)

    @property
    def mode(self) -> str:
        """`otf` for a streamed path, `standstill` for points."""
        return "otf" if isinstance(self.commanded, Path) else "standstill"


@dataclass(frozen=True, slots=True)
class RunSummary:
    """The facts of one measurement.

    mode : `otf` or `standstill`
    digest : SHA-256 of machine, commanded rows and stream, whatever file they came from
    lines : lines of the path, or standstill points
    feed_mm_min : lowest and highest feed, None for standstill points
    measured_s : from the first to the last sample; samples : in the stream
    temperature_degc : lowest and highest of each sensor
    source : what the Run itself knows about where it comes from
    told : what the tracker itself has said meanwhile, each once
    """

    name: str
    mode: str
    digest: str
    lines: int
    feed_mm_min: tuple[float, float] | None
    measured_s: float
    samples: int
    temperature_degc: dict[str, tuple[float, float]]
    source: dict[str, str]
    told: tuple[str, ...] = ()


def summarize_run(run: Run) -> RunSummary:
    """Return the facts of a Run."""
    time_s = run.tracker.device_time_s
    feed = None
    if isinstance(run.commanded, Path):
        feed = _span(run.commanded.feed_mm_min)
    return RunSummary(
        run.name,
        run.mode,
        digest_run(run),
        # The first row of a path is where its first line starts.
        len(run.commanded) - isinstance(run.commanded, Path),
        feed,
        float(time_s[-1] - time_s[0]) if len(time_s) else 0.0,
        len(run.tracker),
        _state_temperatures(run),
        dict(run.provenance),
        tuple(dict.fromkeys(e.text for e in run.events if e.kind in _TOLD)),
    )


def number_names(names: Sequence[str]) -> list[str]:
    """Return the names of Runs, numbered where some have the same."""
    if len(set(names)) == len(names):
        return list(names)
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def digest_run(run: Run) -> str:
    """Return the SHA-256 of what an analysis reads of a Run."""
    machine = json.dumps(machine_to_json(run.machine), sort_keys=True)
    digest = hashlib.sha256(machine.encode())
    digest.update(json.dumps([run.mode, *run.commanded.target]).encode())
    commanded = [run.commanded.position, run.commanded.dwell_s]
    if isinstance(run.commanded, Path):
        commanded.append(run.commanded.feed_mm_min)
    stream = run.tracker
    if run.points is not None:
        commanded += [run.points.row, run.points.count, run.points.covariance_mm2]
    for block in (*commanded, stream.device_time_s, stream.position_mm, stream.status):
        digest.update(str(block.shape).encode())
        kind = "<f8" if np.issubdtype(block.dtype, np.floating) else "<i8"
        digest.update(np.ascontiguousarray(block, dtype=kind).tobytes())
    return digest.hexdigest()


def combine_digests(summaries: Sequence[RunSummary]) -> str:
    """Return the digest of a Run, or the SHA-256 of the digests of several."""
    if len(summaries) == 1:
        return summaries[0].digest
    every = "\n".join(summary.digest for summary in summaries)
    return hashlib.sha256(every.encode()).hexdigest()


def _state_temperatures(run: Run) -> dict[str, tuple[float, float]]:
    samples = run.temperature
    if samples is None or not len(samples.time_s):
        return {}
    return dict(
        zip(samples.names, map(_span, samples.celsius.T), strict=True),
    )


def _span(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())
