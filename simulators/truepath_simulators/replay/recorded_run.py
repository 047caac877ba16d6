"""A Run on disk, as a script for devices that repeat it.

Read from the file alone: tables `manifest`, `batch` and `event` as in
docs/measurement.md. All times are seconds of the host that recorded, from the first
byte on.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.framing import check_frame
from truepath_drivers.tracker.streaming.messages import (
    Ack,
    StreamInfo,
    Type,
    parse_message,
)
from truepath_simulators.errors import SimulatorError

_SAMPLE = np.dtype(  # a record of the stream `tracker`
    [("sequence", "<i8"), ("time", "<f8"), ("place_mm", "<f8", 3), ("status", "<i8")]
)
_STILL_MM, _LATER_S = 0.5, 1e-3
_BATCH_S = 0.15  # the bytes of a batch came in this time before it, at most
_SETTLED = 5e-3  # mm or deg: an axis that is as near as this has arrived
_TYPE_AT = 2  # of a frame: code byte, version, type; none of them is zero
_REPLIES = {Type.ACK, Type.NAK}


@dataclass(frozen=True, slots=True)
class Move:
    """One motion of the recording: order, arrival, final position."""

    begin_s: float
    end_s: float
    goal: np.ndarray


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """Recorded behaviour of the devices.

    pieces : content between the zero bytes of the link, without replies
    piece_s : (n,) arrival of each, increasing
    opening : reply to the START of the stream
    samples, is_exact : number of samples, and whether the bytes decode to just these
    axes_s, position : (m,), (m, axes) reported by the controller; empty without a CNC
    stands_at_points : it measured at points, without a path
    """

    name: str
    machine: Mapping[str, Any]
    devices: Mapping[str, Mapping[str, Any]]
    pieces: list[bytes]
    piece_s: np.ndarray
    opening: StreamInfo
    samples: int
    is_exact: bool
    axes_s: np.ndarray
    position: np.ndarray
    moves: tuple[Move, ...]


def read_recorded_run(file: Path) -> RecordedRun:
    """A closed Run. Raises SimulatorError if it cannot be repeated."""
    manifest, batches, events = _read_tables(file)
    link = [row for row in batches if row[0] == "tracker.link"]
    if not link:
        raise SimulatorError(
            f"{file} holds no bytes of the tracker's link, so it cannot be repeated: "
            "the driver it was recorded with does not hand them out"
        )
    zero_s = 1e-9 * link[0][2] - _BATCH_S
    samples = _read_samples(batches)
    numbers = samples["sequence"]
    pieces, piece_s, measured, opening = _cut_frames(link, zero_s, len(numbers), file)
    decoded = StreamDecoder().feed(b"\0".join(pieces) + b"\0").samples.sequence
    axes_s, position = _read_axes(batches, len(manifest["axes"]), zero_s)
    moves = _find_moves(events, axes_s, position, zero_s)
    _let_orders_precede(moves, piece_s, measured, samples)
    return RecordedRun(
        manifest["name"],
        manifest["machine"],
        manifest["devices"],
        pieces,
        piece_s,
        opening,
        len(numbers),
        np.array_equal(np.diff(decoded), np.diff(numbers)) and len(numbers) > 0,
        axes_s,
        position,
        moves,
    )


def _read_tables(
    file: Path,
) -> tuple[dict[str, Any], list[tuple[Any, ...]], list[tuple[str, int]]]:
    if not file.is_file():
        raise SimulatorError(f"{file}: no such Run; check the path")
    address = f"{file.absolute().as_uri()}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            rows = dict(database.execute("SELECT key, value FROM manifest").fetchall())
            batches = database.execute(
                "SELECT stream, n, mono_ns, payload, seq0, wall_ns, crc32 FROM batch "
                "ORDER BY stream, seq0"
            ).fetchall()
            events = database.execute(
                "SELECT kind, mono_ns FROM event ORDER BY seq"
            ).fetchall()
        if "closed" not in rows:
            raise SimulatorError(f"{file} is not closed; open it with truepath first")
        manifest = {key: json.loads(rows[key]) for key in rows}
        batches = [row[:4] for row in batches if _is_complete(row)]
        return manifest, batches, events
    except (sqlite3.Error, KeyError, ValueError) as error:
        if isinstance(error, SimulatorError):
            raise
        raise SimulatorError(f"{file} is not a Run ({error}); use a copy") from error


def _is_complete(row: tuple[Any, ...]) -> bool:
    stream, n, mono_ns, payload, seq0, wall_ns, crc = row
    head = stream.encode() + np.array([seq0, n, mono_ns, wall_ns], "<i8").tobytes()
    return zlib.crc32(payload, zlib.crc32(head)) == crc


def _read_samples(batches: list[tuple[Any, ...]]) -> np.ndarray:
    payload = b"".join(row[3] for row in batches if row[0] == "tracker")
    return np.frombuffer(payload, _SAMPLE)


def _read_axes(
    batches: list[tuple[Any, ...]], axes: int, zero_s: float
) -> tuple[np.ndarray, np.ndarray]:
    payload = b"".join(row[3] for row in batches if row[0] == "axes")
    rows = np.frombuffer(payload, "<f8").reshape(-1, 1 + axes)
    return rows[:, 0] - zero_s, rows[:, 1:]


def _cut_frames(
    link: list[tuple[Any, ...]], zero_s: float, samples: int, file: Path
) -> tuple[list[bytes], np.ndarray, np.ndarray, StreamInfo]:
    """Pieces of the link without replies, up to the last recorded sample.

    In addition: arrival of each, which of them hold the samples, and the opening.
    """
    pieces = b"".join(row[3] for row in link).split(b"\0")
    ends = np.cumsum([len(piece) + 1 for piece in pieces])
    came_s = _date_bytes(link, zero_s, ends)
    opening, kept, measured = None, [], []
    for number, piece in enumerate(pieces):
        kind = piece[_TYPE_AT] if len(piece) > _TYPE_AT else 0
        if kind in _REPLIES and (body := check_frame(piece)) is not None:
            match parse_message(body):
                case Ack(detail=StreamInfo() as info) if opening is None:
                    opening = info
                case _:
                    pass
            continue
        if kind in (Type.MEAS, Type.MEAS64) and check_frame(piece) is not None:
            measured.append(len(kept))
        kept.append(number)
    if not measured or opening is None:
        raise SimulatorError(
            f"{file}: the bytes of its link are not GST/1, which is all that a "
            "simulated tracker speaks"
        )
    # Bytes go to the disk a little before their samples: the last ones may be cut.
    last = measured[min(samples, len(measured)) - 1] if samples else -1
    kept = kept[: last + 1]
    whole = np.array(measured[:samples], np.int64)
    return [pieces[k] for k in kept], came_s[kept], whole, opening


def _date_bytes(
    link: list[tuple[Any, ...]], zero_s: float, ends: np.ndarray
) -> np.ndarray:
    """Bytes arrive evenly in the time before their batch."""
    count = np.cumsum([row[1] for row in link])
    done_s = 1e-9 * np.array([row[2] for row in link]) - zero_s
    begin_s = np.maximum(done_s - _BATCH_S, np.append(0.0, done_s[:-1]))
    at = np.stack([count - [row[1] for row in link], count], 1).ravel()
    return np.interp(ends, at, np.stack([begin_s, done_s], 1).ravel())


def _let_orders_precede(
    moves: tuple[Move, ...],
    piece_s: np.ndarray,
    measured: np.ndarray,
    samples: np.ndarray,
) -> None:
    """Dates standstill before an order, motion after it, in place.

    The arrival of bytes is known to 0.1 s, which may be a large part of a motion.
    """
    seen = samples["status"][: len(measured)] == 0
    measured, place_mm = measured[seen], samples["place_mm"][: len(seen)][seen]
    arrived_s = 0.0
    for move in moves:
        before = (piece_s[measured] >= arrived_s) & (piece_s[measured] < move.begin_s)
        stood = np.flatnonzero(before)
        arrived_s = move.end_s
        if not len(stood):
            continue
        middle = stood[len(stood) // 2]
        away_mm = np.linalg.norm(place_mm[middle:] - place_mm[middle], axis=1)
        moved = measured[middle:][away_mm > _STILL_MM]
        if len(moved):
            first = moved[0]
            piece_s[:first] = np.minimum(piece_s[:first], move.begin_s)
            piece_s[first:] = np.maximum(piece_s[first:], move.begin_s + _LATER_S)


def _find_moves(
    events: list[tuple[str, int]],
    axes_s: np.ndarray,
    position: np.ndarray,
    zero_s: float,
) -> tuple[Move, ...]:
    begins = [(kind, 1e-9 * ns - zero_s) for kind, ns in events]
    orders = [s for kind, s in begins if kind == "start"]
    # The last point is followed by no motion.
    orders = orders or [s for kind, s in begins if kind == "point"][:-1]
    moves: list[Move] = []
    for begin_s, end_s in zip(orders, [*orders[1:], np.inf], strict=True):
        rows = np.flatnonzero((axes_s > begin_s) & (axes_s <= end_s))
        if not len(rows):
            continue
        goal = position[rows[-1]]
        away = np.abs(position[rows] - goal).max(axis=1) > _SETTLED
        arrived = rows[np.flatnonzero(away)[-1] + 1] if away.any() else rows[0]
        moves.append(Move(begin_s, float(axes_s[arrived]), goal))
    return tuple(moves)
