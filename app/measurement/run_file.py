"""Layout of a Run on disk: one SQLite file of checksummed batches.

`manifest` holds JSON by key, `batch` packed little-endian records of one stream each
with a CRC-32, `event` what happened. Streams:

tracker : records of `TRACKER`; seq0 is the device's counter of the first sample
tracker.link : bytes as the tracker's port received them; seq0 counts bytes
axes : host_time_s and one position per axis, all <f8; seq0 counts rows

SQLite does not checksum its pages, hence the CRC, over stream, seq0, n, both times and
payload. It is checked on every read; so is the CRC of the manifest.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from app.files.machine_file import machine_from_json, machine_to_json
from app.kinematics.machine import Machine
from app.motion.configurations import Configurations
from drivers.interfaces.records import AxisSamples, Identity, Path, TrackerSamples

SCHEMA = "run/1"
CLOSED = "closed"  # key of the manifest that is written at the end
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
TRACKER = np.dtype(
    [
        ("sequence", "<i8"),
        ("device_time_s", "<f8"),
        ("position_mm", "<f8", (3,)),
        ("status", "<i8"),
    ]
)


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
    """What is known before the first sample."""

    name: str
    machine: Machine
    commanded: Path | Configurations
    rate_hz: float
    devices: dict[str, Identity]
    axes: tuple[str, ...]


def encode_manifest(header: RunHeader, started: str) -> dict[str, str]:
    """Return the manifest rows of a header, values in JSON."""
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "name": header.name,
        "started": started,
        "machine": machine_to_json(header.machine),
        "commanded": encode_commanded(header.commanded),
        "rate_hz": header.rate_hz,
        "devices": {name: asdict(who) for name, who in header.devices.items()},
        "axes": list(header.axes),
        "streams": {
            TRACKER_STREAM: {
                "record": [
                    ["sequence", "<i8", "1"],
                    ["device_time_s", "<f8", "s"],
                    ["position_mm", "3<f8", "mm"],
                    ["status", "<i8", "1"],
                ]
            },
            LINK_STREAM: {"record": "bytes as received"},
            AXES_STREAM: {
                "record": [
                    ["host_time_s", "<f8", "s"],
                    ["position", f"{len(header.axes)}<f8", "mm or deg"],
                ]
            },
        },
    }
    rows = {key: json.dumps(v, ensure_ascii=False) for key, v in content.items()}
    return {**rows, _CRC: str(_manifest_crc(rows))}


def replace_commanded(
    manifest: dict[str, str], commanded: Path | Configurations
) -> dict[str, str]:
    """Return the manifest rows with other commanded rows, their CRC anew."""
    text = json.dumps(encode_commanded(commanded), ensure_ascii=False)
    rows = {k: v for k, v in manifest.items() if k != _CRC} | {"commanded": text}
    return {**rows, _CRC: str(_manifest_crc(rows))}


def decode_header(manifest: dict[str, str], *, file: str) -> RunHeader:
    """Return the header of manifest rows. Raises ValueError if they are damaged."""
    rows = {key: v for key, v in manifest.items() if key not in (CLOSED, _CRC)}
    if str(_manifest_crc(rows)) != manifest.get(_CRC):
        raise ValueError("its CRC does not match")
    content = {key: json.loads(value) for key, value in rows.items()}
    if content["schema"] != SCHEMA:
        raise ValueError(f"schema is {content['schema']!r}, not {SCHEMA!r}")
    return RunHeader(
        name=content["name"],
        machine=machine_from_json(content["machine"], file=f"{file}, machine"),
        commanded=decode_commanded(content["commanded"]),
        rate_hz=float(content["rate_hz"]),
        devices={key: Identity(**who) for key, who in content["devices"].items()},
        axes=tuple(content["axes"]),
    )


def _manifest_crc(rows: dict[str, str]) -> int:
    return zlib.crc32(json.dumps(sorted(rows.items()), default=str).encode())


def encode_commanded(commanded: Path | Configurations) -> dict[str, Any]:
    """Return the JSON of a path or of points."""
    content: dict[str, Any] = {
        "kind": "path" if isinstance(commanded, Path) else "points",
        "axes": list(commanded.axes),
        "position": commanded.position.tolist(),
        "dwell_s": commanded.dwell_s.tolist(),
        "target": list(commanded.target),
    }
    if isinstance(commanded, Path):
        content["feed_mm_min"] = commanded.feed_mm_min.tolist()
    return content


def decode_commanded(content: dict[str, Any]) -> Path | Configurations:
    """Return the path or the points of JSON."""
    axes, target = tuple(content["axes"]), tuple(content["target"])
    position = np.array(content["position"], np.float64).reshape(-1, len(axes))
    dwell_s = np.array(content["dwell_s"], np.float64)
    if content["kind"] == "points":
        return Configurations(axes, position, dwell_s, target)
    feed_mm_min = np.array(content["feed_mm_min"], np.float64)
    return Path(axes, position, feed_mm_min, dwell_s, target)


def pack_samples(samples: TrackerSamples) -> bytes:
    """Return samples as records of `TRACKER`."""
    records = np.empty(len(samples), TRACKER)
    records["sequence"] = samples.sequence
    records["device_time_s"] = samples.device_time_s
    records["position_mm"] = samples.position_mm
    records["status"] = samples.status
    return records.tobytes()


def unpack_samples(payload: bytes) -> TrackerSamples:
    """Return the samples of records of `TRACKER`."""
    records = np.frombuffer(payload, TRACKER)
    return TrackerSamples(
        records["sequence"].astype(np.int64),
        records["device_time_s"].astype(np.float64),
        records["position_mm"].astype(np.float64),
        records["status"].astype(np.int64),
    )


def pack_axes(samples: AxisSamples) -> bytes:
    """Return controller positions as records of the stream `axes`."""
    rows = np.column_stack([samples.host_time_s, samples.position_mm])
    return rows.astype("<f8").tobytes()


def unpack_axes(payload: bytes, axes: tuple[str, ...]) -> AxisSamples:
    """Return the controller positions of records of the stream `axes`."""
    rows = np.frombuffer(payload, "<f8").reshape(-1, 1 + len(axes)).astype(np.float64)
    return AxisSamples(axes, rows[:, 0].copy(), rows[:, 1:].copy())
