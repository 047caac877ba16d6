"""One motion shared by two processes: the timeline on a board of shared memory.

The CNC writes, the tracker reads; neither ever waits. A change is published before the
machine time at which it takes effect, so a reader that reads its clock first and the
board second has the motion of that time. A reader that finds a half-written change
continues with its previous timeline: the change belongs to the future.

The memory is a file without a name, handed to child processes as a descriptor: nothing
is left behind if a process dies.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zlib

import numpy as np

from truepath_simulators.errors import SimulatorError
from truepath_simulators.timeline import Timeline

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
        """Release the memory."""
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
        """Release the memory."""
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
