"""Sums over single lines of a measurement in progress, for tests of changes.

A change that begins at some line, or grows with time, has constant columns times a
factor for each line. So the sums of each line are kept separate: with them, any course
over the lines is tested without returning to the cells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.estimation.checks.lack_of_fit_blocks import count_untimed, weigh
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.information import Information, add_information
from truepath.estimation.problem.noise import assume_typical_noise
from truepath.kinematics.effects.backlash import make_half_width
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.machine.machine import Machine

_POSE = 6
_M_PER_MM = 1e-3


@dataclass(frozen=True, slots=True)
class WatchedColumns:
    """What may change: pose of the set-up, growth and lost motion of axes.

    Order of the columns: six of the pose, one in mm/m a linear axis, half the lost
    motion of each axis, the range offset.
    """

    machine: Machine

    @property
    def pose(self) -> slice:
        """Three shifts, three turns."""
        return slice(0, _POSE)

    @property
    def growth(self) -> slice:
        """One column for each linear axis, mm/m."""
        return slice(_POSE, _POSE + len(self.machine.linear_axes))

    def lost_motion(self, axis: int) -> slice:
        """Column of one axis, by its number; half the width, mm."""
        begin = self.growth.stop + axis
        return slice(begin, begin + 1)

    @property
    def range(self) -> slice:
        """The last column."""
        begin = self.lost_motion(len(self.machine.axes)).start
        return slice(begin, begin + 1)

    def build_extra(self, design: DesignMatrix) -> Float64[np.ndarray, "n 3 e"]:
        """All columns after those of the pose, in the beam frame."""
        at = design.observations.at
        columns = [
            compute_arm(f"E{axis.name}{axis.name}", at)
            * (at.axis_mm(axis.name) - 0.5 * (axis.low + axis.high))[:, None]
            * _M_PER_MM
            for axis in self.machine.linear_axes
        ]
        columns += [
            make_half_width(f"E{axis.name}{axis.name}", axis).jacobian(at)[:, :, 0]
            for axis in self.machine.axes
        ]
        along = np.tile(np.eye(3)[:, :1], (len(at), 1, 1))  # of the beam
        turned = design.frame @ np.stack(columns, axis=2)
        return np.concatenate([turned, along], axis=2)


@dataclass(frozen=True)
class WatchSums:
    """Sums of single lines, and of all that a fit of them needs.

    row, time_s : of each line, its middle on the tracker's clock; cells : number in
        each
    lock : number of beam losses before each
    coupling : of the watched columns with those of the fit; own : with each other
    pulled : with measured minus nominal; gram : of the unweighted columns
    data : on machine and pose; freedom : of its squares, parameters of the fit not
        deducted
    """

    about: Linearisation
    columns: WatchedColumns
    row: tuple[int, ...]
    time_s: Float64[np.ndarray, " l"]
    cells: Float64[np.ndarray, " l"]
    lock: Int64[np.ndarray, " l"]
    coupling: Float64[np.ndarray, "l p c"]
    own: Float64[np.ndarray, "l c c"]
    pulled: Float64[np.ndarray, "l c"]
    gram: Float64[np.ndarray, "l c c"]
    data: Information
    freedom: float

    @staticmethod
    def start(about: Linearisation, seen: Sequence[Observations] = ()) -> WatchSums:
        """Sums of the first lines.

        Slow noise is at least at its typical level: single lines do not determine it.
        """
        columns, p = WatchedColumns(about.machine_model.machine), about.size
        c = columns.range.stop
        empty = WatchSums(
            replace(about, noise=assume_typical_noise(about.noise)),
            columns,
            (),
            np.zeros(0),
            np.zeros(0),
            np.zeros(0, np.int64),
            np.zeros((0, p, c)),
            np.zeros((0, c, c)),
            np.zeros((0, c)),
            np.zeros((0, c, c)),
            Information.of_matrix(np.zeros((p, p))),
            0.0,
        )
        return empty.add(seen)

    def add(self, seen: Sequence[Observations]) -> WatchSums:
        """Sums with further lines or standstills.

        A line on which the beam was lost counts as two.
        """
        lines = [
            self._sum_line(each.select(np.arange(first, last)))
            for each in seen
            for first, last in _cut_at_locks(each)
            if last > first
        ]
        return self if not lines else _join([self, *lines])

    def _sum_line(self, line: Observations) -> WatchSums:
        about, p = self.about, self.about.size
        design = about.build(line)
        extra = self.columns.build_extra(design)
        watched = np.concatenate([design.columns[:, :, p - _POSE :], extra], axis=2)
        fit = np.concatenate([design.rows[:, :, : p + 1], extra], axis=2)
        weighted = weigh(design, design.whiten(about.noise), fit)
        rows = len(line) * 3
        fit, flat = fit.reshape(rows, -1), watched.reshape(rows, -1)
        total = fit[:, : p + 1].T @ weighted.reshape(rows, -1)[:, : p + 1]
        heavy = weighted.reshape(rows, -1)[
            :, np.r_[p - _POSE : p, p + 1 : fit.shape[1]]
        ]
        freedom = 3.0 * len(line) - design.timing.shape[2]
        lock = line.at.recorded and line.at.recorded.lock
        return replace(
            self,
            row=(int(line.row[0]),),
            time_s=np.array([0.5 * (line.at.time_s[0] + line.at.time_s[-1])]),
            cells=np.array([float(len(line))]),
            lock=np.zeros(1, np.int64) if lock is None else lock[-1:],
            coupling=(fit[:, :p].T @ heavy)[None],
            own=(flat.T @ heavy)[None],
            pulled=(fit[:, p] @ heavy)[None],
            gram=(flat.T @ flat)[None],
            data=Information.from_total(total, 0.0),
            freedom=freedom - count_untimed(design, about),
        )


def _cut_at_locks(seen: Observations) -> Iterator[tuple[int, int]]:
    """First cell and one past the last of lines, also cut at beam losses."""
    ends = np.union1d([last for _, last in seen.lines], seen.new_locks)
    return pairwise([0, *ends.astype(np.int64).tolist()])


def _join(parts: Sequence[WatchSums]) -> WatchSums:
    first = parts[0]

    def stack(name: str) -> Float64[np.ndarray, "l ..."]:
        return np.concatenate([getattr(part, name) for part in parts])

    return replace(
        first,
        row=tuple(row for part in parts for row in part.row),
        time_s=stack("time_s"),
        cells=stack("cells"),
        lock=stack("lock"),
        coupling=stack("coupling"),
        own=stack("own"),
        pulled=stack("pulled"),
        gram=stack("gram"),
        data=add_information([part.data for part in parts]),
        freedom=sum(part.freedom for part in parts),
    )
