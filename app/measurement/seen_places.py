"""Where a target has been seen at which axis positions, and where it should be now."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.app.kinematics.conditions import observe_targets
from truepath.app.kinematics.machine import Machine
from truepath.app.numerics.rigid import fit_rigid

_KEPT = 50
_APART_MM = 5.0  # nearer to another one it tells nothing new
_FEWEST, _WIDE_MM = 4, 50.0  # places, and their spread across, that tell a pose
_ASTRAY_MM = 30.0  # seats of targets, errors of the machine, a knock

_Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ExpectedPlace:
    """Where a target should be, in the tracker's frame.

    reach_mm : how far from it the target may be
    basis : what it is foretold from, in plain words
    """

    place_mm: _Vector
    reach_mm: float
    basis: str

    @property
    def direction_rad(self) -> tuple[float, float]:
        """Azimuth from x towards y, elevation from the xy plane towards z."""
        x, y, z = self.place_mm.tolist()
        return float(np.arctan2(y, x)), float(np.arctan2(z, np.hypot(x, y)))


class SeenPlaces:
    """Places of targets, where the machine stood and where it moved. One thread."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._standing, self._moving = _Pairs(), _Pairs()
        self._newest: tuple[_Vector, _Vector] | None = None
        self._step_mm = 0.0  # between the two newest: axes and place differ in time

    def remember(
        self, position: dict[str, float], name: str, place_mm: _Vector, *, stands: bool
    ) -> None:
        """Take note of where the target is seen.

        position : of every axis, by name; stands : the machine stood there
        """
        stated, place = self._state_place(position, name), np.array(place_mm, float)
        if self._newest is not None:
            self._step_mm = float(np.linalg.norm(stated - self._newest[0]))
        self._newest = stated, place
        (self._standing if stands else self._moving).add(stated, place)

    def foretell(self, position: dict[str, float], name: str) -> ExpectedPlace | None:
        """Return where the target should be, None where none was ever seen."""
        if self._newest is None:
            return None
        stated, (last, place) = self._state_place(position, name), self._newest
        exact, rough = self._standing.foretell(stated), self._moving.foretell(stated)
        if exact is not None:
            return ExpectedPlace(exact, _ASTRAY_MM, "as the standstills have it")
        reach_mm = _ASTRAY_MM + self._step_mm
        if rough is not None:
            return ExpectedPlace(rough, reach_mm, "as the lines have it")
        away_mm = float(np.linalg.norm(stated - last))
        return ExpectedPlace(place, reach_mm + away_mm, "where it was seen last")

    def _state_place(self, position: dict[str, float], name: str) -> _Vector:
        machine = self._machine
        row = np.array([[position.get(axis, 0.0) for axis in machine.axis_names]])
        return observe_targets(machine, row, [machine.target(name)]).point_mm[0]


class _Pairs:
    """Stated places and where they were seen."""

    def __init__(self) -> None:
        self._stated: deque[_Vector] = deque(maxlen=_KEPT)
        self._seen: deque[_Vector] = deque(maxlen=_KEPT)

    def add(self, stated: _Vector, seen: _Vector) -> None:
        if all(np.linalg.norm(stated - other) > _APART_MM for other in self._stated):
            self._stated.append(stated)
            self._seen.append(seen)

    def foretell(self, stated: _Vector) -> _Vector | None:
        """Return where a stated place is seen, None where the pairs do not tell."""
        if len(self._stated) < _FEWEST:
            return None
        known = np.array(self._stated)
        across = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)[1]
        if across < _WIDE_MM:
            return None
        return fit_rigid(known, np.array(self._seen)).apply(stated[None])[0]
