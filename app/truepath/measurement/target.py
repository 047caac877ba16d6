"""The reflector of a measurement: checked, and searched after the beam was lost.

Each point has to belong to its stated target (`TargetCheck`). A lost target is searched
by the tracker while the machine is at rest: it aims at the predicted position and
searches there. A target found elsewhere is another one. A beam that came back by itself
needs no search.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.driver_border import Call
from truepath.kinematics.conditions import observe_targets
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.time_limits import EngineSettings, Stopwatch
from truepath.numerics.rigid import fit_rigid
from truepath_drivers.interfaces.errors import DeviceError, NotOffered
from truepath_drivers.interfaces.tracker import TargetFinder

BOUND_MM = 5.0  # targets sit to a millimetre or so, and the machine has its errors
_KEPT = 50
TRIES = 3  # for one loss
MOST_FOUND = 3  # losses on a path, or at one point: more are for a person to look at
_PAUSE_S = 1.0  # between tries
_SEEN_S = 2.0  # after a search that has found, valid samples come by then
_APART_MM = 5.0  # nearer to another one it adds no information
_FEWEST, _WIDE_MM = 4, 50.0  # points, and their spread across, that determine a pose
_ASTRAY_MM = 30.0  # seats of targets, errors of the machine, a shift

_Vector = NDArray[np.float64]
Sight = Callable[[], _Vector | None]
"""Newest position of a target that is seen now, None where none is."""


def state_point(machine: Machine, position: Mapping[str, float], name: str) -> _Vector:
    """Position of a target by the machine file, (3,) mm.

    position : by axis, mm or deg; name : empty for the only target
    """
    row = np.array([[position.get(axis, 0.0) for axis in machine.axis_names]])
    return observe_targets(machine, row, [machine.target(name)]).point_mm[0]


class TargetCheck:
    """Compares each point with those before it, by their distances."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._kept: deque[tuple[_Vector, _Vector]] = deque(maxlen=_KEPT)

    def measure_misfit(
        self, position: dict[str, float], name: str, place_mm: _Vector
    ) -> float:
        """Deviation of a point from its expected position, mm; kept if it fits.

        position : of every axis, by name
        """
        stated = state_point(self._machine, position, name)
        misfit = max(
            (
                abs(np.linalg.norm(place_mm - place) - np.linalg.norm(stated - other))
                for other, place in self._kept
            ),
            default=0.0,
        )
        if misfit <= BOUND_MM:
            self._kept.append((stated, np.array(place_mm, float)))
        return float(misfit)


@dataclass(frozen=True, slots=True)
class SearchStep:
    """Outcome of a try.

    has_found : the target is seen again; is_last : nothing more is tried
    """

    text: str
    has_found: bool = False
    is_last: bool = False


class TargetSearch:
    """The tries to find a target again. One thread.

    machine : gives the stated targets
    """

    def __init__(
        self, tracker: TargetFinder, machine: Machine, settings: EngineSettings
    ) -> None:
        self._tracker, self._settings = tracker, settings
        self._places = ObservedPoints(machine)
        self._lost, self._waiting = (Stopwatch() for _ in range(2))
        self._found = Counter[int]()
        self._task: Call | None = None
        self._expected: ExpectedPoint | None = None
        self._tries = 0
        self._is_over, self._is_able = False, True

    def remember(
        self,
        position: dict[str, float],
        name: str,
        place_mm: _Vector,
        *,
        is_still: bool,
    ) -> None:
        """Store the position of a target that is seen, thus not lost."""
        self._places.remember(position, name, place_mm, is_still=is_still)

    def discard_loss(self) -> None:
        """Reset all tries: no target is lost."""
        self._lost.reset()
        self._waiting.reset()
        self._task, self._tries, self._is_over = None, 0, False

    def advance(
        self, position: dict[str, float], name: str, key: int, see: Sight | None
    ) -> SearchStep | None:
        """Begin a try, or give its outcome. Never waits; the machine is at rest.

        key : equal for losses that belong together
        see : None for a polled tracker
        """
        lost_s = self._lost.measure_s()
        if self._is_over or not self._is_able:
            return None
        if self._task is not None:
            return self._follow(self._task, key, see, lost_s)
        if see is not None and see() is not None:
            return None  # it came back without a search: an operator resumes
        if self._tries and self._waiting.measure_s() < _PAUSE_S:
            return None
        return self._try(position, name, key, lost_s)

    def _try(
        self, position: dict[str, float], name: str, key: int, lost_s: float
    ) -> SearchStep | None:
        expected = self._places.predict_point(position, name)
        is_late = lost_s > self._settings.timeouts.search_s
        if expected is None or is_late or self._found[key] >= MOST_FOUND:
            return self._give_up("the tracker is not asked to search again")
        self._tries += 1
        self._expected = expected
        self._task = Call(lambda: self._aim_and_search(expected))
        self._waiting.reset()
        return None

    def _aim_and_search(self, expected: ExpectedPoint) -> None:
        self._tracker.aim(*expected.direction_rad)
        self._tracker.search()

    def _follow(
        self, task: Call, key: int, see: Sight | None, lost_s: float
    ) -> SearchStep | None:
        if not task.is_over:
            return None
        if task.failure is not None:
            if not isinstance(task.failure, DeviceError):
                raise task.failure
            if isinstance(task.failure, NotOffered):
                self._task, self._is_over, self._is_able = None, True, False
                return SearchStep(str(task.failure))
            return self._fail(str(task.failure))
        place = None if see is None else see()
        if see is not None and place is None:
            if self._waiting.measure_s() < _SEEN_S:
                return None
            return self._fail("it found one, and no valid sample came")
        if lost_s > self._settings.timeouts.search_s:
            return self._give_up("it was found too late to go on by itself")
        expected, tracker = self._expected, self._tracker
        if place is not None and expected is not None:
            away_mm = float(np.linalg.norm(place - expected.place_mm))
            if away_mm > expected.reach_mm:
                # A resume must not measure the wrong one.
                Call(lambda: tracker.aim(*expected.direction_rad))
                return self._fail(f"it found another one, {away_mm:.0f} mm away")
        self._found[key] += 1
        return SearchStep(f"{self._describe_try()}: it was found", has_found=True)

    def _fail(self, text: str) -> SearchStep:
        self._task = None
        self._waiting.reset()
        self._waiting.measure_s()
        self._is_over = self._tries >= TRIES
        text = f"{self._describe_try()}: {text}"
        return SearchStep(text, is_last=self._is_over)

    def _give_up(self, text: str) -> SearchStep:
        self._task, self._is_over = None, True
        return SearchStep(f"after {self._tries} tries: {text}", is_last=True)

    def _describe_try(self) -> str:
        if self._expected is None:
            return f"try {self._tries} of {TRIES}"
        azimuth, elevation = np.degrees(self._expected.direction_rad).tolist()
        return (
            f"try {self._tries} of {TRIES}, aimed at azimuth {azimuth:.2f}° and "
            f"elevation {elevation:.2f}° ({self._expected.basis})"
        )


@dataclass(frozen=True, slots=True)
class ExpectedPoint:
    """Predicted target position in the tracker's frame.

    reach_mm : largest expected deviation
    basis : source of the prediction, as text
    """

    place_mm: _Vector
    reach_mm: float
    basis: str

    @property
    def direction_rad(self) -> tuple[float, float]:
        """Azimuth from x towards y, elevation from the xy plane towards z."""
        x, y, z = self.place_mm.tolist()
        return float(np.arctan2(y, x)), float(np.arctan2(z, np.hypot(x, y)))


class ObservedPoints:
    """Observed target positions, at rest and in motion. One thread."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._standing, self._moving = _Pairs(), _Pairs()
        self._newest: tuple[_Vector, _Vector] | None = None
        self._step_mm = 0.0  # between the two newest: axes and place differ in time

    def remember(
        self,
        position: dict[str, float],
        name: str,
        place_mm: _Vector,
        *,
        is_still: bool,
    ) -> None:
        """Store an observed position.

        position : of every axis, by name; is_still : the machine was at rest
        """
        stated = state_point(self._machine, position, name)
        place = np.array(place_mm, float)
        if self._newest is not None:
            self._step_mm = float(np.linalg.norm(stated - self._newest[0]))
        self._newest = stated, place
        (self._standing if is_still else self._moving).add(stated, place)

    def predict_point(
        self, position: dict[str, float], name: str
    ) -> ExpectedPoint | None:
        """Predicted position, None where no target was ever seen."""
        if self._newest is None:
            return None
        stated, (last, place) = state_point(self._machine, position, name), self._newest
        exact = self._standing.predict_point(stated)
        rough = self._moving.predict_point(stated)
        if exact is not None:
            return ExpectedPoint(exact, _ASTRAY_MM, "as the standstills have it")
        reach_mm = _ASTRAY_MM + self._step_mm
        if rough is not None:
            return ExpectedPoint(rough, reach_mm, "as the lines have it")
        away_mm = float(np.linalg.norm(stated - last))
        return ExpectedPoint(place, reach_mm + away_mm, "where it was seen last")


class _Pairs:
    def __init__(self) -> None:
        self._stated: deque[_Vector] = deque(maxlen=_KEPT)
        self._seen: deque[_Vector] = deque(maxlen=_KEPT)

    def add(self, stated: _Vector, seen: _Vector) -> None:
        if all(np.linalg.norm(stated - other) > _APART_MM for other in self._stated):
            self._stated.append(stated)
            self._seen.append(seen)

    def predict_point(self, stated: _Vector) -> _Vector | None:
        """None where the pairs do not determine it."""
        if len(self._stated) < _FEWEST:
            return None
        known = np.array(self._stated)
        across = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)[1]
        if across < _WIDE_MM:
            return None
        return fit_rigid(known, np.array(self._seen)).apply(stated[None])[0]
