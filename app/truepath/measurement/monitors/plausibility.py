"""Plausibility of axis positions and of the target position.

Controller and tracker share neither clock nor frame. Conditions that need neither: an
axis is within its travel, moves no faster than its feed, and is on the current row; the
target moves about as far by the tracker as by the controller.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.kinematics.machine.machine import Machine
from truepath.measurement.faults import Fault, make_disagreement_fault, make_frozen
from truepath.measurement.target import state_point
from truepath_drivers.interfaces.arcs import trace
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import MotionState, MotionStatus, Path

IN_A_ROW = 2  # looks that are not to be believed, until the feed is held

_Vector = NDArray[np.float64]
_BEYOND = 10.0  # mm or deg outside the soft limits: reference marks lie there
_STEP_MM, _CYCLE_S = 0.5, 0.1  # a controller may renew what it shows so rarely
_FASTER, _FASTER_UNKNOWN = (
    1.05,
    1.5,
)  # than the feed, where the override is known or not
_JOG_MM_S = 1000.0  # of a machine that no row of ours moves
_ASIDE = 2.0  # mm or deg off the rows: following errors are less
_ROWS_NEAR = 5  # line and position may be read one after the other
_BEGUN_S = 1.0  # until then a controller may show an earlier program
_PACE_S = 0.5  # after which the pace of the tracker's clock is known
_HASTENED = 1.5
_MOVED_MM = 2.0  # much more than any tracker resolves
_FROZEN_S = _LAG_S = 0.5  # stream and controller may be apart by so much
_TIMES, _APART_MM = 3.0, 20.0  # of two distances that do not disagree


def find_impossible(motion: MotionController, position: tuple[float, ...]) -> str:
    """Axis that is not finite or outside its travel, as text; else empty."""
    for axis, (low, high), value in zip(
        motion.axes, motion.travel, position, strict=False
    ):
        if not math.isfinite(value):
            return f"{axis} reads no number"
        if not low - _BEYOND <= value <= high + _BEYOND:
            return f"{axis} reads {value:.3f}, its travel is {low:g} to {high:g}"
    return ""


class PositionGate:
    """Checks each reading of the axes against earlier ones and the commanded rows.

    tracker_s : the tracker's clock; simulations make both of them run faster
    """

    def __init__(
        self, motion: MotionController, tracker_s: Callable[[], float | None]
    ) -> None:
        self._motion, self._tracker_s = motion, tracker_s
        self._asked_s = math.nan  # when the last good reading was asked for
        self._position_before = np.empty(0)
        self._running_s: float | None = None
        self._is_doubted = False  # a jog is no way back to what is believed
        self._clocks: tuple[float, float] | None = None  # at the first sample
        self._feed_mm_s = math.inf
        self._path_points, self._rows = np.empty((0, 0)), np.empty(0, np.int64)

    def expect(self, path: Path, begin: tuple[float, ...]) -> None:
        """Announce the commanded path from here on."""
        places, self._rows = trace(path)
        self._path_points = np.vstack([np.array(begin)[None], places])
        self._feed_mm_s = float(path.feed_mm_min.max()) / 60.0
        self._running_s = None

    def check(self, status: MotionStatus, asked_s: float, now_s: float) -> str:
        """Why a reading is implausible; empty where it is accepted, which stores it.

        asked_s, now_s : times of request and reply
        """
        here = np.array(status.position)
        if status.state is not MotionState.RUNNING:
            self._running_s = None
        elif self._running_s is None:
            self._running_s = now_s
        doubt = (
            find_impossible(self._motion, status.position)
            or self._find_jump(here, status, now_s)
            or self._find_off_path(here, status, now_s)
        )
        self._is_doubted = bool(doubt)
        if not doubt:
            self._position_before, self._asked_s = here, asked_s
        return doubt

    def _find_jump(self, here: _Vector, status: MotionStatus, now_s: float) -> str:
        pace = self._measure_pace(now_s)
        if not len(self._position_before) or pace is None:
            return ""
        share = status.override
        faster = _FASTER_UNKNOWN if share is None else _FASTER * max(share, 1.0)
        speed_mm_s = faster * self._feed_mm_s
        if status.state is not MotionState.RUNNING:
            speed_mm_s = max(speed_mm_s, _JOG_MM_S)
        passed_s = pace * (now_s - self._asked_s + _CYCLE_S)
        for axis, step in zip(
            self._motion.axes, here - self._position_before, strict=False
        ):
            # Turning axes may go faster than the feed of the linear ones.
            if axis not in "ABC" and abs(step) > speed_mm_s * passed_s + _STEP_MM:
                return f"{axis} reads {step:+.3f} mm from where it was a moment ago"
        return ""

    def _measure_pace(self, now_s: float) -> float | None:
        """None if unknown, and in an accelerated simulation, whose steps are too
        coarse.
        """
        tracker_s = self._tracker_s()
        if tracker_s is None:
            return None
        if self._clocks is None:
            self._clocks = now_s, tracker_s
        passed_s = now_s - self._clocks[0]
        if passed_s < _PACE_S:
            return None
        pace = (tracker_s - self._clocks[1]) / passed_s
        return None if pace > _HASTENED else max(pace, 1.0)

    def _find_off_path(self, here: _Vector, status: MotionStatus, now_s: float) -> str:
        ran_s = 0.0 if self._running_s is None else now_s - self._running_s
        if ran_s < _BEGUN_S and not self._is_doubted:
            return ""
        near = np.flatnonzero(np.abs(self._rows - status.line) <= _ROWS_NEAR)
        if not len(near):
            return ""
        begin, way = (
            self._path_points[near],
            self._path_points[near + 1] - self._path_points[near],
        )
        length2 = np.maximum((way**2).sum(axis=1), 1e-12)
        share = np.clip(((here - begin) * way).sum(axis=1) / length2, 0.0, 1.0)
        aside = np.abs(here - begin - share[:, None] * way).max(axis=1).min()
        if aside <= _ASIDE:
            return ""
        return f"the axes read {aside:.3f} mm or deg beside row {status.line + 1}"


@dataclass(frozen=True, slots=True)
class ObservedPoint:
    """Target position of a stream.

    changes : number of blocks in which it was not bit for bit as before
    """

    device_time_s: float
    place_mm: _Vector
    changes: int


class PointCheck:
    """Compares target displacements by tracker and controller. One thread.

    has_one_target : else the tracker may be turned from one to another meanwhile
    """

    def __init__(self, machine: Machine, *, has_one_target: bool) -> None:
        self._machine, self._has_one_target = machine, has_one_target
        self._still: tuple[int, _Vector] | None = None
        self._away_s: float | None = None  # tracker's clock, frozen since then
        self._recent: deque[tuple[float, _Vector]] = deque()
        self._from: tuple[_Vector, _Vector, float] | None = None
        self._turned: tuple[float, ...] = ()
        self._doubts = 0

    def follow(
        self,
        axes: dict[str, float],
        name: str,
        seen: ObservedPoint | None,
        now_s: float,
    ) -> Fault | None:
        """Compare one look at a stream; a fault after two disagreements in a row.

        axes : positions by name; name : of the target; seen : None begins again
        """
        if seen is None:
            self._still = self._from = None
            self._doubts = 0
            return None
        stated = state_point(self._machine, axes, name)
        fault = self._find_frozen(stated, seen)
        if fault is None and self._has_one_target:
            fault = self._find_apart(axes, stated, seen.place_mm, now_s)
        return self._count(fault)

    def assess_point(
        self, axes: dict[str, float], name: str, place_mm: _Vector
    ) -> tuple[bool, Fault | None]:
        """Compare a measured point with the last good one; first value: it is good."""
        stated = state_point(self._machine, axes, name)
        fault = None
        if self._from is not None:
            moved_mm = float(np.linalg.norm(stated - self._from[0]))
            if moved_mm > _MOVED_MM and (place_mm == self._from[1]).all():
                fault = make_frozen(moved_mm)
            elif self._has_one_target:
                fault = self._compare(stated, place_mm, 0.0)
        if fault is None:
            self._from = stated, place_mm, 0.0
        return fault is None, self._count(fault)

    def _count(self, fault: Fault | None) -> Fault | None:
        self._doubts = 0 if fault is None else self._doubts + 1
        return fault if self._doubts >= IN_A_ROW else None

    def _find_frozen(self, stated: _Vector, seen: ObservedPoint) -> Fault | None:
        if self._still is None or self._still[0] != seen.changes:
            self._still, self._away_s = (seen.changes, stated), None
            return None
        moved_mm = float(np.linalg.norm(stated - self._still[1]))
        if moved_mm <= _MOVED_MM:
            return None
        if self._away_s is None:
            self._away_s = seen.device_time_s
        is_lag = seen.device_time_s - self._away_s <= _FROZEN_S
        return None if is_lag else make_frozen(moved_mm)

    def _find_apart(
        self, axes: dict[str, float], stated: _Vector, place_mm: _Vector, now_s: float
    ) -> Fault | None:
        self._recent.append((now_s, stated))
        while len(self._recent) > 2 and self._recent[1][0] < now_s - _LAG_S:
            self._recent.popleft()
        steps = np.diff([place for _, place in self._recent], axis=0)
        recent_mm = float(np.linalg.norm(steps, axis=1).sum())
        turned = tuple(round(axes.get(a.name, 0.0)) for a in self._machine.rotary_axes)
        if self._from is None or turned != self._turned:
            self._from, self._turned = (stated, place_mm, recent_mm), turned
        return self._compare(stated, place_mm, recent_mm)

    def _compare(
        self, stated: _Vector, place_mm: _Vector, recent_mm: float
    ) -> Fault | None:
        if self._from is None:
            return None
        first, first_mm, before_mm = self._from
        by_axes = float(np.linalg.norm(stated - first))
        by_tracker = float(np.linalg.norm(place_mm - first_mm))
        slack_mm = _APART_MM + 2.0 * (recent_mm + before_mm)
        shorter, longer = sorted((by_axes, by_tracker))
        if longer <= _TIMES * shorter + slack_mm:
            return None
        return make_disagreement_fault(by_tracker, by_axes)
