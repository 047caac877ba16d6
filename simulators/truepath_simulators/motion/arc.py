"""An arc of a program: about a centre in the plane of two linear axes."""

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
        """Distance of a position from the centre."""
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
