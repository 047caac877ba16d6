"""Program of a CNC: waypoints, joined by straight lines and arcs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath_simulators.motion.arc import Arc

# A line shorter than this is no line: waypoints come in steps of 0.1 µm.
SHORTEST_MM = 1e-6
_LINEAR = 3  # columns are X, Y, Z, then the rotary axes


@dataclass(frozen=True, slots=True)
class Program:
    """Waypoints in order, joined by straight lines and arcs with a stop at each.

    position : (n, axes), mm or deg; dwell_s : (n,) at each row
    feed_mm_s : (n,) towards each row; deg/s where no linear axis moves
    target : measured on the way to and at each row; empty for the machine's first
    arc : to each row, None for a straight line; empty if there is none
    """

    position: np.ndarray
    feed_mm_s: np.ndarray
    dwell_s: np.ndarray
    target: tuple[str, ...] = ()
    arc: tuple[Arc | None, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


def path_length(step: np.ndarray) -> np.ndarray:
    """Lengths to which the feed refers, of steps (n, axes) between waypoints.

    That of the linear axes in mm; where none of them moves, that of the rotary axes in
    deg.
    """
    straight = np.linalg.norm(step[:, :_LINEAR], axis=1)
    turn = np.linalg.norm(step[:, _LINEAR:], axis=1)
    return np.where(straight > SHORTEST_MM, straight, turn)
