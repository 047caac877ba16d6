"""Program of a CNC: waypoints, joined by straight lines and arcs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_LEAST_MM, _ROUNDED_MM = 0.1, 0.005  # radius; of ends in counts of 0.1 µm


@dataclass(frozen=True, slots=True)
class Arc:
    """Circular motion to a row.

    columns : of both axes; turn_rad : positive from the first towards the second
    centre_mm : in both axes
    """

    columns: tuple[int, int]
    centre_mm: tuple[float, float]
    turn_rad: float

    def radius_mm(self, place: np.ndarray) -> float:
        return math.hypot(*self._out(place))

    def length_mm(self, place: np.ndarray) -> float:
        """Length of the whole arc through a position."""
        return self.radius_mm(place) * abs(self.turn_rad)

    def direction(self, place: np.ndarray) -> np.ndarray:
        """Step per mm of path at a position."""
        x, y = self._out(place)
        sign = math.copysign(1.0 / math.hypot(x, y), self.turn_rad)
        direction = np.zeros(len(place))
        direction[list(self.columns)] = -sign * y, sign * x
        return direction

    def curvature(self, place: np.ndarray) -> np.ndarray:
        """Change of the direction per mm of path at a position."""
        x, y = self._out(place)
        square = x * x + y * y
        curvature = np.zeros(len(place))
        curvature[list(self.columns)] = -x / square, -y / square
        return curvature

    def fits(self, begin: np.ndarray, end: np.ndarray) -> bool:
        """Whether the arc leads from one position to the other."""
        x, y = self._out(begin)
        if math.hypot(x, y) < _LEAST_MM or not self.turn_rad:
            return False
        cosine, sine = math.cos(self.turn_rad), math.sin(self.turn_rad)
        led = begin.copy()
        led[list(self.columns)] = (
            self.centre_mm[0] + cosine * x - sine * y,
            self.centre_mm[1] + sine * x + cosine * y,
        )
        return bool(np.abs(led - end).max() < _ROUNDED_MM)

    def reach(self, begin: np.ndarray) -> np.ndarray:
        """Positions (n, axes) on the arc, a degree apart or less."""
        x, y = self._out(begin)
        count = 1 + int(np.ceil(abs(np.degrees(self.turn_rad))))
        angle = math.atan2(y, x) + np.linspace(0.0, self.turn_rad, count)
        places = np.tile(begin, (count, 1))
        radius = math.hypot(x, y)
        places[:, self.columns[0]] = self.centre_mm[0] + radius * np.cos(angle)
        places[:, self.columns[1]] = self.centre_mm[1] + radius * np.sin(angle)
        return places

    def _out(self, place: np.ndarray) -> tuple[float, float]:
        first, second = self.columns
        return (
            float(place[first]) - self.centre_mm[0],
            float(place[second]) - self.centre_mm[1],
        )


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
