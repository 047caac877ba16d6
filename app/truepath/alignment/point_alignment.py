"""Points of a polled tracker, one by one during the measurement.

Each names its commanded row. Once a few agree the pose is known; from then on a point
is near its row, or off it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from truepath.alignment.observations.cell_blocks import CellBlock
from truepath.alignment.observations.cell_observations import join_blocks
from truepath.alignment.observations.known_seats import KnownSeats
from truepath.alignment.observations.measured_points import (
    find_measured,
    list_as_stops,
    reduce_point,
)
from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.left_out import LeftOut
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.alignment.stream.seating import Seats, find_seating
from truepath.alignment.stream.sequence import (
    TOLERANCE_MM,
    is_wide,
    match_stops,
)
from truepath.alignment.stream.stop_chains import FEWEST_ASTRAY
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointBlock, PointRows, Run
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations
from truepath.numerics.rigid import RigidTransform, fit_rigid
from truepath_drivers.interfaces.records import Path, TrackerSamples

_FEWEST, _TRIES = 4, 30  # points for the first pose: at least, at most


class PointAlignment:
    """Compares measured points with their rows while they come in. One thread.

    pose : workpiece to tracker from the points so far, None before it is known
    """

    def __init__(self, machine: Machine, commanded: Path | Configurations) -> None:
        nothing = PointRows(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3, 3)))
        self._run = Run("live", machine, commanded, TrackerSamples.empty())
        self._points = nothing
        self._near: list[int] = []  # points near their rows
        self._waiting: list[int] = []  # of these, with targets' seats not settled
        self._astray: list[LeftOut] = []
        self._known = KnownSeats()
        self._reach_mm = TOLERANCE_MM
        self._is_over = False
        self.pose: RigidTransform | None = None
        self._know_rows()

    @property
    def seats(self) -> Seats:
        """Targets far off their stated positions, and their shifts, as known so far."""
        return self._known.seats

    def list_unmatched(self) -> tuple[LeftOut, ...]:
        """Points off their rows since the last good one, as one; none below three.

        Those before it are reported with the observations.
        """
        if len(self._astray) < FEWEST_ASTRAY or not self._near:
            return ()
        known_s = self._run.tracker.device_time_s[self._near[-1]]
        since = [x for x in self._astray if x.begin_s > known_s]
        if len(since) < FEWEST_ASTRAY:
            return ()
        whole = replace(
            since[0],
            end_s=since[-1].end_s,
            samples=sum(each.samples for each in since),
            off_mm=max(each.off_mm for each in since),
        )
        return (whole,)

    def extend(self, commanded: Path | Configurations) -> None:
        """Further rows; the earlier ones are among them, unchanged."""
        self._run = replace(self._run, commanded=commanded)
        self._know_rows()

    def _know_rows(self) -> None:
        machine, commanded = self._run.machine, self._run.commanded
        nominal = compute_nominal_path(machine, commanded)
        self._first = nominal.first
        self._place_mm = nominal.place_mm
        seating = find_seating(machine, commanded, nominal.first)
        self._known.set_waypoints(nominal.place_mm, seating)
        if self._near:
            self._refine_pose()

    def add(self, block: PointBlock) -> list[CellBlock]:
        """Cells of points near their rows, once the target's seat is settled."""
        before = len(self._run.tracker)
        tracker = TrackerSamples.join([self._run.tracker, block.samples])
        self._run = replace(self._run, tracker=tracker)
        self._points = PointRows.join([self._points, block.points])
        if self.pose is None:
            self._match_first()
        else:
            new = find_measured(tracker)
            self._sort_by_place(new[new >= before])
        return self._deliver()

    def finish(self) -> list[CellBlock]:
        """End of data: the cells that were waiting for a target's seat."""
        self._is_over = True
        return self._deliver()

    def observations(self, parts: Sequence[CellBlock]) -> Observations:
        """Points as one block, about the present pose."""
        if self.pose is None:
            raise AlignmentError("the points so far do not tell the pose")
        begin_s = min(float(part.cells.time_s[0]) for part in parts)
        end_s = max(float(part.cells.time_s[-1]) for part in parts)
        said = [x for x in self._astray if begin_s <= x.begin_s <= end_s]
        return join_blocks(self._run, list(parts), self.pose, (), self.seats, said)

    def _match_first(self) -> None:
        measured = find_measured(self._run.tracker)
        if not _FEWEST <= len(measured) <= _TRIES:
            return
        places, waypoints = self._points_of(measured), self._waypoints_of(measured)
        seating = self._known.seating
        seating = seating.select(waypoints) if seating else None
        try:
            found = match_stops(
                list_as_stops(places),
                self._place_mm[waypoints],
                ordered_by="points.csv",
                seating=seating,
            )
        except AlignmentError:
            return  # too few so far: more points may suffice
        same = found.stop[found.stop == found.waypoint]
        if len(same) >= _FEWEST and is_wide(
            self._place_mm[waypoints[same]], self._place_mm
        ):
            self.pose, self._reach_mm = found.pose, found.reach_mm
            self._sort_by_place(measured)

    def _sort_by_place(self, measured: Int64[np.ndarray, " m"]) -> None:
        for sample in measured.tolist():
            assert self.pose is not None  # noqa: S101 (the callers have asked)
            (waypoint,) = self._waypoints_of(np.array([sample]))
            expected_mm = self.pose.apply(self._known.seated_mm[[waypoint]])[0]
            place_mm = self._run.tracker.position_mm[sample]
            off_mm = float(np.linalg.norm(place_mm - expected_mm))
            if off_mm > self._compute_reach_mm(int(waypoint)):
                row, count = self._points.row[sample], self._points.count[sample]
                time_s = float(self._run.tracker.device_time_s[sample])
                self._astray.append(
                    LeftOut("astray", int(row), time_s, time_s, int(count), off_mm)
                )
                continue
            self._near.append(sample)
            self._waiting.append(sample)
            self._refine_pose()

    def _refine_pose(self) -> None:
        near = np.array(self._near)
        places, waypoints = self._points_of(near), self._waypoints_of(near)
        self._known.refine(places, waypoints)
        if len(near) >= _FEWEST:
            self.pose = fit_rigid(self._known.seated_mm[waypoints], places)

    def _deliver(self) -> list[CellBlock]:
        ready = [s for s in self._waiting if self._is_settled(s)]
        self._waiting = [s for s in self._waiting if s not in ready]
        return [reduce_point(self._run, self._points, sample) for sample in ready]

    def _is_settled(self, sample: int) -> bool:
        (waypoint,) = self._waypoints_of(np.array([sample]))
        return self._is_over or self._known.is_known(int(waypoint))

    def _compute_reach_mm(self, waypoint: int) -> float:
        return self._reach_mm + self._known.compute_reach_mm(waypoint)

    def _points_of(self, samples: Int64[np.ndarray, " k"]) -> np.ndarray:
        return self._run.tracker.position_mm[samples]

    def _waypoints_of(self, samples: Int64[np.ndarray, " k"]) -> np.ndarray:
        rows = self._points.row[samples]
        return np.searchsorted(self._first, rows, side="right") - 1
