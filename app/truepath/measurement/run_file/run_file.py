"""A Run on disk: one SQLite file of checksummed batches; its layout and statements.

`manifest` holds JSON by key, `batch` packed little-endian records of one stream each
with a CRC-32, `event` the events. Streams:

tracker : records of `TRACKER`; seq0 is the device's counter of the first sample
tracker.link : bytes as the tracker's port received them; seq0 counts bytes
tracker.point : records of `POINT`, one per sample of a polled tracker; seq0 is the
    number of that sample
axes : host_time_s and one position per axis, all <f8; seq0 counts rows
environment : host_time_s and one reading per channel, all <f8, NaN where there is none;
    seq0 counts rows

SQLite does not checksum its pages, hence the CRC, over stream, seq0, n, both times and
payload. It is checked on every read; so is the CRC of the manifest.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import sqlite3
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truepath.documents.whole_files import sync_to_disk
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.environment import (
    Refraction,
    refraction_from_json,
    refraction_to_json,
)
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.plugins import PluginOrigin
from truepath_drivers.interfaces.records import AxisSamples, Identity, TrackerSamples
from truepath_drivers.interfaces.tracker_records import Air, PointMeasurement

SCHEMA = "run/1"
CLOSED = "closed"  # key of the manifest that is written at the end
BUSY_TIMEOUT_MS = 5000
_CRC = "crc32"
TABLES = """
CREATE TABLE manifest (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE batch (
  stream TEXT NOT NULL, seq0 INTEGER NOT NULL, n INTEGER NOT NULL,
  mono_ns INTEGER NOT NULL, wall_ns INTEGER NOT NULL, crc32 INTEGER NOT NULL,
  payload BLOB NOT NULL, PRIMARY KEY (stream, seq0)) STRICT;
CREATE TABLE event (
  seq INTEGER PRIMARY KEY, mono_ns INTEGER NOT NULL, wall_ns INTEGER NOT NULL,
  kind TEXT NOT NULL, body TEXT NOT NULL) STRICT;
"""
TRACKER_STREAM, LINK_STREAM, AXES_STREAM = "tracker", "tracker.link", "axes"
POINT_STREAM, ENVIRONMENT_STREAM = "tracker.point", "environment"
QUALITY_STREAM = "tracker.quality"
_TRACKER_COLUMNS = [
    ["sequence", "<i8", "1"],
    ["device_time_s", "<f8", "s"],
    ["position_mm", "3<f8", "mm"],
    ["status", "<i8", "1"],
]
TRACKER = np.dtype([(name, kind) for name, kind, _ in _TRACKER_COLUMNS])
_POINT_COLUMNS = [
    ["row", "<i8", "1"],
    ["count", "<i8", "1"],
    ["covariance_mm2", "(3,3)<f8", "mm2"],
    ["temperature_degc", "<f8", "degC"],
    ["pressure_hpa", "<f8", "hPa"],
    ["humidity_percent", "<f8", "%"],
    ["quality", "<f8", "1"],
]
POINT = np.dtype([(name, kind) for name, kind, _ in _POINT_COLUMNS])


@dataclass(frozen=True, slots=True)
class Batch:
    """One row of the table `batch`."""

    stream: str
    seq0: int
    n: int
    mono_ns: int
    wall_ns: int
    payload: bytes

    @property
    def crc32(self) -> int:
        """CRC-32 over everything else in the row."""
        head = self.stream.encode() + struct.pack(
            "<4q", self.seq0, self.n, self.mono_ns, self.wall_ns
        )
        return zlib.crc32(self.payload, zlib.crc32(head))


@dataclass(frozen=True, slots=True)
class RunHeader:
    """Data known before the first sample.

    channels : names of thermometers and sensors of the air
    refraction : device that corrects the ranges for the air, before any analysis
    job_id, machine_id, machine_version : of the job that measures and its machine;
        empty without a service
    control_compensation : whether the control applied its own error tables as the Run
        began; None where it did not report
    plugins : of the devices, by the same names; none of devices without one
    active_tables : SHA-256 by name of the compensation files in the control, where the
        service knows
    """

    name: str
    machine: Machine
    commanded: Commanded
    rate_hz: float
    devices: dict[str, Identity]
    axes: tuple[str, ...]
    channels: tuple[str, ...] = ()
    refraction: Refraction = field(default_factory=Refraction)
    job_id: str = ""
    machine_id: str = ""
    machine_version: int = 0
    control_compensation: bool | None = None
    active_tables: Mapping[str, str] = field(default_factory=dict[str, str])
    plugins: Mapping[str, PluginOrigin] = field(default_factory=dict[str, PluginOrigin])


def encode_manifest(header: RunHeader, started: str) -> dict[str, str]:
    """Manifest rows of a header, values in JSON."""
    content = {
        "schema": SCHEMA,
        "name": header.name,
        "job": header.job_id,
        "machine_id": header.machine_id,
        "machine_version": header.machine_version,
        "started": started,
        "machine": machine_to_json(header.machine),
        "commanded": _encode_commanded(header.commanded),
        "rate_hz": header.rate_hz,
        "devices": {name: asdict(who) for name, who in header.devices.items()},
        "plugins": {name: asdict(which) for name, which in header.plugins.items()},
        "axes": list(header.axes),
        "channels": list(header.channels),
        "refraction": refraction_to_json(header.refraction),
        "control_compensation": header.control_compensation,
        "active_tables": dict(header.active_tables),
        "streams": {
            TRACKER_STREAM: {"record": _TRACKER_COLUMNS},
            LINK_STREAM: {"record": "bytes as received"},
            QUALITY_STREAM: {"record": [["quality", "<f4", "1"]]},
            POINT_STREAM: {"record": _POINT_COLUMNS},
            AXES_STREAM: {
                "record": [
                    ["host_time_s", "<f8", "s"],
                    ["position", f"{len(header.axes)}<f8", "mm or deg"],
                ]
            },
            ENVIRONMENT_STREAM: {
                "record": [
                    ["host_time_s", "<f8", "s"],
                    ["reading", f"{len(header.channels)}<f8", "degC, hPa or %"],
                ]
            },
        },
    }
    return _sign({k: json.dumps(v, ensure_ascii=False) for k, v in content.items()})


def replace_commanded(manifest: dict[str, str], commanded: Commanded) -> dict[str, str]:
    """Manifest rows with other commanded rows and a new CRC."""
    text = json.dumps(_encode_commanded(commanded), ensure_ascii=False)
    return _sign({k: v for k, v in manifest.items() if k != _CRC} | {"commanded": text})


def decode_header(manifest: dict[str, str], *, file: str) -> RunHeader:
    """Raises ValueError if the manifest rows are damaged."""
    rows = {key: v for key, v in manifest.items() if key not in (CLOSED, _CRC)}
    if _sign(rows)[_CRC] != manifest.get(_CRC):
        raise ValueError("its CRC does not match")
    content = {key: json.loads(value) for key, value in rows.items()}
    if content["schema"] != SCHEMA:
        raise ValueError(f"schema is {content['schema']!r}, not {SCHEMA!r}")
    return RunHeader(
        name=content["name"],
        machine=machine_from_json(content["machine"], file=f"{file}, machine"),
        commanded=decode_commanded_json(content["commanded"]),
        rate_hz=float(content["rate_hz"]),
        devices={key: Identity(**who) for key, who in content["devices"].items()},
        axes=tuple(content["axes"]),
        channels=tuple(content.get("channels", ())),
        refraction=refraction_from_json(content.get("refraction")),
        job_id=content.get("job", ""),
        machine_id=content.get("machine_id", ""),
        machine_version=content.get("machine_version", 0),
        control_compensation=content.get("control_compensation"),
        active_tables=content.get("active_tables", {}),
        plugins={
            key: PluginOrigin(**which)
            for key, which in content.get("plugins", {}).items()
        },
    )


def _sign(rows: dict[str, str]) -> dict[str, str]:
    crc = zlib.crc32(json.dumps(sorted(rows.items()), default=str).encode())
    return {**rows, _CRC: str(crc)}


def _encode_commanded(commanded: Commanded) -> dict[str, Any]:
    exact = {"position": commanded.position.tolist()}
    return encode_commanded_json(commanded) | exact


def pack_samples(samples: TrackerSamples) -> bytes:
    """Records of `TRACKER`."""
    rows = np.empty(len(samples), TRACKER)
    for name in TRACKER.names or ():
        rows[name] = getattr(samples, name)
    return rows.tobytes()


def unpack_samples(payload: bytes) -> TrackerSamples:
    """Samples of records of `TRACKER`."""
    rows = np.frombuffer(payload, TRACKER)
    return TrackerSamples(*(rows[name].copy() for name in TRACKER.names or ()))


def pack_quality(quality: NDArray[np.float32]) -> bytes:
    """Records of the stream `tracker.quality`, <f4."""
    return quality.astype("<f4").tobytes()


def unpack_quality(payload: bytes) -> NDArray[np.float32]:
    """Quality of records of the stream `tracker.quality`, <f4."""
    return np.frombuffer(payload, "<f4").astype(np.float32)


def pack_point(row: int, point: PointMeasurement) -> bytes:
    """One record `POINT` of a measured point and its commanded row."""
    air = point.air or Air()
    record = np.zeros(1, POINT)
    record[0] = (row, point.count, point.covariance_mm2, *astuple(air), point.quality)
    return record.tobytes()


def unpack_points(payload: bytes) -> NDArray[np.void]:
    """Structured array of records `POINT`."""
    return np.frombuffer(payload, POINT)


def pack_axes(samples: AxisSamples) -> bytes:
    """Records of the stream `axes`: host_time_s, then mm or deg, all <f8."""
    rows = np.column_stack([samples.host_time_s, samples.position_mm])
    return rows.astype("<f8").tobytes()


def unpack_axes(payload: bytes, axes: tuple[str, ...]) -> AxisSamples:
    """Controller positions of records of the stream `axes`."""
    rows = np.frombuffer(payload, "<f8").reshape(-1, 1 + len(axes)).astype(np.float64)
    return AxisSamples(axes, rows[:, 0].copy(), rows[:, 1:].copy())


def pack_environment(host_time_s: float, readings: Sequence[float]) -> bytes:
    """One record of the stream `environment`, in the order of the channels."""
    return np.array([host_time_s, *readings], "<f8").tobytes()


def unpack_environment(payload: bytes, channels: int) -> NDArray[np.float64]:
    """(n, 1 + channels), the host's time first."""
    return np.frombuffer(payload, "<f8").reshape(-1, 1 + channels).astype(np.float64)


def connect(file: Path) -> sqlite3.Connection:
    """Open a Run file to write, every commit synced to the disk."""
    database = sqlite3.connect(file, isolation_level=None, check_same_thread=False)
    try:
        database.execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
    except sqlite3.Error:
        database.close()
        raise
    return database


def create_run_file(file: Path, manifest: dict[str, str]) -> sqlite3.Connection:
    """Open a new Run file to write, with its tables and its manifest."""
    database = connect(file)
    database.executescript(TABLES)
    with transaction(database):
        put_manifest(database, manifest)
    return database


@contextlib.contextmanager
def transaction(database: sqlite3.Connection) -> Iterator[None]:
    """All of the block's statements, or none."""
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            database.execute("ROLLBACK")
        raise


def put_manifest(database: sqlite3.Connection, manifest: dict[str, str]) -> None:
    """Insert rows into the table `manifest`, or replace them."""
    database.executemany(
        "INSERT OR REPLACE INTO manifest VALUES (?, ?)", manifest.items()
    )


def insert_batches(database: sqlite3.Connection, batches: Iterable[Batch]) -> None:
    """Insert rows into the table `batch`."""
    database.executemany(
        "INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?)",
        [
            (b.stream, b.seq0, b.n, b.mono_ns, b.wall_ns, b.crc32, b.payload)
            for b in batches
        ],
    )


def insert_events(
    database: sqlite3.Connection, rows: Iterable[tuple[int, int, str, str]]
) -> None:
    """Insert rows into the table `event`, numbered in their order."""
    database.executemany(
        "INSERT INTO event (mono_ns, wall_ns, kind, body) VALUES (?, ?, ?, ?)", rows
    )


def seal(database: sqlite3.Connection, file: Path) -> str:
    """Make a Run file one closed read-only file; gives its SHA-256.

    Raises sqlite3.OperationalError if another process has the file open.
    """
    with contextlib.closing(database):
        busy, _, _ = database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise sqlite3.OperationalError("the Run file is open elsewhere")
        database.execute("PRAGMA journal_mode = DELETE")
    file.chmod(0o444)
    sync_to_disk(file.parent)
    return hash_file(file)


def hash_file(file: Path) -> str:
    """SHA-256, hexadecimal."""
    with file.open("rb") as source:
        return hashlib.file_digest(source, "sha256").hexdigest()
