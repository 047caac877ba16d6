"""Rotary axes in a format: tables, places, and what a controller adds to them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.machine.machine import RotaryAxis, find_local_directions
from truepath.kinematics.machine.symbols import LINEAR, TURNS


@dataclass(frozen=True, slots=True)
class RotaryTable:
    """How far a rotary axis turns beyond its command.

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
        """Distance of neighbouring rows."""
        return float(self.position_deg[1] - self.position_deg[0])


@dataclass(frozen=True, slots=True)
class RotaryAddition:
    """What a controller adds to a rotary axis, straight between rows.

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
        """Return what it adds at commanded positions.

        direction : 1 or −1, in which the axis comes there; 0 for the mean of both
        """
        if self.period_deg:
            first = self.position_deg[0]
            at_deg = first + np.mod(at_deg - first, self.period_deg)
        added_deg = self.added_deg
        if self.half_deg is not None:
            added_deg = added_deg + direction * self.half_deg
        return np.interp(at_deg, self.position_deg, added_deg)


@dataclass(frozen=True, slots=True)
class AxisPlace:
    """Where the axis of a rotary axis is.

    location : its location errors by symbol, mm and rad, as far as the result has them
    untold : symbols that the measurement does not tell from other errors
    """

    axis: RotaryAxis
    location: Mapping[str, float]
    untold: frozenset[str] = frozenset()

    @property
    def known(self) -> frozenset[str]:
        """What the measurement tells of it."""
        return frozenset(self.location) - self.untold

    @property
    def origin_mm(self) -> Float64[np.ndarray, "3"]:
        """The point of the nominal place, shifted as the axis is."""
        return np.array(self.axis.origin_mm) + self._turn(LINEAR)

    @property
    def direction(self) -> Float64[np.ndarray, "3"]:
        """The nominal direction, tilted as the axis is."""
        nominal = np.array(self.axis.direction)
        tilted = nominal + np.cross(self._turn(TURNS), nominal)
        return tilted / np.linalg.norm(tilted)

    def _turn(self, letters: tuple[str, ...]) -> Float64[np.ndarray, "3"]:
        """Return shifts or tilts in the directions of the machine."""
        own = [self.location.get(f"{one}O{self.axis.name}", 0.0) for one in letters]
        return find_local_directions(self.axis) @ np.array(own)


def list_stated_locations(places: Iterable[AxisPlace]) -> frozenset[str]:
    """Return the symbols of what a result has of some places."""
    return frozenset(symbol for place in places for symbol in place.location)
