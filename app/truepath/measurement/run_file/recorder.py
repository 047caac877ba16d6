"""Recording of a Run during measurement: raw batches first, all else after.

A batch is one transaction of the Run's SQLite file (WAL, synchronous FULL) and has a
CRC. Writing has a separate thread behind a bounded queue, for a commit may take 150–350
ms on a busy disk and must never delay the reader of a port. Nothing sees a batch before
it is committed.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import queue
import shutil
import sqlite3
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from truepath.documents.whole_files import sync_to_disk
from truepath.errors import MeasurementFailed
from truepath.files.bundle.run import PointBlock, PointRows
from truepath.measurement.faults import Fault
from truepath.measurement.messages import ReportEvent, RunClosed
from truepath.measurement.run_file.run_file import (
    AXES_STREAM,
    CLOSED,
    ENVIRONMENT_STREAM,
    LINK_STREAM,
    POINT_STREAM,
    QUALITY_STREAM,
    TRACKER_STREAM,
    Batch,
    RunHeader,
    create_run_file,
    encode_manifest,
    insert_batches,
    insert_events,
    pack_axes,
    pack_environment,
    pack_point,
    pack_quality,
    pack_samples,
    put_manifest,
    replace_commanded,
    seal,
    transaction,
)
from truepath.measurement.time_limits import DurationHistogram
from truepath.motion.configurations import Commanded
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import AxisSamples, TrackerSamples
from truepath_drivers.interfaces.tracker_records import PointMeasurement

log = logging.getLogger(__name__)

RESERVE_BYTES = 500 << 20
QUEUE_ITEMS = 200
PUT_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 60.0
SPACE_CHECK_S = 1.0

OnRecorded = Callable[[TrackerSamples | PointBlock], None]


@dataclass(frozen=True, slots=True)
class _Item:
    """One transaction; `events` are rows without their number."""

    batches: tuple[Batch, ...] = ()
    events: tuple[tuple[int, int, str, str], ...] = ()
    recorded: TrackerSamples | PointBlock | None = None
    manifest: dict[str, str] = field(default_factory=dict)


class Recorder:
    """One Run being written. `put…`, `event` and `extend` are for any thread.

    on_recorded : called by the writer's thread with each block of samples once it is on
        disk; must return at once; an error of it is logged
    reserve_bytes : space on the disk below which `is_space_low` turns true
    failure : why nothing can be written any more; else empty
    samples, lost_samples : handed over so far, and missing between by their counter
    gaps : number of gaps between samples
    commits : duration of each commit, waiting for the disk included

    Raises MeasurementFailed if the file cannot be begun.
    """

    def __init__(
        self,
        file: Path,
        header: RunHeader,
        *,
        on_recorded: OnRecorded | None = None,
        reserve_bytes: int = RESERVE_BYTES,
    ) -> None:
        self.file, self.failure, self.is_space_low = file, "", False
        self.samples = self.lost_samples = self.gaps = 0
        self.commits = DurationHistogram()
        self._on_recorded, self._reserve_bytes = on_recorded, reserve_bytes
        self._queue: queue.Queue[_Item | None] = queue.Queue(QUEUE_ITEMS)
        self._has_callback_failed = False
        self._checked_space_s = host_clock.now_s()
        self._link_bytes = self._axis_rows = self._environment_rows = 0
        self._channels = header.channels
        self._last_sequence: int | None = None
        self._lock = threading.Lock()
        self._database = self._begin(header)
        self._writer = threading.Thread(
            target=self._write, name="run-writer", daemon=True
        )
        self._writer.start()

    @property
    def queue_depth(self) -> int:
        """Number of transactions waiting to be written."""
        return self._queue.qsize()

    @property
    def is_strained(self) -> bool:
        """Whether the disk is so slow that the queue is half full."""
        return self.queue_depth * 2 > self._queue.maxsize

    @property
    def is_relaxed(self) -> bool:
        """Whether the queue is less than a tenth full."""
        return self.queue_depth * 10 < self._queue.maxsize

    def put_tracker(self, samples: TrackerSamples, link: bytes = b"") -> None:
        """Hand over a block of samples and the bytes that carried it.

        Raises MeasurementFailed if the disk has failed, is too slow for the queue, or
        the device's counter went back.
        """
        with self._lock:
            batches = self._pack_tracker(samples, link)
            if batches:
                self._put(_Item(batches=batches, recorded=samples))

    def put_point(self, row: int, point: PointMeasurement, link: bytes = b"") -> None:
        """Hand over the mean of a standstill point and its commanded row."""
        with self._lock:
            number = self.samples
            sample = TrackerSamples(
                np.array([number]),
                np.array([point.time_s]),
                point.position_mm[None],
                np.zeros(1, np.int64),
            )
            about = PointRows(
                np.array([row]), np.array([point.count]), point.covariance_mm2[None]
            )
            batch = _stamp_batch(POINT_STREAM, number, 1, pack_point(row, point))
            batches = (batch, *self._pack_tracker(sample, link))
            self._put(_Item(batches, recorded=PointBlock(sample, about)))

    def put_axes(self, samples: AxisSamples) -> None:
        """Hand over controller positions."""
        rows = len(samples.host_time_s)
        with self._lock:
            batch = _stamp_batch(AXES_STREAM, self._axis_rows, rows, pack_axes(samples))
            self._axis_rows += rows
            self._put(_Item(batches=(batch,)))

    def put_environment(
        self, host_time_s: float, readings: Mapping[str, float]
    ) -> None:
        """Hand over readings of some channels, by the host's monotonic clock."""
        row = [readings.get(name, math.nan) for name in self._channels]
        record = pack_environment(host_time_s, row)
        with self._lock:
            number = self._environment_rows
            self._put(_Item((_stamp_batch(ENVIRONMENT_STREAM, number, 1, record),)))
            self._environment_rows += 1

    def event(self, kind: str, text: str) -> None:
        """Hand over an event, stamped with both clocks of the host."""
        body = json.dumps({"text": text}, ensure_ascii=False)
        with self._lock:
            row = (host_clock.now_ns(), host_clock.wall_ns(), kind, body)
            self._put(_Item(events=(row,)))

    def extend(self, commanded: Commanded) -> None:
        """Replace the commanded rows: all of them, the earlier ones included."""
        with self._lock:
            self._manifest = replace_commanded(self._manifest, commanded)
            self._put(_Item(manifest=self._manifest))

    def close(self, outcome: str) -> RunClosed:
        """Write pending data, make the file one read-only file and hash it.

        Never raises: `failure` of the result names what could not be done.
        """
        with contextlib.suppress(queue.Full):
            host_clock.put(self._queue, None, CLOSE_TIMEOUT_S)
        host_clock.join(self._writer, CLOSE_TIMEOUT_S)
        sha256 = ""
        if self._writer.is_alive():
            self.failure = self.failure or "the disk does not answer"
        else:
            try:
                sha256 = self._seal(outcome)
            except (sqlite3.Error, OSError) as error:
                self.failure = self.failure or _describe_storage_error(self.file, error)
                self._database.close()
        counts = self.samples, self.lost_samples
        return RunClosed(str(self.file), outcome, *counts, sha256, self.failure)

    def _begin(self, header: RunHeader) -> sqlite3.Connection:
        if self.file.exists():
            raise MeasurementFailed(f"{self.file} exists; give the Run another name")
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            if self._free_bytes() < self._reserve_bytes:
                raise MeasurementFailed(
                    f"less than {self._reserve_bytes >> 20} MiB are free under "
                    f"{self.file.parent}; free some space, then measure again"
                )
            self._manifest = encode_manifest(header, datetime.now(UTC).isoformat())
            database = create_run_file(self.file, self._manifest)
            # Without its tables and its manifest a log that is cut is worth nothing.
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            sync_to_disk(self.file.parent)
        except (sqlite3.Error, OSError) as error:
            raise MeasurementFailed(
                _describe_storage_error(self.file, error)
            ) from error
        return database

    def _pack_tracker(self, samples: TrackerSamples, link: bytes) -> tuple[Batch, ...]:
        batches: list[Batch] = []
        if len(samples):
            first = self._count_samples(samples)
            packed = pack_samples(samples)
            batches.append(_stamp_batch(TRACKER_STREAM, first, len(samples), packed))
            if samples.quality is not None:
                packed = pack_quality(samples.quality)
                batches.append(
                    _stamp_batch(QUALITY_STREAM, first, len(samples), packed)
                )
        if link:
            seq0, self._link_bytes = self._link_bytes, self._link_bytes + len(link)
            batches.append(_stamp_batch(LINK_STREAM, seq0, len(link), link))
        return tuple(batches)

    def _count_samples(self, samples: TrackerSamples) -> int:
        sequence = samples.sequence
        first, before = int(sequence[0]), self._last_sequence
        steps = np.diff(sequence, prepend=first - 1 if before is None else before)
        if (steps < 1).any():
            raise MeasurementFailed(
                "the tracker's counter went back; it was restarted: measure again"
            )
        self.lost_samples += int(steps.sum()) - len(samples)
        self.gaps += int((steps > 1).sum())
        self.samples += len(samples)
        self._last_sequence = int(sequence[-1])
        return first

    def _put(self, item: _Item) -> None:
        if self.failure:
            raise MeasurementFailed(self.failure)
        try:
            host_clock.put(self._queue, item, PUT_TIMEOUT_S)
        except queue.Full:
            self.failure = (
                f"the disk under {self.file.parent} is too slow: {self._queue.maxsize} "
                "batches wait; use a local disk"
            )
            raise MeasurementFailed(self.failure) from None

    def _write(self) -> None:
        while (item := host_clock.get(self._queue)) is not None:
            if self.failure:
                continue
            try:
                self._commit(item)
                self._check_space()
            except (sqlite3.Error, OSError) as error:
                self.failure = _describe_storage_error(self.file, error)
                continue
            if item.recorded is not None and self._on_recorded is not None:
                self._report_recorded(self._on_recorded, item.recorded)

    def _report_recorded(
        self, on_recorded: OnRecorded, block: TrackerSamples | PointBlock
    ) -> None:
        """A failure there must not end the recording."""
        try:
            on_recorded(block)
        except Exception:
            if not self._has_callback_failed:
                log.exception("recorded samples cannot be shown; recording goes on")
            self._has_callback_failed = True

    def _commit(self, item: _Item) -> None:
        begun_s = host_clock.now_s()
        with transaction(self._database):
            put_manifest(self._database, item.manifest)
            insert_batches(self._database, item.batches)
            insert_events(self._database, item.events)
        self.commits = self.commits.add(host_clock.now_s() - begun_s)

    def _free_bytes(self) -> int:
        return shutil.disk_usage(self.file.parent).free

    def _check_space(self) -> None:
        now_s = host_clock.now_s()
        if now_s - self._checked_space_s >= SPACE_CHECK_S:
            self._checked_space_s = now_s
            self.is_space_low = self._free_bytes() < self._reserve_bytes

    def _seal(self, outcome: str) -> str:
        end = {
            "outcome": outcome,
            "samples": self.samples,
            "lost_samples": self.lost_samples,
            "ended": datetime.now(UTC).isoformat(),
        }
        put_manifest(self._database, {CLOSED: json.dumps(end)})
        return seal(self._database, self.file)


def _stamp_batch(stream: str, seq0: int, n: int, payload: bytes) -> Batch:
    return Batch(stream, seq0, n, host_clock.now_ns(), host_clock.wall_ns(), payload)


def _describe_storage_error(file: Path, error: Exception) -> str:
    return f"the Run cannot be written to {file} ({error}); check disk space and rights"


class EventLog:
    """Records events in the Run and reports faults to the service. For any thread."""

    def __init__(self, recorder: Recorder, report: ReportEvent) -> None:
        self._recorder, self._report = recorder, report

    def record(self, kind: str, text: str) -> None:
        """Record an event. Never raises: the recorder keeps its failure."""
        with contextlib.suppress(MeasurementFailed):
            self._recorder.event(kind, text)

    def report_fault(self, fault: Fault) -> None:
        """Report and record a fault that the measurement may survive."""
        self.record(fault.code, fault.text)
        self._report(fault.event)
