"""A Run: commanded rows, recorded data; its summary, and how it is recognised.

A digest distinguishes two recordings by a single sample. A sketch holds the smallest
hashes of a few samples in succession (min-hash: Broder, On the resemblance and
containment of documents, 1997), so that any part of a recording has its share of them.
The noise of a tracker does not give the same samples twice.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Int64, UInt64

from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.environment import ChannelFacts, Refraction, state_facts
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import (
    AirSamples,
    AxisSamples,
    Path,
    TemperatureSamples,
    TrackerSamples,
)
from truepath_drivers.interfaces.tracker_records import TrackerEventKind

IMPLAUSIBLE = "sensor-implausible"
# Kinds of the events that a cell records of sensors.
SENSOR_KINDS = frozenset(
    {
        "sensor-silent",
        "sensor-no-number",
        IMPLAUSIBLE,
        "sensor-stuck",
        "sensor-back",
    }
)
_UNKNOWN = Refraction()
_LOST_S = 0.1  # shorter, and the beam was hidden from single samples alone
_MOST_SHOWN = 1000  # rows of a path in a picture
_TOLD = frozenset(map(str, TrackerEventKind))
SKETCH = r"(?:[0-9a-f]{16})*"  # what one looks like in a file
_DIGITS = 16  # of a hash
_KEPT = 256  # a part of a hundredth has two or three of them
_WINDOW = 12  # samples in succession; fewer of a coarse tracker do coincide
_SHARED = 2  # hashes of 64 bits: not one of them is the same by chance
_MIX = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)  # of splitmix64
_STEP = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, slots=True)
class Interruptions:
    """How often a stream was not usable, and for how long altogether.

    breaks, broken_s : stretches of samples that the tracker marks invalid
    gaps, lost_samples : places where the counter steps by more than one
    searches, found : automatic searches of the tracker for a lost target, failed and
        successful
    """

    breaks: int = 0
    broken_s: float = 0.0
    gaps: int = 0
    lost_samples: int = 0
    searches: int = 0
    found: int = 0


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
class KnownLength:
    """A length known otherwise, and its measurement by the tracker.

    ends_mm : both ends in the tracker's frame
    length_mm, sigma_mm : known value, with its standard uncertainty
    """

    ends_mm: tuple[tuple[float, ...], tuple[float, ...]]
    measured_mm: float
    length_mm: float
    sigma_mm: float

    def scale(self, factor: float) -> KnownLength:
        """Multiply what the tracker measured; the known length stays."""
        first, second = (tuple(factor * x for x in end) for end in self.ends_mm)
        measured_mm = factor * self.measured_mm
        return replace(self, ends_mm=(first, second), measured_mm=measured_mm)


@dataclass(frozen=True, slots=True)
class PointRows:
    """Details of samples that are means of standstill points.

    row : (n,) int64, of the commanded points, from 0
    count : (n,) int64, shots in the mean
    covariance_mm2 : (n, 3, 3) of one shot about the mean; zero where it is not known
    """

    row: np.ndarray
    count: np.ndarray
    covariance_mm2: np.ndarray

    @classmethod
    def join(cls, parts: Sequence[PointRows]) -> PointRows:
        """In order; one part at least."""
        return cls(
            np.concatenate([part.row for part in parts]),
            np.concatenate([part.count for part in parts]),
            np.concatenate([part.covariance_mm2 for part in parts]),
        )


@dataclass(frozen=True, slots=True)
class PointBlock:
    """Some measured points of a Run in progress, one sample each."""

    samples: TrackerSamples
    points: PointRows


@dataclass(frozen=True, slots=True)
class RunEvent:
    """An event during a Run, by the host's monotonic clock."""

    mono_ns: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Run:
    """One measurement, complete or interrupted.

    temperature, air : as sensors showed them; None where there were none
    refraction : which party has corrected the ranges of the tracker for the air
    points : of a tracker that measures point by point; None where it streams
    known_lengths : measured by this tracker from the same station, in the same air
    stream_file : the one that the user sent
    """

    name: str
    machine: Machine
    commanded: Path | Configurations
    tracker: TrackerSamples
    temperature: TemperatureSamples | None = None
    air: AirSamples | None = None
    refraction: Refraction = _UNKNOWN
    axis_samples: AxisSamples | None = None
    points: PointRows | None = None
    reference: tuple[DirectMeasurement, ...] = ()
    known_lengths: tuple[KnownLength, ...] = ()
    events: tuple[RunEvent, ...] = ()
    provenance: dict[str, str] = field(default_factory=dict)
    stream_file: str = "tracker.parquet"

    @property
    def mode(self) -> str:
        """`otf` for a streamed path, `standstill` for points."""
        return "otf" if isinstance(self.commanded, Path) else "standstill"


@dataclass(frozen=True, slots=True)
class CommandedFacts:
    """Commanded rows: enough to recognise them, and to draw them.

    digest : SHA-256 of the commanded rows; rows : how many there are
    shown_mm : linear axes at every row, or at every nth of a long path
    """

    digest: str = ""
    rows: int = 0
    shown_mm: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class RunSummary:
    """The facts of one measurement.

    mode : `otf` or `standstill`
    digest : SHA-256 of machine, commanded rows and stream, whatever file they came from
    sketch : to recognise a part of its stream (`sample_sketch`)
    lines : lines of the path, or standstill points
    feed_mm_min : lowest and highest feed, None for standstill points
    measured_s : from the first to the last sample; samples : in the stream
    temperature_degc : lowest and highest of each sensor
    sensors : every sensor, those without readings as well
    sensors_told : their faults, each once
    sensors_left_out : rejected readings, likewise
    source : provenance of the Run
    told : messages of the tracker meanwhile, each once
    interruptions : of the stream; driven_again : repeated lines, each time
    quality : of the samples, if the tracker reports it
    known_lengths : that its tracker has measured
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
    sensors: tuple[ChannelFacts, ...] = ()
    sensors_told: tuple[str, ...] = ()
    sensors_left_out: tuple[str, ...] = ()
    refraction: Refraction = _UNKNOWN
    interruptions: Interruptions = Interruptions()
    driven_again: tuple[str, ...] = ()
    quality: SampleQuality | None = None
    commanded: CommandedFacts = CommandedFacts()
    sketch: str = ""
    known_lengths: tuple[KnownLength, ...] = ()


def summarize_run(run: Run) -> RunSummary:
    """Summary of a Run; computes digest and sketch from all samples."""
    time_s = run.tracker.device_time_s
    feed = None
    if isinstance(run.commanded, Path):
        feed = _span(run.commanded.feed_mm_min)
    span_s = (float(time_s[0]), float(time_s[-1])) if len(time_s) else (0.0, 0.0)
    kinds = [event.kind for event in run.events]
    return RunSummary(
        run.name,
        run.mode,
        digest_run(run),
        # The first row of a path is where its first line starts.
        len(run.commanded) - isinstance(run.commanded, Path),
        feed,
        span_s[1] - span_s[0],
        len(run.tracker),
        _state_temperatures(run),
        dict(run.provenance),
        _collect_texts(run, _TOLD),
        state_facts(run.temperature, run.air, *span_s),
        _collect_texts(run, SENSOR_KINDS),
        _collect_texts(run, {IMPLAUSIBLE}),
        run.refraction,
        find_interruptions(run.tracker, kinds.count("search"), kinds.count("found")),
        tuple(e.text for e in run.events if e.kind == "again"),
        state_quality(run.tracker),
        _state_commanded(run),
        sketch_samples(run.tracker),
        run.known_lengths,
    )


def _collect_texts(run: Run, kinds: Collection[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(e.text for e in run.events if e.kind in kinds))


def number_names(names: Sequence[str]) -> list[str]:
    """Names of Runs, all numbered where some are the same."""
    if len(set(names)) == len(names):
        return list(names)
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def digest_run(run: Run) -> str:
    """SHA-256 of all that an analysis reads of a Run."""
    machine = json.dumps(machine_to_json(run.machine), sort_keys=True)
    stream = run.tracker
    blocks = [stream.device_time_s, stream.position_mm, stream.status]
    if run.points is not None:
        blocks = [run.points.row, run.points.count, run.points.covariance_mm2, *blocks]
    lengths = [repr(one).encode() for one in run.known_lengths]
    parts = [machine.encode(), *_encode_commanded(run), *_encode_blocks(blocks)]
    return _hash([*parts, *lengths])


def _hash(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def _encode_commanded(run: Run) -> Iterator[bytes]:
    yield json.dumps([run.mode, *run.commanded.target]).encode()
    blocks = [run.commanded.position, run.commanded.dwell_s]
    if isinstance(run.commanded, Path):
        blocks.append(run.commanded.feed_mm_min)
        if any(run.commanded.arc):
            yield repr(run.commanded.arc).encode()
    yield from _encode_blocks(blocks)


def _encode_blocks(blocks: Iterable[np.ndarray]) -> Iterator[bytes]:
    for block in blocks:
        yield str(block.shape).encode()
        kind = "<f8" if np.issubdtype(block.dtype, np.floating) else "<i8"
        yield np.ascontiguousarray(block, dtype=kind).tobytes()


def _state_commanded(run: Run) -> CommandedFacts:
    rows = len(run.commanded)
    linear = [run.machine.axis_names.index(a.name) for a in run.machine.linear_axes]
    shown = run.commanded.position[:: max(1, -(-rows // _MOST_SHOWN)), linear]
    digest = _hash(_encode_commanded(run))
    return CommandedFacts(digest, rows, tuple(map(tuple, shown.round(3).tolist())))


def combine_digests(summaries: Sequence[RunSummary]) -> str:
    """The digest of a Run, or the SHA-256 of the digests of several."""
    if len(summaries) == 1:
        return summaries[0].digest
    every = "\n".join(summary.digest for summary in summaries)
    return hashlib.sha256(every.encode()).hexdigest()


def _state_temperatures(run: Run) -> dict[str, tuple[float, float]]:
    samples = run.temperature
    if samples is None or not len(samples.time_s):
        return {}
    return {
        name: _span(column)
        for name, column in zip(samples.names, samples.celsius.T, strict=True)
        if np.isfinite(column).any()
    }


def _span(values: np.ndarray) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))


def find_interruptions(
    tracker: TrackerSamples, searches: int = 0, found: int = 0
) -> Interruptions:
    """Interruptions of a stream, with the searches that were recorded."""
    if len(tracker) < 2:
        return Interruptions(searches=searches, found=found)
    begin, end = _find_broken(tracker)
    step_s = float(np.median(np.diff(tracker.device_time_s)))
    skipped = np.diff(tracker.sequence) - 1
    return Interruptions(
        len(begin),
        float((end - begin).sum()) * step_s,
        int((skipped > 0).sum()),
        int(skipped[skipped > 0].sum()),
        searches,
        found,
    )


def list_locks_s(tracker: TrackerSamples) -> list[float]:
    """Times when the tracker saw its target again after it had lost it."""
    if len(tracker) < 2:
        return []
    time_s = tracker.device_time_s
    begin, end = _find_broken(tracker)
    last, next_ = np.maximum(begin - 1, 0), np.minimum(end, len(tracker) - 1)
    is_lost = time_s[next_] - time_s[last] >= _LOST_S
    is_lost &= (begin > 0) & (end < len(tracker))
    return time_s[next_[is_lost]].tolist()


def _find_broken(tracker: TrackerSamples) -> Int64[np.ndarray, "2 m"]:
    is_bad = np.concatenate([[False], tracker.status != 0, [False]])
    return np.flatnonzero(np.diff(is_bad.astype(int))).reshape(-1, 2).T


@dataclass(frozen=True, slots=True)
class SampleQuality:
    """Quality of the valid samples, 1 is best.

    low : one of twenty samples is worse
    told : share of the samples with a reported quality
    """

    mean: float
    low: float
    told: float


def state_quality(samples: TrackerSamples) -> SampleQuality | None:
    """None where the instrument reports none for any valid sample."""
    if samples.quality is None:
        return None
    valid = samples.quality[samples.status == 0].astype(np.float64)
    told = valid[np.isfinite(valid)]
    if not len(told):
        return None
    low = float(np.percentile(told, 5.0))
    return SampleQuality(float(told.mean()), low, len(told) / len(valid))


def sketch_samples(samples: TrackerSamples) -> str:
    """The smallest hashes of the usable samples, in one text."""
    return "".join(
        f"{value:0{_DIGITS}x}" for value in _find_smallest(_hash_samples(samples))
    )


def _find_smallest(hashes: UInt64[np.ndarray, " n"]) -> UInt64[np.ndarray, " k"]:
    """The smallest distinct ones; to sort all took a fifth of an analysis."""
    few = _KEPT
    while few < len(hashes):
        smallest = np.unique(np.partition(hashes, few)[:few])
        if len(smallest) >= _KEPT:
            return smallest[:_KEPT]
        few *= 4
    return np.unique(hashes)[:_KEPT]


def share_samples(one: str, other: str) -> bool:
    """Whether half of a recording, or more, is in another as well, by sketches.

    Less is no sign: a simulated tracker may begin each time with the same noise, before
    the machine moves.
    """
    mine, theirs = _split(one), _split(other)
    if not mine or not theirs:
        return False
    last = min(max(mine), max(theirs))  # beyond it one of them is incomplete
    fewest = min(sum(value <= last for value in each) for each in (mine, theirs))
    return len(mine & theirs) >= max(_SHARED, 0.5 * fewest)  # of the shorter one


def _split(sketch: str) -> set[str]:
    return {sketch[k : k + _DIGITS] for k in range(0, len(sketch), _DIGITS)}


def _hash_samples(samples: TrackerSamples) -> UInt64[np.ndarray, " n"]:
    """A hash of every few usable samples in succession, constant ones left out."""
    usable = samples.position_mm[samples.status == 0] + 0.0  # no negative zero
    if len(usable) < _WINDOW:
        return np.empty(0, np.uint64)
    changes = np.any(usable[1:] != usable[:-1], axis=1)
    bits = np.ascontiguousarray(usable, "<f8").view("<u8")
    count = len(bits) - _WINDOW + 1
    value = np.zeros(count, np.uint64)
    moves = np.zeros(count, np.bool_)
    for k in range(_WINDOW):
        for column in range(3):
            value = _mix(value ^ bits[k : k + count, column])
        if k < _WINDOW - 1:
            moves |= changes[k : k + count]
    return value[moves]


def _mix(value: UInt64[np.ndarray, " n"]) -> UInt64[np.ndarray, " n"]:
    """Generator splitmix64."""
    value = value + _STEP
    value = (value ^ (value >> np.uint64(30))) * _MIX[0]
    value = (value ^ (value >> np.uint64(27))) * _MIX[1]
    return value ^ (value >> np.uint64(31))
