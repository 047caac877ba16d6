"""Progress reports of a measurement: rows done, remaining time, points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truepath.files.bundle.run import PointBlock
from truepath.measurement.messages import (
    BlockRecorded,
    LivePoints,
    MeasurementProgress,
    ReportEvent,
)
from truepath.motion.configurations import Configurations
from truepath.motion.motion_times import row_times_s
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path, TrackerSamples

_TRUST_S = 3.0  # before it the pace so far is too uncertain


@dataclass(frozen=True, slots=True)
class RowSchedule:
    """Planned time of each row, line towards it and dwell included.

    unit : `lines` or `points`
    target : name of the target measured at each row; empty for a single target
    """

    unit: str
    row_s: NDArray[np.float64]
    target: tuple[str, ...] = ()

    @property
    def total(self) -> int:
        """Number of lines or points."""
        return len(self.row_s) - (self.unit == "lines")

    def count_done(self, row: int) -> int:
        """Completed lines or points while the machine moves to a row or is at it."""
        return max(row - (self.unit == "lines"), 0)

    def remaining_s(self, row: int, active_s: float) -> float:
        """Planned time of the remaining rows, scaled by the pace so far."""
        planned_s = float(self.row_s[:row].sum())
        left_s = float(self.row_s[row:].sum())
        if (pace := self._find_pace(row, active_s)) is None:
            return max(left_s - active_s + planned_s, 0.0)
        return left_s * pace

    def line_s(self, row: int, active_s: float) -> float:
        """Duration of the line to a row, or of a point, at the pace so far."""
        return float(self.row_s[row]) * (self._find_pace(row, active_s) or 1.0)

    def _find_pace(self, row: int, active_s: float) -> float | None:
        """Actual over planned time; None early on, when it is only noise."""
        planned_s = float(self.row_s[:row].sum())
        # Later it knows overrides and speed-ups.
        if planned_s < _TRUST_S or active_s <= 0:
            return None
        return active_s / planned_s


def schedule_rows(commanded: Path | Configurations, feed_mm_min: float) -> RowSchedule:
    """For a path, or for points with motions between them at a feed."""
    unit = "lines" if isinstance(commanded, Path) else "points"
    return RowSchedule(unit, row_times_s(commanded, feed_mm_min), commanded.target)


class ProgressEstimator:
    """Position of a measurement on its schedule.

    stage : `preparing`, `measuring`, `closing`
    row : current goal or standstill
    is_cut_short : the rows after it are omitted
    is_row_done : it was completed before that
    first_row : of the part that the controller executes
    """

    def __init__(self, schedule: RowSchedule, period_s: float) -> None:
        self.is_cut_short = self.is_row_done = False
        self.first_row = 0
        self.stage = "preparing"
        self.row = 0
        self._schedule, self._period_s = schedule, period_s
        self._begun_s = self._received_s = host_clock.now_s()
        self._active_s = 0.0
        self._reported_s = -np.inf
        self._is_loaded = False  # a further part, which has not begun

    @property
    def longest_row_s(self) -> float:
        """Planned time of the slowest row known so far."""
        return float(self._schedule.row_s.max(initial=0.0))

    @property
    def target(self) -> str:
        """Name of the target that is measured at the row; empty for a single one."""
        return self._schedule.target[self.row] if self._schedule.target else ""

    @property
    def point(self) -> int | None:
        """The row where points are measured; None on a path."""
        return self.row if self._schedule.unit == "points" else None

    def begin(self, row: int = 0) -> None:
        """Set the row that the machine moves to; the first call starts the clock."""
        if self.stage == "preparing":
            self._begun_s = self._received_s = host_clock.now_s()
            self._active_s = 0.0
        self.stage, self.row, self._is_loaded = "measuring", row, False

    def extend(self, schedule: RowSchedule) -> None:
        """Use a longer schedule, which includes the earlier rows."""
        unit = schedule.unit
        self.first_row = len(self._schedule.row_s) - (unit == "lines")
        self._schedule, self.row, self._is_loaded = schedule, self.first_row, True

    def expect(self, row: int) -> None:
        """Announce a part from this row on: the controller counts its lines from it."""
        self.first_row, self._is_loaded = row, True

    def follow(self, line: int) -> None:
        """Set the line of its part that a controller reports."""
        if self._is_loaded:
            return  # it still reports the end of the part before
        if self._schedule.unit == "lines" and self.stage == "measuring":
            row = line + self.first_row
            self.row = min(max(self.row, row), self._schedule.total)

    def exclude_rest(self, *, is_row_done: bool) -> None:
        """Omit all rows after the current one."""
        self.is_cut_short, self.is_row_done = True, is_row_done

    def end(self) -> None:
        """All rows are done; the next report is due at once."""
        self.stage, self._reported_s = "closing", -np.inf

    def pass_time(self, *, active: bool) -> None:
        """Accumulate time without pauses, the basis of the pace."""
        now_s = host_clock.now_s()
        if active:
            self._active_s += now_s - self._received_s
        self._received_s = now_s

    def next_report(self) -> MeasurementProgress | None:
        """None if the last report is too recent."""
        now_s = host_clock.now_s()
        if now_s - self._reported_s < self._period_s:
            return None
        self._reported_s = now_s
        finished = self.stage == "closing"
        done = self._schedule.count_done(self.row)
        if finished:
            done = (
                done + self.is_row_done if self.is_cut_short else self._schedule.total
            )
        left_s = self._schedule.remaining_s(self.row, self._active_s)
        return MeasurementProgress(
            done=done,
            total=self._schedule.total,
            unit=self._schedule.unit,
            stage=self.stage,
            elapsed_s=round(now_s - self._begun_s, 3),
            remaining_s=0.0 if finished else round(left_s, 3),
            line_s=round(self._schedule.line_s(self.row, self._active_s), 3),
        )


SPACING_S = 0.1


class LiveView:
    """Reports recorded blocks, thinned for display to points some 0.1 s apart.

    reports_blocks : complete blocks are reported as well, for a live estimate
    range_scale : of all reported ranges, where these are corrected for the air
        afterwards
    axes : position of the controller
    environment : newest reading of each working sensor; replaced, never changed
    """

    def __init__(
        self, report: ReportEvent, *, reports_blocks: bool, range_scale: float = 1.0
    ) -> None:
        self._report, self._reports_blocks = report, reports_blocks
        self._range_scale = range_scale
        self._last_slot = -np.inf
        self.axes: tuple[float, ...] = ()
        self.environment: Mapping[str, float] = {}

    def show_readings(self, readings: Mapping[str, float]) -> None:
        """Store present readings; NaN removes a sensor. For any thread."""
        known = {**self.environment, **readings}
        self.environment = {k: v for k, v in known.items() if not math.isnan(v)}

    def show(self, block: TrackerSamples | PointBlock) -> None:
        """Report a block that has been written."""
        samples = block.samples if isinstance(block, PointBlock) else block
        time_s = samples.device_time_s
        slot = np.floor(time_s / SPACING_S)
        valid = samples.status == 0
        _, first = np.unique(slot[valid], return_index=True)
        chosen = np.flatnonzero(valid)[first]
        chosen = chosen[slot[chosen] > self._last_slot]
        if len(chosen):
            self._last_slot = float(slot[chosen[-1]])
            scaled_mm = self._range_scale * samples.position_mm[chosen]
            points = np.round(scaled_mm, 4).tolist()
            self._report(
                LivePoints(points, list(self.axes), float(time_s[-1]), self.environment)
            )
        if self._reports_blocks:
            scaled_mm = self._range_scale * samples.position_mm
            scaled = replace(samples, position_mm=scaled_mm)
            if isinstance(block, PointBlock):
                self._report(BlockRecorded(replace(block, samples=scaled)))
            else:
                self._report(BlockRecorded(scaled))
