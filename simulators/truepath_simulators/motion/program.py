"""What a CNC drives: waypoints, joined by straight lines and arcs."""

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
    feed_mm_s : (n,) towards each row; deg/s where no straight axis moves
    target : measured on the way to and at each row; none for the machine's first
    arc : on which each row is driven to, None for a straight line; none at all if empty
    """

    position: np.ndarray
    feed_mm_s: np.ndarray
    dwell_s: np.ndarray
    target: tuple[str, ...] = ()
    arc: tuple[Arc | None, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


def path_length(step: np.ndarray) -> np.ndarray:
    """Return the lengths that the feed counts of steps (n, axes) between waypoints.

    That of the straight axes in mm; where none of them moves, that of the rotary axes
    in deg.
    """
    straight = np.linalg.norm(step[:, :_LINEAR], axis=1)
    turn = np.linalg.norm(step[:, _LINEAR:], axis=1)
    return np.where(straight > SHORTEST_MM, straight, turn)
