"""Output of alignment, input of estimation: one row a cell, no samples any more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.alignment.observations.reduction import CELL_S, beam_frame
from truepath.alignment.stream.left_out import LeftOut
from truepath.kinematics.conditions import Conditions
from truepath.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class Pass:
    """One uninterrupted motion along one line of the path.

    row : row of the path that the machine moved towards
    first, last : indices of its samples at constant feed in the Run; equal where the
        line is too short for its feed
    speed_mm_s : as measured; the mean along the line where it is a curve
    share : of the line done at the middle of its time
    ramps : first and last of the samples before and after, on its ramps
    """

    row: int
    first: int
    last: int
    speed_mm_s: float
    share: float
    ramps: tuple[tuple[int, int], ...] = ()

    @property
    def is_steady(self) -> bool:
        return self.last > self.first

    def shift(self, index: Callable[[int], int]) -> Pass:
        """Renumbers the samples by `index`, also of the ramps."""

        def part(first: int, last: int) -> tuple[int, int]:
            return (index(first), index(last - 1) + 1) if last > first else (0, 0)

        first, last = part(self.first, self.last)
        ramps = tuple(part(*ramp) for ramp in self.ramps)
        return replace(self, first=first, last=last, ramps=ramps)


@dataclass(frozen=True, slots=True)
class ArcDrive:
    """One uninterrupted motion along an arc, from standstill to standstill.

    row : of the path; first, last : indices of its samples in the Run
    """

    row: int
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Driving:
    """Executed part of a path, and its timing.

    first, last, rows : rows of the path that the stream shows, also together with other
        Runs of it, and how many there are
    feed : measured over commanded feed on each line where they differ, by row
    holds : row, begin and duration in s of standstills in the middle of a line
    clock : ratio of times on the tracker's clock to commanded ones for lines and
        standstills alike; 1 where it is not determined
    gaps_s : times from sample to sample between which samples are missing
    missing : number of samples that are
    """

    first: int
    last: int
    rows: int
    feed: dict[int, float]
    holds: tuple[tuple[int, float, float], ...]
    clock: float = 1.0
    gaps_s: tuple[float, ...] = ()
    missing: int = 0

    @property
    def is_complete(self) -> bool:
        return self.first <= 1 and self.last >= self.rows - 1


@dataclass(frozen=True, slots=True)
class Observations:
    """Means of cells along lines, or of parts of standstills.

    at : conditions of the cells; `line` counts passes, -1 at a standstill
    tracker_mm : (n, 3) mean point in the tracker's frame
    count : (n,) samples in the mean
    direction : (n, 3) unit direction of travel, 0 at a standstill
    row : (n,) row of the commanded path or points
    scatter : (2,) standard deviation of samples about their cell along and across the
        beam, in units of the tracker's specified noise; NaN for single shots
    pose : rough pose, workpiece to tracker; estimation refines it
    used, offered : samples that went into cells, samples of the stream
    left_out : valid samples that were not used, and why
    ramp : (n,) cells on ramps: their position on the line is the measured one, so only
        their deviation across it counts; None if there are none
    driving : executed part of the path; None for points
    arcs : in no cells
    """

    at: Conditions
    tracker_mm: Float64[np.ndarray, "n 3"]
    count: Float64[np.ndarray, " n"]
    direction: Float64[np.ndarray, "n 3"]
    row: Int64[np.ndarray, " n"]
    scatter: Float64[np.ndarray, "2"]
    pose: RigidTransform
    passes: tuple[Pass, ...]
    used: int
    offered: int
    left_out: tuple[LeftOut, ...] = ()
    ramp: Bool[np.ndarray, " n"] | None = None
    driving: Driving | None = None
    arcs: tuple[ArcDrive, ...] = ()

    def __len__(self) -> int:
        return len(self.tracker_mm)

    @property
    def lines(self) -> list[tuple[int, int]]:
        """First cell and one past the last of each line or standstill."""
        new = (np.diff(self.at.line) != 0) | (np.diff(self.row) != 0)
        begin = np.flatnonzero(np.concatenate([[True], new]))
        end = np.append(begin[1:], len(self))
        return list(zip(begin.tolist(), end.tolist(), strict=True))

    @property
    def measured_rows(self) -> frozenset[int]:
        on_line = self.at.line >= 0
        return frozenset((self.row[on_line] if on_line.any() else self.row).tolist())

    @property
    def stretches(self) -> list[tuple[int, int]]:
        """First cell and one past the last of lines and standstills.

        Split at ramps and at new locks of the beam.
        """
        changes = 1 + np.flatnonzero(np.diff(self.is_ramp))
        changes = np.union1d(changes, self.new_locks)
        ends = np.union1d([last for _, last in self.lines], changes)
        return list(pairwise([0, *ends.astype(np.int64).tolist()]))

    @property
    def new_locks(self) -> Int64[np.ndarray, " m"]:
        """The first cells after the beam was lost and found again."""
        recorded = self.at.recorded
        if recorded is None or recorded.lock is None:
            return np.zeros(0, np.int64)
        return 1 + np.flatnonzero(np.diff(recorded.lock))

    @property
    def is_ramp(self) -> Bool[np.ndarray, " n"]:
        return np.zeros(len(self), bool) if self.ramp is None else self.ramp

    @property
    def beam_frame(self) -> Float64[np.ndarray, "n 3 3"]:
        """Rows: unit beam, azimuth, elevation at each cell, in the tracker's frame."""
        return beam_frame(self.tracker_mm)

    def select(self, cells: Int64[np.ndarray, " m"]) -> Observations:
        """`used` and `offered` stay those of all cells."""
        return replace(
            self,
            at=self.at.select(cells),
            tracker_mm=self.tracker_mm[cells],
            count=self.count[cells],
            direction=self.direction[cells],
            row=self.row[cells],
            ramp=None if self.ramp is None else self.ramp[cells],
        )

    def exclude_ramps(self) -> Observations:
        return self.select(np.flatnonzero(~self.is_ramp))

    def join(self, starts: Int64[np.ndarray, " m"]) -> Observations:
        """Means of neighbours on straight lines, from each start to the next."""
        means = CellMeans(self.count, starts)
        return replace(
            self.select(starts),
            at=_merge_conditions(self.at, means),
            tracker_mm=means.of(self.tracker_mm),
            count=means.count,
        )

    def merge_cells(self, longest_mm: Mapping[str, float]) -> Observations:
        """Neighbouring cells of a line merged.

        longest_mm : by linear axis, largest motion within a cell. Standstills, and
            lines on which a rotary axis turns, stay as they are.
        """
        names = self.at.machine.axis_names
        longest = np.array([longest_mm.get(name, 0.0) for name in names])
        starts: list[Int64[np.ndarray, " m"]] = []
        for first, last in self.stretches:
            parts = -(
                -(last - first) // self._count_to_merge_cells(first, last, longest)
            )
            starts.append(first + np.arange(parts) * (last - first) // parts)
        joined = np.concatenate(starts)
        return self if len(joined) == len(self) else self.join(joined)

    def compute_edges(self, joined: Observations) -> Int64[np.ndarray, " e"]:
        """First original cell of each merged cell, and one past the last."""
        ends, joined_ends = np.cumsum(self.count), np.cumsum(joined.count)
        edges = 1 + np.searchsorted(ends, joined_ends - 0.5)  # whole samples
        return np.concatenate([[0], edges])

    def _count_to_merge_cells(
        self, first: int, last: int, longest: Float64[np.ndarray, " a"]
    ) -> int:
        if self.at.line[first] < 0 or last - first < 2:
            return 1
        ends = [first, last - 1]
        moved = np.abs(np.diff(self.at.position_mm[ends], axis=0)[0])
        if (moved[longest == 0.0] > 0.0).any():
            return 1
        share = float(np.linalg.norm(moved[longest > 0.0] / longest[longest > 0.0]))
        span_s = float(np.diff(self.at.time_s[ends])[0])
        return max(1, int((last - 1 - first) / max(share, span_s / CELL_S)))


@dataclass(frozen=True)
class CellMeans:
    """Means over neighbouring cells, weighted by their samples.

    starts : first cell of each mean
    """

    weight: Float64[np.ndarray, " n"]
    starts: Int64[np.ndarray, " m"]

    @property
    def count(self) -> Float64[np.ndarray, " m"]:
        return self.total(self.weight)

    def total(
        self, values: Float64[np.ndarray, "n ..."]
    ) -> Float64[np.ndarray, "m ..."]:
        return np.add.reduceat(values, self.starts, axis=0)

    def of(self, values: Float64[np.ndarray, "n ..."]) -> Float64[np.ndarray, "m ..."]:
        shape = (-1,) + (1,) * (values.ndim - 1)
        total = self.total(values * self.weight.reshape(shape))
        return total / self.count.reshape(shape)


def _merge_conditions(at: Conditions, means: CellMeans) -> Conditions:
    recorded = at.recorded
    firsts = at.select(means.starts)
    if recorded is not None and firsts.recorded is not None:
        celsius = recorded.temperature_degc
        recorded = replace(
            firsts.recorded,
            span_s=means.total(recorded.span_s),
            since_reversal=means.of(recorded.since_reversal),
            tracker_mm=means.of(recorded.tracker_mm),
            temperature_degc=None if celsius is None else means.of(celsius),
        )
    return replace(
        firsts,
        position_mm=means.of(at.position_mm),
        time_s=means.of(at.time_s),
        line_time_s=means.of(at.line_time_s),
        recorded=recorded,
        acceleration=None if at.acceleration is None else means.of(at.acceleration),
    )
