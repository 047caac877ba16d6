"""Finished passes and standstills of a Run in progress, one by one.

The same functions as for a whole Run, applied to the samples so far. The first matching
takes at least three standstills that do not lie on one line; from then on the pose
decides which waypoint a standstill is, among the next few in the order of the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.cell_blocks import (
    CellBlock,
    reduce_pass,
    reduce_standstills,
)
from truepath.alignment.observations.cell_observations import join_blocks
from truepath.alignment.observations.known_seats import KnownSeats
from truepath.alignment.observations.observations import Observations, Pass
from truepath.alignment.observations.segmentation import Stream, cut_into_passes
from truepath.alignment.stream.cleaning import find_valid_samples
from truepath.alignment.stream.left_out import LeftOut, describe_unusable
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.alignment.stream.seating import Seats, find_seating, seat_targets
from truepath.alignment.stream.sequence import (
    TOLERANCE_MM,
    Matching,
    is_wide,
    match_stops,
)
from truepath.alignment.stream.stop_chains import FEWEST_ASTRAY, SKIP
from truepath.alignment.stream.stops import StopStream, join_stops
from truepath.errors import AlignmentError
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations
from truepath.motion.workspace import measure_distances
from truepath.numerics.rigid import RigidTransform, fit_rigid
from truepath_drivers.interfaces.records import Path, TrackerSamples

_CONTEXT, _HELD = 3, 2  # samples on either side that cleaning needs
_FEWEST = 3  # standstills that fix a pose
_TRIES = 30  # standstills for the first matching, at most
_MOST_KEPT_S = 600.0  # of one line


class StreamingAlignment:
    """Matches the stream to the commanded rows while samples come in. One thread.

    pose : workpiece to tracker from the standstills so far, None before the first match
    """

    def __init__(self, machine: Machine, commanded: Path | Configurations) -> None:
        self._run = Run("live", machine, commanded, TrackerSamples.empty())
        self._known = KnownSeats()
        self._matched: list[tuple[int, int]] = []  # standstill and its waypoint
        self._know_rows()
        self._raw = TrackerSamples.empty()
        self._stream = StopStream(self._nominal.slowest_mm_s, machine.tracker.rate_hz)
        self._looked_at = 0  # standstills
        self._begun_s: list[float] = []  # of each of these
        self._astray: list[tuple[int, float]] = []  # the newest, and how far off
        self._was_astray: list[LeftOut] = []
        self._delivered = 0  # matched standstills up to which all cells are delivered
        self._passes: list[Pass] = []
        self._is_over = False
        self._unusable: list[LeftOut] = []
        self.pose: RigidTransform | None = None

    @property
    def seats(self) -> Seats:
        """Targets far off their stated positions, and their shifts, as known so far."""
        return self._known.seats

    def locate_rows(
        self, since_s: float = -np.inf
    ) -> Float64[np.ndarray, "w 3"] | None:
        """Expected position of each row in the tracker's frame, for straight lines.

        From the standstills that have begun since `since_s`. None where they do not
        determine a pose, where lines bend, and where targets are exchanged: their seats
        are known at the end only.
        """
        if self.pose is None or self._known.seating or not self._nominal.is_polygon:
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
        return (*self._was_astray, *((now,) if now else ()))

    def _describe_unmatched(self) -> LeftOut | None:
        if len(self._astray) < FEWEST_ASTRAY:
            return None
        first, last = (self._stream.stops[self._astray[k][0]] for k in (0, -1))
        return LeftOut(
            "astray",
            int(self._nominal.first[self._matched[-1][1] + 1]),
            self._begun_s[self._astray[0][0]],
            self._begun_s[self._astray[-1][0]],
            last.last - first.first,
            max(off_mm for _, off_mm in self._astray),
        )

    @property
    def samples_kept(self) -> int:
        """Number of samples kept for later."""
        return self._stream.kept

    def extend(self, commanded: Path | Configurations) -> None:
        """Further rows; the earlier ones are among them, unchanged."""
        self._run = replace(self._run, commanded=commanded)
        self._know_rows()

    def _know_rows(self) -> None:
        machine, commanded = self._run.machine, self._run.commanded
        self._nominal = compute_nominal_path(machine, commanded)
        self._place_mm = self._nominal.place_mm
        seating = find_seating(machine, commanded, self._nominal.first)
        self._known.set_waypoints(self._place_mm, seating)
        if self._matched and seating:
            self._refine_pose()
        self._seat_path()

    def add(self, block: TrackerSamples) -> list[CellBlock]:
        """Cells of the passes and standstills that these samples finish."""
        raw = TrackerSamples.join([self._raw, block])
        valid = find_valid_samples(raw)
        old = min(_CONTEXT + _HELD, len(self._raw)) - _HELD
        fresh = np.zeros(len(raw), bool)
        fresh[max(old, 0) : len(raw) - _HELD] = True
        self._unusable += describe_unusable(raw, valid | ~fresh)
        self._raw = raw.select(slice(max(len(raw) - _CONTEXT - _HELD, 0), None))
        return self._add_valid(raw, np.flatnonzero(fresh & valid))

    def finish(self) -> list[CellBlock]:
        """End of data: the cells that were waiting for more."""
        held = np.arange(max(len(self._raw) - _HELD, 0), len(self._raw))
        valid = find_valid_samples(self._raw)
        found = self._add_valid(self._raw, held[valid[held]])
        self._stream.end()
        self._is_over = True
        found += self._recognise()
        return found + self._last_standstill()

    def observations(self, parts: Sequence[CellBlock]) -> Observations:
        """Cells as one block, about the present pose.

        `first` and `last` of its passes count valid samples.
        """
        if self.pose is None:
            raise AlignmentError("the standstills so far do not tell the pose")
        passes = tuple(self._passes)
        begin_s = min(float(part.cells.time_s[0]) for part in parts)
        end_s = max(float(part.cells.time_s[-1]) for part in parts)
        said = [x for x in self._unusable if begin_s <= x.begin_s <= end_s]
        return join_blocks(self._run, list(parts), self.pose, passes, self.seats, said)

    def _add_valid(self, raw: TrackerSamples, rows: np.ndarray) -> list[CellBlock]:
        self._stream.add(raw.device_time_s[rows], raw.position_mm[rows])
        found = self._recognise()
        self._discard_old()
        return found

    def _recognise(self) -> list[CellBlock]:
        stops = self._stream.stops
        for index in range(self._looked_at, len(stops)):
            self._looked_at = index + 1
            first = stops[index].first
            self._begun_s.append(float(self._stream.part(first, first + 1)[0][0]))
            if self.pose is None:
                self._match_first()
            else:
                self._match_by_place(index)
        found: list[CellBlock] = []
        while self._delivered + 1 < len(self._matched):
            here, there = self._matched[self._delivered :][:2]
            if not self._is_settled(there[1]):
                break
            found += self._between(here, there)
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
                join_stops(stops, 0), nominal_mm, ordered_by=names, seating=seating
            )
        except AlignmentError:
            return  # too few so far, or another path: the batch decides
        if is_wide(nominal_mm[found.waypoint], self._place_mm):
            pairs = zip(found.stop.tolist(), found.waypoint.tolist(), strict=True)
            self._matched, self.pose = list(pairs), found.pose
            self._refine_pose()

    def _match_by_place(self, index: int) -> None:
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
                self._was_astray.append(was)
            self._astray.clear()
            self._matched.append((index, begin + int(near[0])))
            self._refine_pose()
        elif begin < len(self._place_mm):
            self._note_unmatched(index, begin)

    def _note_unmatched(self, index: int, begin: int) -> None:
        """Records a standstill off all points ahead and the way to them."""
        assert self.pose is not None  # noqa: S101 (the caller has asked)
        place = self.pose.invert().apply(self._stream.stops[index].position_mm)
        away_mm = np.linalg.norm(self._known.seated_mm[begin:] - place, axis=1)
        last = min(begin + SKIP, len(self._place_mm) - 1)
        rows = slice(self._nominal.first[begin], self._nominal.first[last] + 1)
        lines = self._nominal.begin_mm[rows], self._nominal.end_mm[rows]
        beside_mm, _ = measure_distances(place, *lines)
        reach_mm = self._compute_reach_mm(slice(begin, last + 1)).max()
        if min(away_mm.min(), beside_mm.min()) > TOLERANCE_MM + reach_mm:
            self._astray.append((index, float(away_mm.min())))

    def _compute_reach_mm(self, places: slice) -> Float64[np.ndarray, " n"]:
        ahead = range(*places.indices(len(self._place_mm)))
        if self._is_over or self._known.seating is None:
            return np.zeros(len(ahead))
        return np.array([self._known.compute_reach_mm(waypoint) for waypoint in ahead])

    def _is_settled(self, waypoint: int) -> bool:
        return self._is_over or self._known.is_known(waypoint)

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

    def _between(
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
        block = join_stops(stops, origin)
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

    def _last_standstill(self) -> list[CellBlock]:
        if not self._matched:
            return []
        last = self._matched[-1]
        return self._between(last, last)

    def _discard_old(self) -> None:
        stops = self._stream.stops
        if self.pose is not None:
            self._stream.discard_before(stops[self._matched[self._delivered][0]].first)
        most = int(_MOST_KEPT_S * self._run.machine.tracker.rate_hz)
        if self._stream.kept > most:
            self._stream.discard_before(len(self._stream) - most // 2)
