"""Axis positions from outside, as lines of `time position position …`.

The tracker then measures a machine that another program moves: a real controller,
another simulation, a recording. Time is that of the source, also for the tracker: a
position that has not arrived yet lies in the future.
"""

from __future__ import annotations

import os
import socket
import stat

import numpy as np

from truepath_simulators.errors import SimulatorError
from truepath_simulators.motion.program import SHORTEST_MM, path_length
from truepath_simulators.timeline import Timeline, standing

_KEPT_S = 10.0
_BLOCK = 1 << 16
_LONGEST_LINE = 4096


def open_source(source: str) -> int:
    """Descriptor of `file` (or FIFO, or /dev/stdin) or `host:port`.

    The caller closes it. Raises SimulatorError if there is no such source.
    """
    try:
        host, _, port = source.rpartition(":")
        if host and port.isdigit():
            with socket.create_connection((host, int(port)), 5.0) as connected:
                return os.dup(connected.fileno())
        return os.open(source, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise SimulatorError(f"positions from {source}: {error}") from error


class FollowedPositions:
    """The newest positions of a source.

    unit_s : a step of the first column; the columns of `axes` come next; further
        columns and lines without numbers are ignored
    """

    def __init__(self, descriptor: int, axes: int, unit_s: float = 1.0) -> None:
        self.descriptor = descriptor
        self._axes, self._unit_s = axes, unit_s
        self._rest = b""
        self._rows = np.empty((0, 1 + axes))
        self.is_ended = False
        os.set_blocking(descriptor, False)
        self._is_fifo = stat.S_ISFIFO(os.fstat(descriptor).st_mode)

    def now_s(self) -> float:
        """Time of the newest positions; 0 before the first."""
        return float(self._rows[-1, 0]) if len(self._rows) else 0.0

    def timeline(self) -> Timeline | None:
        """Read new lines; gives the motion so far, None before any."""
        self._take()
        rows = self._rows
        if not len(rows):
            return None
        last = standing(rows[-1, 1:], rows[-1, 0], 0)
        return last if len(rows) == 1 else _join(rows).then(last)

    def close(self) -> None:
        os.close(self.descriptor)

    def _take(self) -> None:
        new = [row for line in self._read_lines() if (row := self._parse(line))]
        if not new:
            return
        rows = np.vstack([self._rows, new])
        # Time that does not increase is that of a restarted source, or a repeat.
        goes_on = np.append(True, np.diff(np.maximum.accumulate(rows[:, 0])) > 0.0)
        rows = rows[goes_on]
        first = np.searchsorted(rows[:, 0], rows[-1, 0] - _KEPT_S)
        self._rows = rows[first:]

    def _read_lines(self) -> list[bytes]:
        while not self.is_ended:
            try:
                data = os.read(self.descriptor, _BLOCK)
            except BlockingIOError:
                break
            if not data:
                # A FIFO without a writer reads as ended until one comes.
                self.is_ended = not self._is_fifo
                break
            self._rest += data
        *lines, self._rest = self._rest.split(b"\n")
        self._rest = self._rest[:_LONGEST_LINE]
        return lines

    def _parse(self, line: bytes) -> list[float] | None:
        words = line.replace(b",", b" ").split()
        if len(words) <= self._axes:
            return None
        try:
            row = [float(word) for word in words[: 1 + self._axes]]
        except ValueError:
            return None
        row[0] *= self._unit_s
        return row if np.isfinite(row).all() else None


def _join(rows: np.ndarray) -> Timeline:
    time_s, position = rows[:, 0], rows[:, 1:]
    step = np.diff(position, axis=0)
    length = path_length(step)
    moves = length > SHORTEST_MM
    direction = np.zeros_like(step)
    direction[moves] = step[moves] / length[moves, None]
    n, still = len(step), np.zeros(len(step))
    return Timeline(
        time_s[:-1],
        position[:-1],
        direction,
        np.where(moves, length / np.diff(time_s), 0.0),
        still,
        still,
        np.zeros(n, np.int64),
        np.zeros_like(direction),
        still,
    )
