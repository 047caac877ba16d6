"""Reading and repair of Runs: closed ones, and ones whose writer or disk failed.

All committed data are read. A batch whose CRC does not match is omitted and named, a
gap in the tracker's counter is named; nothing is joined silently.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truepath.documents.whole_files import read_whole, sync_to_disk
from truepath.errors import BundleError
from truepath.files.bundle.bundle import read_bundle
from truepath.files.bundle.recorded_files import (
    KNOWN_LENGTHS,
    add_known_lengths,
    decode_known_lengths,
)
from truepath.files.bundle.run import PointRows, Run, RunEvent
from truepath.files.bundle.sensor_gate import gate_columns
from truepath.files.environment import Series, correct_refraction, tabulate_channels
from truepath.measurement.faults import DAMAGED, NO_WATCHDOG
from truepath.measurement.messages import RunClosed
from truepath.measurement.run_file.run_file import (
    AXES_STREAM,
    CLOSED,
    ENVIRONMENT_STREAM,
    POINT_STREAM,
    QUALITY_STREAM,
    TRACKER,
    TRACKER_STREAM,
    Batch,
    RunHeader,
    connect,
    create_run_file,
    decode_header,
    hash_file,
    insert_batches,
    put_manifest,
    seal,
    transaction,
    unpack_axes,
    unpack_environment,
    unpack_points,
    unpack_quality,
    unpack_samples,
)
from truepath_drivers.interfaces.records import AxisSamples, TrackerSamples

_SQLITE = b"SQLite format 3\0"
NAMED_PROBLEMS = 100  # more would not be read
_ROWS = "row", "count", "covariance_mm2"
TORN = "torn"  # outcome of a Run whose writer was killed
_AIR_OF_POINTS = {
    "air_degC": "temperature_degc",
    "pressure_hPa": "pressure_hpa",
    "humidity_percent": "humidity_percent",
}
_NOTES = {NO_WATCHDOG.code: "watchdog", DAMAGED.code: "stream"}  # kinds of events


def open_run(file: str | Path) -> Run:
    """A Run as far as it was recorded. The file is not changed.

    Events of kind `bad-batch` and `gap` name missing data. Raises BundleError if the
    file is not a Run, or its manifest is lost.
    """
    place = Path(file)
    content = read_content(place)
    try:
        header = decode_header(content.manifest, file=place.name)
        closed = json.loads(content.manifest.get(CLOSED, "{}"))
        started = json.loads(content.manifest["started"])
    except (KeyError, ValueError) as error:
        raise BundleError(
            f"the manifest is damaged ({error})", file=place.name, remedy="use a copy"
        ) from error
    tracker, points = _join_points(read_samples(content.batches), content.batches)
    shown, doubted = gate_columns(
        tracker.device_time_s, _read_air(points), header.machine.altitude_m
    )
    temperature, air = tabulate_channels(
        {name: (tracker.device_time_s, values) for name, values in shown.items()}
        | _read_channels(content.batches, header.channels)
    )
    refraction, tracker = correct_refraction(
        header.refraction, tracker, temperature, air, header.machine.altitude_m
    )
    missing = [*content.problems, *_find_gaps(tracker)]
    return Run(
        name=header.name,
        machine=header.machine,
        commanded=header.commanded,
        tracker=tracker,
        temperature=temperature,
        air=air,
        refraction=refraction,
        axis_samples=_axes(content.batches, header.axes),
        points=None if points is None else PointRows(*map(points.__getitem__, _ROWS)),
        events=(*content.events, *doubted, *_make_events(missing)),
        provenance={
            "source": place.name,
            "started": started,
            "outcome": closed.get("outcome", TORN),
            **_describe_machine(header),
            **_describe_control(header),
            **_describe_notes(content.events),
            **{
                name: f"{who.maker} {who.model} {who.serial_number} {who.firmware}"
                for name, who in header.devices.items()
            },
            **{
                f"{name}_plugin": f"{which.name} of {which.distribution} "
                f"{which.version}, interface {which.interface_version}"
                for name, which in header.plugins.items()
            },
        },
    )


def _describe_machine(header: RunHeader) -> dict[str, str]:
    if not header.machine_id:
        return {}
    version = str(header.machine_version)
    return {"machine_id": header.machine_id, "machine_version": version}


def _describe_control(header: RunHeader) -> dict[str, str]:
    if header.control_compensation is None:
        return {}
    if not header.control_compensation:
        return {"control_compensation": "off"}
    tables = json.dumps(dict(header.active_tables))
    known = {"active_tables": tables} if header.active_tables else {}
    return {"control_compensation": "on", **known}


def open_recorded(place: str | Path) -> Run:
    """The Run of a Run file, or of a bundle: a folder or a .zip.

    Includes known lengths from a file beside it. Raises BundleError.
    """
    place = Path(place)
    is_run_file = place.suffix == ".sqlite" and not place.is_dir()
    run = open_run(place) if is_run_file or _is_sqlite(place) else read_bundle(place)
    beside = name_known_lengths(place)
    if not beside.is_file():
        return run
    lengths = decode_known_lengths(read_whole(beside), file=beside.name)
    return add_known_lengths(run, lengths)


def name_known_lengths(place: Path) -> Path:
    """Path of known lengths added to a Run file or bundle later."""
    place = place.absolute()
    name = place.name if place.is_dir() else place.stem
    return place.with_name(f"{name}.{KNOWN_LENGTHS}")


def read_job_id(file: str | Path) -> str:
    """Job that recorded a Run, empty where its file does not name one."""
    try:
        with open_database(Path(file)) as database:
            query = "SELECT value FROM manifest WHERE key = 'job'"
            row = database.execute(query).fetchone()
            return str(json.loads(row[0])) if row else ""
    except (sqlite3.Error, OSError, ValueError, TypeError):
        return ""


def _is_sqlite(place: Path) -> bool:
    if not place.is_file():
        return False
    with place.open("rb") as source:
        return source.read(len(_SQLITE)) == _SQLITE


def read_samples(batches: list[Batch]) -> TrackerSamples:
    """Samples of all batches, in order; quality where it was recorded."""
    qualities = {
        b.seq0: unpack_quality(b.payload) for b in batches if b.stream == QUALITY_STREAM
    }
    blocks: list[TrackerSamples] = []
    for batch in batches:
        if batch.stream == TRACKER_STREAM:
            quality = qualities.get(batch.seq0)
            blocks.append(replace(unpack_samples(batch.payload), quality=quality))
    return TrackerSamples.join(blocks)


def _join_points(
    tracker: TrackerSamples, batches: list[Batch]
) -> tuple[TrackerSamples, NDArray[np.void] | None]:
    """Samples of complete points, with their records; None of a stream."""
    found = [b for b in batches if b.stream == POINT_STREAM]
    if not found:
        return tracker, None
    number = np.array([b.seq0 for b in found])
    records = np.concatenate([unpack_points(b.payload) for b in found])
    _, sample, point = np.intersect1d(tracker.sequence, number, return_indices=True)
    return tracker.select(sample), records[point]


def _read_air(points: NDArray[np.void] | None) -> dict[str, NDArray[np.float64]]:
    if points is None or not len(points):
        return {}
    told = {name: points[field].copy() for name, field in _AIR_OF_POINTS.items()}
    return {name: values for name, values in told.items() if np.isfinite(values).any()}


def _read_channels(
    batches: list[Batch], channels: tuple[str, ...]
) -> dict[str, Series]:
    """Series on the tracker's clock. Both clocks meet where a batch of samples was
    handed over, at most some tenths of a second after its last sample.
    """
    rows = [
        unpack_environment(b.payload, len(channels))
        for b in batches
        if b.stream == ENVIRONMENT_STREAM
    ]
    last = [
        (1e-9 * b.mono_ns, np.frombuffer(b.payload[-TRACKER.itemsize :], TRACKER)[0])
        for b in batches
        if b.stream == TRACKER_STREAM
    ]
    if not rows or not last:
        return {}
    host_s = np.array([at_s for at_s, _ in last])
    device_s = np.array([float(sample["device_time_s"]) for _, sample in last])
    table = np.concatenate(rows)
    table = table[np.argsort(table[:, 0], kind="stable")]
    time_s = _to_device(table[:, 0], host_s, device_s)
    return {
        name: (time_s, table[:, column])
        for column, name in enumerate(channels, start=1)
    }


def _to_device(
    at_s: NDArray[np.float64],
    host_s: NDArray[np.float64],
    device_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Host times beyond the ends are extrapolated at the host's rate."""
    span_s = host_s[-1] - host_s[0]
    rate = (device_s[-1] - device_s[0]) / span_s if span_s > 0.0 else 1.0
    inside = np.interp(at_s, host_s, device_s)
    before = np.minimum(at_s - host_s[0], 0.0)
    after = np.maximum(at_s - host_s[-1], 0.0)
    return inside + rate * (before + after)


def _axes(batches: list[Batch], axes: tuple[str, ...]) -> AxisSamples | None:
    blocks = [unpack_axes(b.payload, axes) for b in batches if b.stream == AXES_STREAM]
    if not blocks:
        return None
    return AxisSamples(
        axes,
        np.concatenate([b.host_time_s for b in blocks]),
        np.concatenate([b.position_mm for b in blocks]),
    )


def _find_gaps(tracker: TrackerSamples) -> list[str]:
    steps = np.diff(tracker.sequence)
    return [
        f"gap: {steps[i] - 1} samples after sequence {tracker.sequence[i]}"
        for i in np.flatnonzero(steps > 1)[:NAMED_PROBLEMS]
    ]


def _make_events(missing: list[str]) -> list[RunEvent]:
    return [
        RunEvent(0, "gap" if text.startswith("gap") else "bad-batch", text)
        for text in missing[:NAMED_PROBLEMS]
    ]


def _describe_notes(events: list[RunEvent]) -> dict[str, str]:
    texts = {event.kind: event.text for event in reversed(events)}
    return {name: texts[kind] for kind, name in _NOTES.items() if kind in texts}


_LEAST_ROW_BYTES = 64  # no row of the file is smaller
_NO_RUN = ("no such table", "not a database")

Row = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class RunContent:
    """Readable rows of a Run file; `problems` describe the rest."""

    manifest: dict[str, str]
    batches: list[Batch]
    events: list[RunEvent]
    event_rows: list[Row]
    problems: list[str]


def read_content(file: Path) -> RunContent:
    """Readable part of a Run file. Raises BundleError if it is none."""
    if not file.is_file():
        raise BundleError("no such Run", file=str(file), remedy="check the path")
    try:
        with open_database(file) as database:
            return _read_rows(database, file)
    except sqlite3.Error as error:
        raise BundleError(
            f"is not a Run file ({error})", file=file.name, remedy="use a copy"
        ) from error


@contextmanager
def open_database(file: Path) -> Iterator[sqlite3.Connection]:
    """Open a Run to read. One with a log left behind is recovered in a copy of both."""
    log = find_log(file)
    if not log.exists():
        address = f"{file.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(address, uri=True)) as database:
            yield database
        return
    with tempfile.TemporaryDirectory(prefix="truepath-run-") as folder:
        copy = Path(folder) / file.name
        shutil.copyfile(file, copy)
        shutil.copyfile(log, copy.with_name(log.name))
        with closing(sqlite3.connect(copy)) as database:
            yield database


def find_log(file: Path) -> Path:
    """SQLite's write-ahead log of the file."""
    return file.with_name(file.name + "-wal")


def _read_rows(database: sqlite3.Connection, file: Path) -> RunContent:
    problems: list[str] = []
    manifest = _read_table(database, "manifest", "key, value", file, problems)
    columns = "stream, seq0, n, mono_ns, wall_ns, payload, crc32"
    batches: list[Batch] = []
    for *row, crc32 in _read_table(database, "batch", columns, file, problems):
        batch = Batch(*row)
        if _is_complete(batch, crc32):
            batches.append(batch)
        else:
            problems.append(f"batch of {row[0]} at {row[1]}: its CRC does not match")
    batches.sort(key=lambda b: (b.stream, b.seq0))
    event_rows = _read_table(
        database, "event", "seq, mono_ns, wall_ns, kind, body", file, problems
    )
    events = [_event(row, problems) for row in event_rows]
    return RunContent(
        dict(manifest), batches, [e for e in events if e], event_rows, problems
    )


def _is_complete(batch: Batch, crc32: int) -> bool:
    try:
        return batch.crc32 == crc32
    except (TypeError, AttributeError, ArithmeticError, ValueError):
        return False  # a damaged page may hold any type in any column


def _event(row: Row, problems: list[str]) -> RunEvent | None:
    seq, mono_ns, _, kind, body = row
    try:
        return RunEvent(int(mono_ns), str(kind), str(json.loads(body)["text"]))
    except (TypeError, ValueError, KeyError):
        problems.append(f"event {seq} is damaged")
        return None


def _read_table(
    database: sqlite3.Connection,
    table: str,
    columns: str,
    file: Path,
    problems: list[str],
) -> list[Row]:
    """Row by row where a page is damaged."""
    query = f"SELECT {columns} FROM {table}"  # noqa: S608
    try:
        return database.execute(f"{query} ORDER BY rowid").fetchall()
    except sqlite3.DatabaseError as error:
        if any(sign in str(error) for sign in _NO_RUN):
            raise
    problems.append(f"pages of the table {table} are damaged")
    rows: list[Row] = []
    for number in range(1, file.stat().st_size // _LEAST_ROW_BYTES):
        try:
            rows += database.execute(f"{query} WHERE rowid = ?", (number,)).fetchall()
        except sqlite3.DatabaseError:
            continue
    return rows


def repair_run(file: str | Path) -> RunClosed:
    """Make one closed file of a Run whose writer was killed.

    What SQLite itself cannot repair is copied batch by batch into a new file; the
    damaged one is kept beside it as `.torn`. A closed Run stays as it is.
    """
    place = Path(file)
    content = read_content(place)
    tracker = read_samples(content.batches)
    failure = "; ".join(content.problems[:NAMED_PROBLEMS])
    lost = int(np.diff(tracker.sequence).sum()) - max(len(tracker) - 1, 0)
    end = {"outcome": TORN, "samples": len(tracker), "lost_samples": lost}
    if content.problems:
        content.manifest.setdefault(CLOSED, json.dumps(end))
        sha256 = _salvage(place, content)
    elif CLOSED in content.manifest and not find_log(place).exists():
        sha256 = hash_file(place)
    else:
        database = connect(place)
        if CLOSED not in content.manifest:
            put_manifest(database, {CLOSED: json.dumps(end)})
        sha256 = seal(database, place)
    return RunClosed(str(place), "", len(tracker), lost, sha256, failure)


def _salvage(file: Path, content: RunContent) -> str:
    draft = file.with_name(file.name + ".salvage")
    draft.unlink(missing_ok=True)
    database = create_run_file(draft, content.manifest)
    with transaction(database):
        insert_batches(database, tuple(content.batches))
        database.executemany(
            "INSERT INTO event VALUES (?, ?, ?, ?, ?)", content.event_rows
        )
    sha256 = seal(database, draft)
    file.replace(file.with_name(file.name + ".torn"))
    if find_log(file).exists():
        find_log(file).replace(file.with_name(file.name + ".torn-wal"))
    file.with_name(file.name + "-shm").unlink(missing_ok=True)
    draft.replace(file)
    sync_to_disk(file.parent)
    return sha256
