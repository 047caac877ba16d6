"""Steps of a path on the fly: standstill, stream, motion, repeated lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from truepath.measurement.engine.measurement_monitor import MeasurementMonitor
from truepath.measurement.engine.measurement_steps import LastLine, MeasurementSteps
from truepath.measurement.engine.tracker_control import TrackerControl
from truepath.measurement.faults import NO_TIMES, POINTS_ONLY, STAYS_DAMAGED
from truepath.measurement.messages import LinesDamaged, MeasurementOrder
from truepath.motion.configurations import Commanded
from truepath.motion.paths.plan_segments import drive_again, drive_arcs_again
from truepath_drivers.interfaces.arcs import find_reach
from truepath_drivers.interfaces.records import MotionState, MotionStatus, Path

_MOST_REPEATS = 3  # times that lines are driven again: a measurement has to end


class PathSteps(MeasurementSteps):
    """The steps of a measurement on the fly.

    path : in the controller's axes
    """

    def __init__(
        self,
        monitor: MeasurementMonitor,
        tracker: TrackerControl,
        order: MeasurementOrder,
        start: tuple[float, ...],
        path: Path,
    ) -> None:
        super().__init__(monitor, tracker, order, start)
        self._path = path
        self._concluded_row: int | None = None
        self._repeats_left = _MOST_REPEATS

    @property
    def has_repeated(self) -> bool:
        """Whether lines were repeated."""
        return self._repeats_left < _MOST_REPEATS

    def run(self) -> None:
        """Record a path with a standstill of the stream before and after it.

        The controller keeps time; segmentation needs the standstills. The stream
        continues while further parts are loaded and executed.
        """
        if self._tracker.is_polled:
            raise POINTS_ONLY
        if self._tracker.stamps_arrival:
            raise NO_TIMES
        path = self._path
        is_one = len(set(path.target)) == 1 or self._tracker.can_choose
        self.approach(path.position[0], *(path.target[:1] if is_one else ()))
        first, *rest = self._cut(path)
        self.motion.load(first.path)
        self.open_stream()
        self.run_path(first.path)
        self._execute(rest, 0)
        while isinstance(part := self._choose_part(), Path):
            self._execute(self._cut(part), self._progress.first_row)
        self.finish()

    def _cut(self, part: Path) -> list[Stretch]:
        """One stretch per target where the tracker can choose; else the tracker is
        turned by hand while the controller dwells.
        """
        if self._tracker.can_choose:
            return cut_by_target(part)
        return [Stretch(0, part)]

    def _execute(self, stretches: Sequence[Stretch], part_row: int) -> None:
        for stretch in stretches:
            if self._progress.is_cut_short:
                return
            if self._tracker.can_choose:
                self._change_target(*stretch.path.target[:1])
            self.motion.load(stretch.path)
            self._progress.expect(part_row + stretch.row)
            self.run_path(stretch.path)

    def _change_target(self, name: str = "") -> None:
        if name in ("", self._target):
            return
        self.record_for(self.settings.settle_s)
        self._tracker.holds_target(self._target, None)
        while self._target != name:
            self._choose_target(name)
            self.record_for(self.settings.settle_s)
            if not self._tracker.holds_target(name, None):
                self._target = ""
                self.checkpoint()

    def _choose_part(self) -> Commanded | None:
        """Repeats lost lines before a new part. Arcs alone are given up after some
        tries: other lines do not depend on them.
        """
        row, arcs = self._monitor.rows.pop_row(), self._pop_broken_arcs()
        if self.is_concluding or (row is None and not (arcs and self._repeats_left)):
            return self.request_part()
        self._repeats_left -= 1
        if self._repeats_left < 0:
            raise STAYS_DAMAGED
        if row is None:
            return self._repeat_arcs(arcs)
        first = max(min(row, *arcs), 1) if arcs else max(row, 1)
        self._recorder.event("again", f"from row {first + 1} on")
        return self._repeat(first, lambda: drive_again(self._commanded, first))

    def _pop_broken_arcs(self) -> list[int]:
        rows, path = self._monitor.rows.pop_broken_rows(), self._commanded
        if not isinstance(path, Path):
            return []
        return sorted(row for row in rows if row and any(path.arc[row : row + 1]))

    def _repeat_arcs(self, rows: list[int]) -> Commanded | None:
        driven = self._commanded
        assert isinstance(driven, Path)  # noqa: S101 (it has arcs)
        numbers = ", ".join(str(row + 1) for row in rows)
        self._recorder.event("again", f"circles to rows {numbers}")
        return self._repeat(rows[0], lambda: drive_arcs_again(driven, rows))

    def _repeat(self, first: int, make: Callable[[], Commanded]) -> Commanded | None:
        if self._order.grows:
            self._monitor.report(LinesDamaged(first, None))
            return self.request_part()
        again = make()
        self._monitor.report(LinesDamaged(first, again))
        return self._extend(again)

    def run_path(self, path: Path) -> None:
        """Start the loaded path and monitor it to its end."""
        self.checkpoint()
        self._progress.begin(self._progress.first_row)
        self._recorder.event("start", "cycle start")
        self._monitor.expect(path)
        self.motion.start()
        places, rows = find_reach(path)
        around = np.vstack([path.position[-2:], places[rows == len(path) - 1]])
        last = LastLine(len(path) - 1, around.min(axis=0), around.max(axis=0))
        end = path.position[-1]
        self.wait_motion(end, last, lambda now: self._is_line_done(now, path))

    def _is_line_done(self, status: MotionStatus, path: Path) -> bool:
        moving = (
            status.state is MotionState.RUNNING and not self._state.requires_standstill
        )
        if not self.is_concluding or not moving:
            return False
        if self._concluded_row is None:
            self._concluded_row = status.line
        row = min(status.line, len(path) - 1)
        self._has_arrived = self._monitor.is_at(path.position[row])
        return self._has_arrived or status.line > self._concluded_row


@dataclass(frozen=True, slots=True)
class Stretch:
    """Rows of one target, starting at `row` of the whole path."""

    row: int
    path: Path


def cut_by_target(path: Path) -> list[Stretch]:
    """Each stretch begins at the row where the one before has ended."""
    name = np.array(path.target or ("",) * len(path))
    changes = (np.flatnonzero(name[1:] != name[:-1]) + 1).tolist()
    bounds = [0, *changes, len(path)]
    stretches: list[Stretch] = []
    for first, end in pairwise(bounds):
        begin = max(first - 1, 0)
        rows = slice(begin, end)
        part = replace(
            path,
            position=path.position[rows],
            feed_mm_min=path.feed_mm_min[rows],
            dwell_s=path.dwell_s[rows],
            target=path.target[first:end][:1] * (end - begin),
            arc=path.arc[rows],
        )
        stretches.append(Stretch(begin, part))
    return stretches
