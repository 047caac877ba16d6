"""A whole motion as pieces of constant jerk along straight lines and arcs.

The pieces follow one another without a gap; the last one stands still for ever.
Positions follow in closed form for any times at once. A motion in progress is changed
by cutting the timeline and appending another future. Within a piece no axis reverses.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truepath_simulators.errors import SimulatorError


@dataclass(frozen=True, slots=True)
class State:
    """Position and speed along the line at one moment.

    curvature : change of the direction per length; gone : length of its line so far
    """

    position: np.ndarray
    direction: np.ndarray
    speed: float
    acceleration: float
    row: int
    curvature: np.ndarray
    gone: float


@dataclass(frozen=True, slots=True)
class Timeline:
    """Pieces in order of time; all arrays have one entry per piece.

    Lengths are those to which the feed refers, `path_length`.

    start_s : begin on the clock of the machine
    origin, direction : (m, axes), begin of the piece and step per length of its line
    speed, acceleration, jerk : at its begin, along the line; all zero while standing
    row : row of the path that the machine moves towards or dwells at
    curvature : (m, axes) change of the direction per length at its begin; zero on a
        straight line
    gone : length of the line to its row before it
    """

    start_s: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    row: np.ndarray
    curvature: np.ndarray
    gone: np.ndarray

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def end_s(self) -> float:
        """Begin of the last piece: from then on the machine stands."""
        return float(self.start_s[-1])

    def positions(self, time_s: np.ndarray) -> np.ndarray:
        """Axis positions (n, axes) at times (n,)."""
        piece, run = self._run(time_s)
        return bend(self.origin, self.direction, self.curvature, piece, run)

    def directions(self, time_s: np.ndarray) -> np.ndarray:
        """Step of the axes (n, axes) per length at times (n,)."""
        return turn(self.direction, self.curvature, *self._run(time_s))[0]

    def curvatures(self, time_s: np.ndarray) -> np.ndarray:
        """Change of the direction (n, axes) per length at times (n,)."""
        return turn(self.direction, self.curvature, *self._run(time_s))[1]

    def speeds(self, time_s: np.ndarray) -> np.ndarray:
        """Speeds along the path (n,) at times (n,)."""
        piece, t = self._locate(time_s)
        return self.speed[piece] + t * (
            self.acceleration[piece] + t * self.jerk[piece] / 2.0
        )

    def accelerations(self, time_s: np.ndarray) -> np.ndarray:
        """Accelerations along the path (n,) at times (n,)."""
        piece, t = self._locate(time_s)
        return self.acceleration[piece] + t * self.jerk[piece]

    def lengths(self, time_s: np.ndarray) -> np.ndarray:
        """Distance travelled along the path (n,) at times (n,)."""
        piece, run = self._run(time_s)
        return self.gone[piece] + run

    def rows(self, time_s: np.ndarray) -> np.ndarray:
        """Row towards which the machine moves, or at which it dwells, (n,)."""
        return self.row[self._locate(time_s)[0]]

    def state(self, time_s: float) -> State:
        """Position, line and speed at one time."""
        at = np.array([time_s])
        (piece,), (run,) = self._run(at)
        return State(
            position=self.positions(at)[0],
            direction=self.directions(at)[0],
            speed=max(float(self.speeds(at)[0]), 0.0),
            acceleration=float(self.accelerations(at)[0]),
            row=int(self.row[piece]),
            curvature=self.curvatures(at)[0],
            gone=float(self.gone[piece] + run),
        )

    def cut(self, time_s: float) -> Timeline:
        """Part before a time; its last piece is the one then in progress."""
        keep = max(int(np.searchsorted(self.start_s, time_s, side="left")), 1)
        return self.select(slice(0, keep))

    def since(self, time_s: float) -> Timeline:
        """Pieces that end after a time."""
        piece = int(self._locate(np.array([time_s]))[0][0])
        return self.select(slice(piece, None))

    def then(self, other: Timeline) -> Timeline:
        return join([self, other])

    def select(self, part: slice) -> Timeline:
        return Timeline(*(getattr(self, name)[part] for name in Timeline.__slots__))

    def _run(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Piece, and completed length in it, at times (n,)."""
        piece, t = self._locate(time_s)
        change = self.acceleration[piece] / 2.0 + t * self.jerk[piece] / 6.0
        return piece, t * (self.speed[piece] + t * change)

    def _locate(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        piece = np.searchsorted(self.start_s, time_s, side="right") - 1
        piece = np.maximum(piece, 0)
        return piece, np.maximum(time_s - self.start_s[piece], 0.0)


def bend(
    origin: np.ndarray,
    direction: np.ndarray,
    curvature: np.ndarray,
    piece: np.ndarray,
    run: np.ndarray,
) -> np.ndarray:
    """End points of lengths (n,) of pieces (n,), along circles and lines."""
    x = run * np.linalg.norm(curvature, axis=1)[piece]
    along, aside = run * np.sinc(x / np.pi), 0.5 * (run * np.sinc(0.5 * x / np.pi)) ** 2
    return (
        origin[piece]
        + along[:, None] * direction[piece]
        + aside[:, None] * curvature[piece]
    )


def turn(
    direction: np.ndarray, curvature: np.ndarray, piece: np.ndarray, run: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Direction and curvature after lengths (n,) of pieces (n,)."""
    square = (curvature**2).sum(axis=1)[piece]
    x = run * np.sqrt(square)
    cosine, along = np.cos(x)[:, None], (run * np.sinc(x / np.pi))[:, None]
    return (
        cosine * direction[piece] + along * curvature[piece],
        cosine * curvature[piece] - along * square[:, None] * direction[piece],
    )


def join(parts: Sequence[Timeline]) -> Timeline:
    """Timelines one after another."""
    return Timeline(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in Timeline.__slots__
        )
    )


def standing(
    position: Sequence[float] | np.ndarray, since_s: float, row: int
) -> Timeline:
    """A machine that stands still for ever."""
    origin = np.array([position], dtype=float)
    zero = np.zeros(1)
    return Timeline(
        np.array([since_s]),
        origin,
        np.zeros_like(origin),
        zero,
        zero,
        zero,
        np.array([row]),
        np.zeros_like(origin),
        zero,
    )


_HEAD = struct.Struct("<QQQI")
_BODY_AT = 64
_ROWS = 50_000


def new_board() -> int:
    """Descriptor of an empty board; the caller closes it."""
    with tempfile.TemporaryFile() as file:
        descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, _BODY_AT + 8 * _ROWS * _columns(6))
    return descriptor


class BoardWriter:
    """For the CNC."""

    def __init__(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, 0)
        self._version = 0

    def publish(self, timeline: Timeline) -> None:
        """Replace the timeline. Raises SimulatorError if it has too many pieces."""
        if len(timeline) > _ROWS:
            raise SimulatorError(f"a motion of {len(timeline)} pieces is too long")
        body = _pack(timeline)
        axes = timeline.origin.shape[1]
        self._mark(self._version + 1, len(timeline), axes, 0)  # odd: being written
        self._memory[_BODY_AT : _BODY_AT + len(body)] = body
        self._mark(self._version + 1, len(timeline), axes, zlib.crc32(body))

    def _mark(self, version: int, pieces: int, axes: int, crc: int) -> None:
        self._version = version
        _HEAD.pack_into(self._memory, 0, version, pieces, axes, crc)

    def close(self) -> None:
        self._memory.close()


class BoardReader:
    """For the tracker."""

    def __init__(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, 0, prot=mmap.PROT_READ)
        self._version = 0
        self._timeline: Timeline | None = None

    def timeline(self) -> Timeline | None:
        """Newest complete timeline; None before the first."""
        version, pieces, axes, crc = _HEAD.unpack_from(self._memory, 0)
        if version == self._version or version % 2:
            return self._timeline
        body = self._memory[_BODY_AT : _BODY_AT + 8 * pieces * _columns(axes)]
        if zlib.crc32(body) == crc:
            self._version, self._timeline = version, _unpack(body, pieces, axes)
        return self._timeline

    def close(self) -> None:
        self._memory.close()


def _columns(axes: int) -> int:
    return 6 + 3 * axes


def _pack(timeline: Timeline) -> bytes:
    scalars = [
        timeline.start_s,
        timeline.speed,
        timeline.acceleration,
        timeline.jerk,
        timeline.row,
        timeline.gone,
    ]
    vectors = timeline.origin, timeline.direction, timeline.curvature
    return np.column_stack([*scalars, *vectors]).tobytes()


def _unpack(body: bytes, pieces: int, axes: int) -> Timeline:
    table = np.frombuffer(body, float).reshape(pieces, _columns(axes))
    start, speed, acceleration, jerk, row, gone = (table[:, k].copy() for k in range(6))
    origin, direction, curvature = np.split(table[:, 6:], 3, axis=1)
    return Timeline(
        start,
        origin,
        direction,
        speed,
        acceleration,
        jerk,
        row.astype(np.int64),
        curvature,
        gone,
    )
