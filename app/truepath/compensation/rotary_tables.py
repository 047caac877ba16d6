"""Rotary axes in a format: tables, locations, and additions by the controller."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.machine.machine import RotaryAxis, compute_local_directions
from truepath.kinematics.machine.symbols import LINEAR, TURNS


@dataclass(frozen=True, slots=True)
class RotaryTable:
    """Rotation of a rotary axis beyond its command.

    position_deg : (n,) equidistant, ascending, over the travel; over one turn where the
        axis turns fully, the last row being the first again
    error_deg : (n,) mean of both directions, 0 at the axis zero, else the lowest
    half_deg : (n,) half their difference: more of the error in + direction
    motions : (n, 6) E and ω in the directions of the axis, mm and rad, of the tool
        relative to the workpiece
    """

    axis: RotaryAxis
    position_deg: Float64[np.ndarray, " n"]
    error_deg: Float64[np.ndarray, " n"]
    motions: Float64[np.ndarray, "n 6"]
    half_deg: Float64[np.ndarray, " n"]

    @property
    def spacing_deg(self) -> float:
        """Distance between neighbouring rows."""
        return float(self.position_deg[1] - self.position_deg[0])


@dataclass(frozen=True, slots=True)
class RotaryAddition:
    """Addition of a controller to a rotary axis, linear between rows.

    added_deg : mean of both directions; half_deg : half their difference, where the
        file has both
    period_deg : after which it repeats; 0 where end values hold beyond
    """

    position_deg: Float64[np.ndarray, " n"]
    added_deg: Float64[np.ndarray, " n"]
    period_deg: float = 0.0
    half_deg: Float64[np.ndarray, " n"] | None = None

    def read(
        self, at_deg: Float64[np.ndarray, " n"], direction: float = 0.0
    ) -> Float64[np.ndarray, " n"]:
        """Addition at commanded positions, deg.

        direction : 1 or −1, in which the axis arrives; 0 for the mean of both
        """
        if self.period_deg:
            first = self.position_deg[0]
            at_deg = first + np.mod(at_deg - first, self.period_deg)
        added_deg = self.added_deg
        if self.half_deg is not None:
            added_deg = added_deg + direction * self.half_deg
        return np.interp(at_deg, self.position_deg, added_deg)


@dataclass(frozen=True, slots=True)
class RotaryAxisLocation:
    """Location of the axis of a rotary axis.

    location : its location errors by symbol, mm and rad, as far as the result has them
    untold : symbols that the measurement does not distinguish from other errors
    """

    axis: RotaryAxis
    location: Mapping[str, float]
    untold: frozenset[str] = frozenset()

    @property
    def known(self) -> frozenset[str]:
        """Symbols that the measurement determines."""
        return frozenset(self.location) - self.untold

    @property
    def origin_mm(self) -> Float64[np.ndarray, "3"]:
        """Nominal point on the axis, shifted by the location error."""
        return np.array(self.axis.origin_mm) + self._turn(LINEAR)

    @property
    def direction(self) -> Float64[np.ndarray, "3"]:
        """Nominal direction, tilted by the location error; a unit vector."""
        nominal = np.array(self.axis.direction)
        tilted = nominal + np.cross(self._turn(TURNS), nominal)
        return tilted / np.linalg.norm(tilted)

    def _turn(self, letters: tuple[str, ...]) -> Float64[np.ndarray, "3"]:
        own = [self.location.get(f"{one}O{self.axis.name}", 0.0) for one in letters]
        return compute_local_directions(self.axis) @ np.array(own)


def list_stated_locations(places: Iterable[RotaryAxisLocation]) -> frozenset[str]:
    """Symbols of all locations that a result has."""
    return frozenset(symbol for place in places for symbol in place.location)
