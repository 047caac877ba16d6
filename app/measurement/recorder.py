"""Writes a Run to disk while it is measured: raw batches first, everything else after.

A batch is one transaction of the Run's SQLite file (WAL, synchronous FULL) and has a
CRC. Writing has a thread of its own behind a bounded queue, for a commit may take
150–350 ms on a busy disk and must never hold up the reader of a port. Nothing sees a
batch before it is committed.
"""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from app.errors import MeasurementFailed
from app.files.whole_files import sync_to_disk
from app.measurement.run_database import (
    connect,
    insert_batches,
    insert_manifest,
    put_manifest,
    seal,
    transaction,
)
from app.measurement.run_file import (
    AXES_STREAM,
    CLOSED,
    LINK_STREAM,
    TABLES,
    TRACKER_STREAM,
    Batch,
    RunHeader,
    encode_manifest,
    pack_axes,
    pack_samples,
    replace_commanded,
)
from app.motion.configurations import Commanded
from drivers.interfaces.records import AxisSamples, TrackerSamples

log = logging.getLogger(__name__)

RESERVE_BYTES = 500 << 20
QUEUE_ITEMS = 200
PUT_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 60.0
GUARD_PERIOD_S = 1.0

OnRecorded = Callable[[TrackerSamples], None]


@dataclass(frozen=True, slots=True)
class ClosedRun:
    """A Run that is one read-only file, or as much of it as could be written.

    sha256 : of the file; empty if it could not be closed properly
    failure : why not; empty if all is well
    """

    file: Path
    sha256: str
    samples: int
    lost_samples: int
    failure: str = ""


@dataclass(frozen=True, slots=True)
class _Event:
    mono_ns: int
    wall_ns: int
    kind: str
    body: str


@dataclass(frozen=True, slots=True)
class _Item:
    """What goes into one transaction."""

    batches: tuple[Batch, ...] = ()
    events: tuple[_Event, ...] = ()
    samples: TrackerSamples | None = None
    manifest: dict[str, str] = field(default_factory=dict)


class Recorder:
    """One Run being written. `put…` and `event` may be called from any thread.

    committed : called from the writer's thread with each block of samples once it is on
        disk; must return at once; an error of it is logged
    reserve_bytes : space on the disk below which `low_space` turns true

    Raises MeasurementFailed if the file cannot be begun.
    """

    def __init__(
        self,
        file: Path,
        header: RunHeader,
        *,
        on_recorded: OnRecorded | None = None,
        reserve_bytes: int = RESERVE_BYTES,
        free_bytes: Callable[[], int] | None = None,
        queue_items: int = QUEUE_ITEMS,
    ) -> None:
        self.file = file
        self._on_recorded = on_recorded
        self._reserve_bytes = reserve_bytes
        self._free_bytes = free_bytes or (lambda: shutil.disk_usage(file.parent).free)
        self._queue: queue.Queue[_Item | None] = queue.Queue(queue_items)
        self._failure = ""
        self._is_space_low = False
        self._has_callback_failed = False
        self._guarded_at = time.monotonic()
        self._samples = self._lost = self._link_bytes = self._axis_rows = 0
        self._last_sequence: int | None = None
        self._lock = threading.Lock()
        self._database = self._begin(header)
        self._writer = threading.Thread(
            target=self._write, name="run-writer", daemon=True
        )
        self._writer.start()

    @property
    def failure(self) -> str:
        """Why nothing can be written any more; empty while all is well."""
        return self._failure

    @property
    def is_space_low(self) -> bool:
        """Whether the disk has less left than the reserve."""
        return self._is_space_low

    @property
    def is_strained(self) -> bool:
        """Whether the disk is so slow that the queue is half full."""
        return self._queue.qsize() * 2 > self._queue.maxsize

    @property
    def is_relaxed(self) -> bool:
        """Whether hardly anything waits."""
        return self._queue.qsize() * 10 < self._queue.maxsize

    @property
    def samples(self) -> int:
        """Tracker samples handed over so far."""
        return self._samples

    @property
    def lost_samples(self) -> int:
        """Samples missing between those handed over, by the device's counter."""
        return self._lost

    def put_tracker(self, samples: TrackerSamples, link: bytes = b"") -> None:
        """Hand over a block of samples and the bytes that carried it.

        Raises MeasurementFailed if the disk has failed, is too slow for the queue, or
        the device's counter went back.
        """
        with self._lock:
            batches = [*self._make_tracker_batch(samples), *self._make_link_batch(link)]
            if batches:
                self._put(_Item(batches=tuple(batches), samples=samples))

    def put_axes(self, samples: AxisSamples) -> None:
        """Hand over controller positions."""
        rows = len(samples.host_time_s)
        with self._lock:
            batch = _stamp_batch(AXES_STREAM, self._axis_rows, rows, pack_axes(samples))
            self._axis_rows += rows
            self._put(_Item(batches=(batch,)))

    def event(self, kind: str, text: str) -> None:
        """Write down what happened."""
        body = json.dumps({"text": text}, ensure_ascii=False)
        moment = _Event(time.monotonic_ns(), time.time_ns(), kind, body)
        with self._lock:
            self._put(_Item(events=(moment,)))

    def extend(self, commanded: Commanded) -> None:
        """Write down that more is commanded: all rows, the earlier ones included."""
        with self._lock:
            self._manifest = replace_commanded(self._manifest, commanded)
            self._put(_Item(manifest=self._manifest))

    def close(self, outcome: str) -> ClosedRun:
        """Write what waits, make the file one read-only file and sign it.

        Never raises: what could not be done is in `failure` of the answer.
        """
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=CLOSE_TIMEOUT_S)
        self._writer.join(CLOSE_TIMEOUT_S)
        if self._writer.is_alive():
            self._failure = self._failure or "the disk does not answer"
            return ClosedRun(self.file, "", self._samples, self._lost, self._failure)
        sha256 = ""
        try:
            self._write_end(outcome)
            sha256 = seal(self._database, self.file)
        except (sqlite3.Error, OSError) as error:
            self._failure = self._failure or _describe_storage_error(self.file, error)
            self._database.close()
        return ClosedRun(self.file, sha256, self._samples, self._lost, self._failure)

    def _begin(self, header: RunHeader) -> sqlite3.Connection:
        if self.file.exists():
            raise MeasurementFailed(f"{self.file} exists; give the Run another name")
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            if self._free_bytes() < self._reserve_bytes:
                raise MeasurementFailed(
                    _describe_low_space(self.file, self._reserve_bytes)
                )
            database = connect(self.file)
            database.executescript(TABLES)
            self._manifest = encode_manifest(header, datetime.now(UTC).isoformat())
            insert_manifest(database, self._manifest)
            # Without its tables and its manifest a log that is cut is worth nothing.
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            sync_to_disk(self.file.parent)
        except (sqlite3.Error, OSError) as error:
            raise MeasurementFailed(
                _describe_storage_error(self.file, error)
            ) from error
        return database

    def _make_tracker_batch(self, samples: TrackerSamples) -> list[Batch]:
        if not len(samples):
            return []
        sequence = samples.sequence
        before = self._last_sequence
        steps = np.diff(sequence, prepend=sequence[0] - 1 if before is None else before)
        if (steps < 1).any():
            raise MeasurementFailed(
                "the tracker's counter went back; it was restarted: measure again"
            )
        self._lost += int(steps.sum()) - len(samples)
        self._samples += len(samples)
        self._last_sequence = int(sequence[-1])
        payload = pack_samples(samples)
        return [_stamp_batch(TRACKER_STREAM, int(sequence[0]), len(samples), payload)]

    def _make_link_batch(self, link: bytes) -> list[Batch]:
        if not link:
            return []
        batch = _stamp_batch(LINK_STREAM, self._link_bytes, len(link), link)
        self._link_bytes += len(link)
        return [batch]

    def _put(self, item: _Item) -> None:
        if self._failure:
            raise MeasurementFailed(self._failure)
        try:
            self._queue.put(item, timeout=PUT_TIMEOUT_S)
        except queue.Full:
            self._failure = (
                f"the disk under {self.file.parent} is too slow: {self._queue.maxsize} "
                "batches wait; use a local disk"
            )
            raise MeasurementFailed(self._failure) from None

    def _write(self) -> None:
        """Body of the writer's thread: everything up to the end mark."""
        while (item := self._queue.get()) is not None:
            if self._failure:
                continue
            try:
                self._commit(item)
                self._guard()
            except (sqlite3.Error, OSError) as error:
                self._failure = _describe_storage_error(self.file, error)
                continue
            self._hand_on(item)

    def _hand_on(self, item: _Item) -> None:
        """Pass recorded samples on. A failure there must not end the recording."""
        if item.samples is None or self._on_recorded is None:
            return
        try:
            self._on_recorded(item.samples)
        except Exception:
            if not self._has_callback_failed:
                log.exception("recorded samples cannot be shown; recording goes on")
            self._has_callback_failed = True

    def _commit(self, item: _Item) -> None:
        with transaction(self._database):
            put_manifest(self._database, item.manifest)
            insert_batches(self._database, item.batches)
            self._database.executemany(
                "INSERT INTO event (mono_ns, wall_ns, kind, body) VALUES (?, ?, ?, ?)",
                [(e.mono_ns, e.wall_ns, e.kind, e.body) for e in item.events],
            )

    def _guard(self) -> None:
        now = time.monotonic()
        if now - self._guarded_at >= GUARD_PERIOD_S:
            self._guarded_at = now
            self._is_space_low = self._free_bytes() < self._reserve_bytes

    def _write_end(self, outcome: str) -> None:
        end = {
            "outcome": outcome,
            "samples": self._samples,
            "lost_samples": self._lost,
            "ended": datetime.now(UTC).isoformat(),
        }
        insert_manifest(self._database, {CLOSED: json.dumps(end)})


def _stamp_batch(stream: str, seq0: int, n: int, payload: bytes) -> Batch:
    return Batch(stream, seq0, n, time.monotonic_ns(), time.time_ns(), payload)


def _describe_low_space(file: Path, reserve_bytes: int) -> str:
    return (
        f"less than {reserve_bytes >> 20} MiB are free under {file.parent}; "
        "free some space, then measure again"
    )


def _describe_storage_error(file: Path, error: Exception) -> str:
    return f"the Run cannot be written to {file} ({error}); check disk space and rights"
