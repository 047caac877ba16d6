"""Cells of a Run in progress: of its passes and standstills, or of its polled points.

The same functions as for a whole Run, applied to the samples so far. The first matching
takes at least three standstills that do not lie on one line; from then on the pose
decides which waypoint a standstill is, among the next few in the order of the path.
Polled points name their rows: once a few agree, each is near its row, or off it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.cell_blocks import (
    CellBlock,
    list_as_stops,
    reduce_pass,
    reduce_point,
    reduce_standstills,
    select_measured,
)
from truepath.alignment.observations.observations import Observations, Pass
from truepath.alignment.observations.segmentation import Stream, cut_into_passes
from truepath.alignment.observations.surroundings import concatenate_blocks
from truepath.alignment.stream.cleaning import detect_valid_samples
from truepath.alignment.stream.left_out import LeftOut, describe_unusable
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.alignment.stream.seating import (
    Seating,
    Seats,
    compute_seating,
    seat_targets,
)
from truepath.alignment.stream.sequence import (
    FEWEST_UNMATCHED,
    SKIP,
    TOLERANCE_MM,
    Matching,
    is_wide,
    match_stops,
    seat_points,
)
from truepath.alignment.stream.stops import StopStream, concatenate_stops
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointBlock, PointRows, Run
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.workspace import measure_distances
from truepath.numerics.rigid import RigidTransform, fit_rigid
from truepath_drivers.interfaces.records import TrackerSamples

_FEWEST, _FEWEST_POINTS = 3, 4  # standstills, or points, that fix a pose
_TRIES = 30  # of either, for the first pose, at most
_CONTEXT, _HELD = 3, 2  # samples on either side that cleaning needs
_MOST_KEPT_S = 600.0  # of one line


class _KnownSeats:
    """Seats of targets while measurements come in. One thread.

    place_mm, seated_mm : waypoints with targets as stated, and with targets at their
        seats
    seats : targets that are far off their stated positions, and their shifts; another
        object once another target is known
    """

    def __init__(self) -> None:
        self._settled: frozenset[str] = frozenset()
        self.seats: Seats = {}

    def set_waypoints(
        self, place_mm: Float64[np.ndarray, "w 3"], seating: Seating | None
    ) -> None:
        """Sets the waypoints; `seating` is None where every target is as stated."""
        self.place_mm = self.seated_mm = place_mm
        self.seating = seating

    def refine(
        self, places_mm: Float64[np.ndarray, "k 3"], waypoints: Int64[np.ndarray, " k"]
    ) -> bool:
        """Estimates the seats from all points; True if one more is settled."""
        if self.seating is None:
            return False
        self.seated_mm, found = seat_points(
            places_mm, self.place_mm, waypoints, self.seating
        )
        settled = self.seating.list_settled(waypoints)
        if settled == self._settled:
            return False
        # All again with each target: the estimate is linear in the rest.
        self._settled = settled
        self.seats = {name: found[name] for name in found if name in settled}
        return True

    def is_known(self, waypoint: int) -> bool:
        if self.seating is None:
            return True
        return self.seating.names[self.seating.target[waypoint]] in self._settled

    def compute_reach_mm(self, waypoint: int) -> float:
        """Tolerance for a target whose seat is not settled yet; 0 for others."""
        if self.seating is None or self.is_known(waypoint):
            return 0.0
        return float(self.seating.reach_mm[waypoint])


class _LiveAlignment(ABC):
    """Matches data to the commanded rows while they come in. One thread.

    pose : workpiece to tracker from the data so far, None before the first match
    """

    def __init__(self, machine: Machine, commanded: Commanded) -> None:
        self._run = Run("live", machine, commanded, TrackerSamples.empty())
        self._known = _KnownSeats()
        self._is_over = False
        self.pose: RigidTransform | None = None

    @property
    def seats(self) -> Seats:
        return self._known.seats

    def extend(self, commanded: Commanded) -> None:
        """Further rows; the earlier ones are among them, unchanged."""
        self._run = replace(self._run, commanded=commanded)
        self._set_rows()

    @abstractmethod
    def _set_rows(self) -> None: ...

    def _is_settled(self, waypoint: int) -> bool:
        return self._is_over or self._known.is_known(waypoint)

    def _join(
        self,
        parts: Sequence[CellBlock],
        pose: RigidTransform,
        passes: Sequence[Pass],
        excluded: Sequence[LeftOut],
    ) -> Observations:
        begin_s = min(float(part.cells.time_s[0]) for part in parts)
        end_s = max(float(part.cells.time_s[-1]) for part in parts)
        excluded = [x for x in excluded if begin_s <= x.begin_s <= end_s]
        return concatenate_blocks(
            self._run, list(parts), pose, tuple(passes), self.seats, excluded
        )


class StreamingAlignment(_LiveAlignment):
    """Matches the stream of a tracker to the commanded rows."""

    def __init__(self, machine: Machine, commanded: Commanded) -> None:
        super().__init__(machine, commanded)
        self._matched: list[tuple[int, int]] = []  # standstill and its waypoint
        self._set_rows()
        self._raw = TrackerSamples.empty()
        self._stream = StopStream(self._nominal.slowest_mm_s, machine.tracker.rate_hz)
        self._examined = 0  # standstills
        self._begun_s: list[float] = []  # of each of these
        self._unmatched: list[tuple[int, float]] = []  # the newest, and how far off
        self._earlier_unmatched: list[LeftOut] = []
        self._delivered = 0  # matched standstills up to which all cells are delivered
        self._passes: list[Pass] = []
        self._unusable: list[LeftOut] = []

    def locate_rows(
        self, since_s: float = -np.inf
    ) -> Float64[np.ndarray, "w 3"] | None:
        """Expected position of each row in the tracker's frame, for straight lines.

        From the standstills that have begun since `since_s`. None where they do not
        determine a pose, where lines bend, and where targets are exchanged: their seats
        are known at the end only.
        """
        is_polygon = not self._nominal.bends and not self._nominal.arcs
        if self.pose is None or self._known.seating or not is_polygon:
            return None
        since = [(k, w) for k, w in self._matched if self._begun_s[k] > since_s]
        nominal = self._place_mm[[w for _, w in since]]
        if len(since) < _FEWEST or not is_wide(nominal, self._place_mm):
            return None
        places = np.array([self._stream.stops[k].position_mm for k, _ in since])
        return fit_rigid(nominal, places).apply(self._nominal.end_mm)

    def list_unmatched(self) -> tuple[LeftOut, ...]:
        """Periods in which no standstill was at a point of the path."""
        now = self._describe_unmatched()
        return (*self._earlier_unmatched, *((now,) if now else ()))

    def _describe_unmatched(self) -> LeftOut | None:
        if len(self._unmatched) < FEWEST_UNMATCHED:
            return None
        first, last = (self._stream.stops[self._unmatched[k][0]] for k in (0, -1))
        return LeftOut(
            "astray",
            int(self._nominal.first[self._matched[-1][1] + 1]),
            self._begun_s[self._unmatched[0][0]],
            self._begun_s[self._unmatched[-1][0]],
            last.last - first.first,
            max(off_mm for _, off_mm in self._unmatched),
        )

    @property
    def samples_kept(self) -> int:
        return self._stream.kept

    def _set_rows(self) -> None:
        machine, commanded = self._run.machine, self._run.commanded
        self._nominal = compute_nominal_path(machine, commanded)
        self._place_mm = self._nominal.place_mm
        seating = compute_seating(machine, commanded, self._nominal.first)
        self._known.set_waypoints(self._place_mm, seating)
        if self._matched and seating:
            self._refine_pose()
        self._seat_path()

    def add(self, block: TrackerSamples) -> list[CellBlock]:
        """Cells of the passes and standstills that these samples finish."""
        raw = TrackerSamples.join([self._raw, block])
        valid = detect_valid_samples(raw)
        old = min(_CONTEXT + _HELD, len(self._raw)) - _HELD
        fresh = np.zeros(len(raw), bool)
        fresh[max(old, 0) : len(raw) - _HELD] = True
        self._unusable += describe_unusable(raw, valid | ~fresh)
        self._raw = raw.select(slice(max(len(raw) - _CONTEXT - _HELD, 0), None))
        return self._add_valid(raw, np.flatnonzero(fresh & valid))

    def finish(self) -> list[CellBlock]:
        """End of data: the cells that were waiting for more."""
        held = np.arange(max(len(self._raw) - _HELD, 0), len(self._raw))
        valid = detect_valid_samples(self._raw)
        found = self._add_valid(self._raw, held[valid[held]])
        self._stream.end()
        self._is_over = True
        found += self._recognise()
        if self._matched:
            found += self._reduce_between(self._matched[-1], self._matched[-1])
        return found

    def observations(self, parts: Sequence[CellBlock]) -> Observations:
        """Cells as one block, about the present pose.

        `first` and `last` of its passes count valid samples.
        """
        if self.pose is None:
            raise AlignmentError("the standstills so far do not tell the pose")
        return self._join(parts, self.pose, self._passes, self._unusable)

    def _add_valid(self, raw: TrackerSamples, rows: np.ndarray) -> list[CellBlock]:
        self._stream.add(raw.device_time_s[rows], raw.position_mm[rows])
        found = self._recognise()
        self._discard_old()
        return found

    def _recognise(self) -> list[CellBlock]:
        stops = self._stream.stops
        for index in range(self._examined, len(stops)):
            self._examined = index + 1
            first = stops[index].first
            self._begun_s.append(float(self._stream.part(first, first + 1)[0][0]))
            if self.pose is None:
                self._match_first()
            else:
                self._match_by_position(index)
        found: list[CellBlock] = []
        while self._delivered + 1 < len(self._matched):
            here, there = self._matched[self._delivered :][:2]
            if not self._is_settled(there[1]):
                break
            found += self._reduce_between(here, there)
            self._delivered += 1
        return found

    def _match_first(self) -> None:
        stops = self._stream.stops
        if not _FEWEST <= len(stops) <= _TRIES:
            return
        first = slice(len(stops) + _TRIES)
        nominal_mm = self._place_mm[first]
        seating = self._known.seating
        seating = seating.select(first) if seating else None
        names = "path.csv" if self._run.mode == "otf" else "points.csv"
        try:
            found = match_stops(
                concatenate_stops(stops, 0),
                nominal_mm,
                ordered_by=names,
                seating=seating,
            )
        except AlignmentError:
            return  # too few so far, or another path: the batch decides
        if is_wide(nominal_mm[found.waypoint], self._place_mm):
            pairs = zip(found.stop.tolist(), found.waypoint.tolist(), strict=True)
            self._matched, self.pose = list(pairs), found.pose
            self._refine_pose()

    def _match_by_position(self, index: int) -> None:
        assert self.pose is not None  # noqa: S101 (the caller has asked)
        latest, waypoint = self._matched[-1]
        if index <= latest:
            return
        begin = waypoint + 1
        ahead = slice(begin, begin + SKIP + 1)
        place = self._stream.stops[index].position_mm
        off = np.linalg.norm(
            self.pose.apply(self._known.seated_mm[ahead]) - place, axis=1
        )
        near = np.flatnonzero(off < TOLERANCE_MM + self._compute_reach_mm(ahead))
        if len(near):
            if (was := self._describe_unmatched()) is not None:
                self._earlier_unmatched.append(was)
            self._unmatched.clear()
            self._matched.append((index, begin + int(near[0])))
            self._refine_pose()
        elif begin < len(self._place_mm):
            self._record_unmatched(index, begin)

    def _record_unmatched(self, index: int, begin: int) -> None:
        assert self.pose is not None  # noqa: S101 (the caller has asked)
        place = self.pose.invert().apply(self._stream.stops[index].position_mm)
        away_mm = np.linalg.norm(self._known.seated_mm[begin:] - place, axis=1)
        last = min(begin + SKIP, len(self._place_mm) - 1)
        rows = slice(self._nominal.first[begin], self._nominal.first[last] + 1)
        lines = self._nominal.begin_mm[rows], self._nominal.end_mm[rows]
        beside_mm, _ = measure_distances(place, *lines)
        reach_mm = self._compute_reach_mm(slice(begin, last + 1)).max()
        if min(away_mm.min(), beside_mm.min()) > TOLERANCE_MM + reach_mm:
            self._unmatched.append((index, float(away_mm.min())))

    def _compute_reach_mm(self, places: slice) -> Float64[np.ndarray, " n"]:
        ahead = range(*places.indices(len(self._place_mm)))
        if self._is_over or self._known.seating is None:
            return np.zeros(len(ahead))
        return np.array([self._known.compute_reach_mm(waypoint) for waypoint in ahead])

    def _refine_pose(self) -> None:
        waypoints = np.array([w for _, w in self._matched])
        stops = [self._stream.stops[k] for k, _ in self._matched]
        places = np.array([stop.position_mm for stop in stops])
        if self._known.refine(places, waypoints):
            self._seat_path()
        self.pose = fit_rigid(self._known.seated_mm[waypoints], places)

    def _seat_path(self) -> None:
        if self.seats:
            self._nominal = compute_nominal_path(
                seat_targets(self._run.machine, self.seats),
                self._run.commanded,
                self._nominal.first,
            )

    def _reduce_between(
        self, here: tuple[int, int], there: tuple[int, int]
    ) -> list[CellBlock]:
        assert self.pose is not None  # noqa: S101 (they are matched)
        stops = self._stream.stops[here[0] : there[0] + 1]
        origin = stops[0].first
        if origin < self._stream.begin:
            return []  # waited for too long
        time_s, point_mm = self._stream.part(origin, stops[-1].last)
        stream = Stream(time_s, point_mm, self.pose)
        ends = np.array([0, len(stops) - 1]), np.array([here[1], there[1]])
        matching = Matching(*ends, self.pose)
        block = concatenate_stops(stops, origin)
        first = Matching(ends[0][:1], ends[1][:1], self.pose)
        found = reduce_standstills(self._run, block, first, stream, self._nominal)
        if self._run.mode == "standstill":
            return found
        seen_mm = self.pose.invert().apply(block.position_mm[ends[0]])
        nominal = self._nominal.shift_through(ends[1], seen_mm)
        for each in cut_into_passes(stream, block, matching, nominal):
            line, curve = len(self._passes), nominal.curve(each.row)
            found += reduce_pass(self._run, line, each, stream, curve)
            self._passes.append(each.shift(lambda k: k + origin))
        return found

    def _discard_old(self) -> None:
        stops = self._stream.stops
        if self.pose is not None:
            self._stream.discard_before(stops[self._matched[self._delivered][0]].first)
        most = int(_MOST_KEPT_S * self._run.machine.tracker.rate_hz)
        if self._stream.kept > most:
            self._stream.discard_before(len(self._stream) - most // 2)


class PointAlignment(_LiveAlignment):
    """Compares measured points with the rows that they name."""

    def __init__(self, machine: Machine, commanded: Commanded) -> None:
        super().__init__(machine, commanded)
        nothing = np.zeros(0, int)
        self._points = PointRows(nothing, nothing, np.zeros((0, 3, 3)))
        self._near: list[int] = []  # points near their rows
        self._waiting: list[int] = []  # of these, with targets' seats not settled
        self._unmatched: list[LeftOut] = []
        self._reach_mm = TOLERANCE_MM
        self._set_rows()

    def list_unmatched(self) -> tuple[LeftOut, ...]:
        """Points off their rows since the last good one, as one; none below three.

        Those before it are reported with the observations.
        """
        if len(self._unmatched) < FEWEST_UNMATCHED or not self._near:
            return ()
        known_s = self._run.tracker.device_time_s[self._near[-1]]
        since = [x for x in self._unmatched if x.begin_s > known_s]
        if len(since) < FEWEST_UNMATCHED:
            return ()
        whole = replace(
            since[0],
            end_s=since[-1].end_s,
            samples=sum(each.samples for each in since),
            off_mm=max(each.off_mm for each in since),
        )
        return (whole,)

    def _set_rows(self) -> None:
        machine, commanded = self._run.machine, self._run.commanded
        nominal = compute_nominal_path(machine, commanded)
        self._first = nominal.first
        self._place_mm = nominal.place_mm
        seating = compute_seating(machine, commanded, nominal.first)
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
            new = select_measured(tracker)
            self._sort_by_position(new[new >= before])
        return self._deliver()

    def finish(self) -> list[CellBlock]:
        """End of data: the cells that were waiting for a target's seat."""
        self._is_over = True
        return self._deliver()

    def observations(self, parts: Sequence[CellBlock]) -> Observations:
        if self.pose is None:
            raise AlignmentError("the points so far do not tell the pose")
        return self._join(parts, self.pose, (), self._unmatched)

    def _match_first(self) -> None:
        measured = select_measured(self._run.tracker)
        if not _FEWEST_POINTS <= len(measured) <= _TRIES:
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
        if len(same) >= _FEWEST_POINTS and is_wide(
            self._place_mm[waypoints[same]], self._place_mm
        ):
            self.pose, self._reach_mm = found.pose, found.reach_mm
            self._sort_by_position(measured)

    def _sort_by_position(self, measured: Int64[np.ndarray, " m"]) -> None:
        for sample in measured.tolist():
            assert self.pose is not None  # noqa: S101 (the callers have asked)
            (waypoint,) = self._waypoints_of(np.array([sample]))
            expected_mm = self.pose.apply(self._known.seated_mm[[waypoint]])[0]
            place_mm = self._run.tracker.position_mm[sample]
            off_mm = float(np.linalg.norm(place_mm - expected_mm))
            if off_mm > self._reach_mm + self._known.compute_reach_mm(int(waypoint)):
                row, count = self._points.row[sample], self._points.count[sample]
                time_s = float(self._run.tracker.device_time_s[sample])
                self._unmatched.append(
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
        if len(near) >= _FEWEST_POINTS:
            self.pose = fit_rigid(self._known.seated_mm[waypoints], places)

    def _deliver(self) -> list[CellBlock]:
        waypoints = self._waypoints_of(np.array(self._waiting, np.int64)).tolist()
        waiting = list(zip(self._waiting, waypoints, strict=True))
        ready = [sample for sample, at in waiting if self._is_settled(at)]
        self._waiting = [sample for sample, at in waiting if not self._is_settled(at)]
        return [reduce_point(self._run, self._points, sample) for sample in ready]

    def _points_of(self, samples: Int64[np.ndarray, " k"]) -> np.ndarray:
        return self._run.tracker.position_mm[samples]

    def _waypoints_of(self, samples: Int64[np.ndarray, " k"]) -> np.ndarray:
        rows = self._points.row[samples]
        return np.searchsorted(self._first, rows, side="right") - 1
