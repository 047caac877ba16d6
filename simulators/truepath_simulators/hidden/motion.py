"""Past motion of the axes: positions, rates, reversals and lost motion.

Within a piece of a timeline every axis moves in one direction only, so the ends of the
pieces determine its history: nothing has to be sampled, and the result does not depend
on when it is requested.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from truepath_simulators.compensation.correction import Correction
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.timeline import Timeline

_KEPT_PIECES = 4000
_STANDS_MM = 1e-9


@dataclass(frozen=True)
class Motion:
    """A timeline of a machine, and the memory of its axes.

    correction : addition of the controller to the commanded positions
    """

    machine: MachineFile
    timeline: Timeline
    correction: Correction | None = None
    _remembered: dict[object, np.ndarray] = field(default_factory=dict)

    def corrected_positions(self, time_s: np.ndarray) -> np.ndarray:
        """Positions of the axes with the controller's tables, (n, axes)."""
        position = self.timeline.positions(time_s)
        if self.correction is None:
            return position
        return position + self.correction.added(position, self.headings(time_s))

    def headings(self, time_s: np.ndarray) -> np.ndarray:
        """Direction in which each axis moves or last moved, (n, axes).

        1 or −1; 0 for an axis that has not moved yet.
        """
        return self._remember("headings", self._find_headings)[self._piece(time_s)]

    def column(self, axis: str) -> int:
        return self.machine.axis_names.index(axis)

    def position_mm(self, axis: str, time_s: np.ndarray) -> np.ndarray:
        """Commanded position, (n,); deg for a rotary axis."""
        return self.timeline.positions(time_s)[:, self.column(axis)]

    def share(self, axis: str, time_s: np.ndarray) -> np.ndarray:
        """Commanded position within the travel, 0 to 1, (n,)."""
        travel = self.machine.axes[self.column(axis)]
        gone = self.position_mm(axis, time_s) - travel.low
        return gone / (travel.high - travel.low)

    def derivatives(
        self, axis: str, time_s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocity, acceleration and jerk of an axis, (n,) each."""
        piece, column = self._piece(time_s), self.column(axis)
        heading = self.timeline.directions(time_s)[:, column]
        speed = self.timeline.speeds(time_s)
        inwards = speed**2 * self.timeline.curvatures(time_s)[:, column]
        return (
            speed * heading,
            self.timeline.accelerations(time_s) * heading + inwards,
            self.timeline.jerk[piece] * heading,
        )

    def play_mm(
        self, axis: str, half_width_mm: float, time_s: np.ndarray
    ) -> np.ndarray:
        """Output of the play operator, (n,): the part that follows the axis.

        It stays where it is until the axis has crossed the play, whose half is given.
        At first the axis is in the middle of it.
        """
        key = (axis, half_width_mm)
        state = self._remember(key, lambda: self._play(axis, half_width_mm))
        before = state[self._piece(time_s)]
        now = self.position_mm(axis, time_s)
        return np.clip(before, now - half_width_mm, now + half_width_mm)

    def since_reversal_mm(
        self, axis: str, time_s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Travel since an axis last reversed, and its direction since.

        (n,) each; inf and 0 where it has not reversed.
        """
        turns = self._remember((axis, np.inf), lambda: self._find_turns(axis))
        travel, sign = turns[self._piece(time_s)].T
        begin = self.timeline.origin[self._piece(time_s), self.column(axis)]
        return travel + np.abs(self.position_mm(axis, time_s) - begin), sign

    def _remember(self, key: object, find: Callable[[], np.ndarray]) -> np.ndarray:
        if key not in self._remembered:
            self._remembered[key] = find()
        return self._remembered[key]

    def _find_headings(self) -> np.ndarray:
        step = np.diff(self.timeline.origin, axis=0)
        step = np.vstack([step, np.zeros((1, step.shape[1]))])
        sign = np.where(np.abs(step) > _STANDS_MM, np.sign(step), 0.0)
        moved = np.arange(len(sign))[:, None] * (sign != 0.0)
        last = np.maximum.accumulate(moved, axis=0)
        return np.take_along_axis(sign, last, axis=0)

    def _piece(self, time_s: np.ndarray) -> np.ndarray:
        place = np.searchsorted(self.timeline.start_s, time_s, side="right") - 1
        return np.maximum(place, 0)

    def _play(self, axis: str, half_width_mm: float) -> np.ndarray:
        begin = self.timeline.origin[:, self.column(axis)]
        state = np.empty(len(begin))
        state[0] = begin[0]
        for k in range(1, len(begin)):
            low, high = begin[k] - half_width_mm, begin[k] + half_width_mm
            state[k] = min(max(state[k - 1], low), high)
        return state

    def _find_turns(self, axis: str) -> np.ndarray:
        """Travel since the reversal at the begin of each piece, and the sign in it."""
        begin = self.timeline.origin[:, self.column(axis)]
        step = np.append(np.diff(begin), 0.0)
        known = np.zeros((len(begin), 2))
        travel, sign = np.inf, 0.0
        for k, move in enumerate(step):
            heading = float(np.sign(move)) if abs(move) > _STANDS_MM else 0.0
            if heading and sign and heading != sign:
                travel = 0.0
            sign = heading or sign
            known[k] = travel, sign if travel < np.inf else 0.0
            travel += abs(float(move))
        return known


def continue_from(known: Timeline | None, new: Timeline) -> Timeline:
    """New timeline preceded by the known past."""
    if known is None or known.start_s[0] >= new.start_s[0]:
        return new
    past = known.cut(float(new.start_s[0]))
    return past.select(slice(-_KEPT_PIECES, None)).then(new)


class MotionFollower:
    """Past motion of a board: play and friction need it, the board does not keep it.

    remembers : whether any effect needs the past; tables of a direction do
    """

    def __init__(self, machine: MachineFile, *, remembers: bool) -> None:
        self._machine, self._remembers = machine, remembers
        self._correction: Correction | None = None
        self._newest: Timeline | None = None
        self._motion: Motion | None = None

    def follow(self, timeline: Timeline) -> Motion:
        """Motion up to the newest timeline of the board."""
        if self._motion is None or self._newest is not timeline:
            looks_back = self._remembers or self._correction is not None
            known = self._motion.timeline if self._motion and looks_back else None
            so_far = continue_from(known, timeline)
            self._motion = Motion(self._machine, so_far, self._correction)
            self._newest = timeline
        return self._motion

    def correct(self, correction: Correction | None) -> None:
        self._correction = correction
        if self._motion is not None:
            self._motion = replace(self._motion, correction=correction)
