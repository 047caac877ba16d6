"""Observations of closed Runs, at standstill, on the fly or polled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.cell_blocks import (
    CellBlock,
    list_as_stops,
    reduce_pass,
    reduce_points,
    reduce_standstills,
    select_measured,
)
from truepath.alignment.observations.observations import (
    ArcDrive,
    Driving,
    Observations,
    Pass,
)
from truepath.alignment.observations.reduction import CELL_MM
from truepath.alignment.observations.segmentation import (
    Stream,
    cut_into_passes,
    find_arc_drives,
)
from truepath.alignment.observations.surroundings import (
    add_surroundings,
    concatenate_blocks,
)
from truepath.alignment.stream.cleaning import (
    detect_valid_samples,
    require_mm,
    require_seconds,
)
from truepath.alignment.stream.left_out import (
    NOT_MEASURED,
    Cause,
    LeftOut,
    describe_unusable,
)
from truepath.alignment.stream.nominal_path import (
    NominalPath,
    compute_nominal_path,
)
from truepath.alignment.stream.seating import compute_seating, seat_targets
from truepath.alignment.stream.sequence import (
    FEWEST_UNMATCHED,
    Matching,
    match_points,
    match_stops,
    require_targets,
)
from truepath.alignment.stream.stops import StopSequence, detect_stops
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointRows, Run, list_locks_s
from truepath.kinematics.machine.other_chains import describe_other, list_other_machines
from truepath_drivers.interfaces.records import Path

_TURN_DEG = 1.0  # of rotary axes: more is a line, whether or not the target moves
_SHORTEST_LINE_S = 0.3  # at its feed: shorter ones are mostly ramps
_FEWEST_POINTS = 4  # of which three determine the pose
_FEWEST_ROWS = 3
_CLEARLY = 0.95  # of the standstills
_FEWEST_SAMPLES = 100  # below it there is nothing to match
_DECIMALS = 6  # mm or deg
_OTHER_FEED = 0.03  # of the commanded one; controllers keep it far better
_STEADY_S = 0.5  # at least: a short line may not come to its feed
_HOLD_S = 0.3  # shorter standstills are no hold
_GAP = 5.0  # times the typical step; the beam is lost for single samples as well
_TELLING_S = 0.2  # of dwell: a ramp is short against it
_CLOCK = 0.25  # of the logarithm: less may be due to ramps next to a standstill
_FROM_ENDS_MM = 1.0  # nearer to a waypoint it is the waypoint


def align_all(runs: Sequence[Run], names: Sequence[str]) -> list[Observations]:
    """Observations of each Run, with their surroundings.

    Raises AlignmentError, with the name of the Run where there are several.
    """
    observed: list[Observations] = []
    for name, run in zip(names, runs, strict=True):
        try:
            seen = align(run)
            seen = add_surroundings(
                seen,
                run.commanded,
                run.temperature,
                locks_s=list_locks_s(run.tracker),
            )
        except AlignmentError as error:
            if len(runs) == 1:
                raise
            raise AlignmentError(f"{name}: {error}") from error
        observed.append(seen)
    return drop_measured_elsewhere(runs, observed)


def align(run: Run, *, cell_mm: float = CELL_MM) -> Observations:
    """Match the stream to the commanded path or points and reduce it to cells.

    cell_mm : longest cell on a line; shorter ones resolve shorter waves
    Raises AlignmentError if stream and commanded path or points do not belong together.
    """
    if run.points is not None:
        return _align_points(run, run.points)
    usable = detect_valid_samples(run.tracker, run.commanded.target)
    valid = np.flatnonzero(usable)
    if len(valid) < _FEWEST_SAMPLES:
        raise AlignmentError(
            f"the stream holds {len(valid)} valid samples; check beam and status"
        )
    time_s = run.tracker.device_time_s[valid]
    tracker_mm = run.tracker.position_mm[valid]
    nominal, stops, matching = _match_or_explain(run, time_s, tracker_mm)
    stream = Stream(time_s, tracker_mm, matching.pose, matching.reach_mm)
    left_out = describe_unusable(run.tracker, usable)
    left_out += _list_unmatched(stream, stops, matching, nominal)
    left_out += _list_beyond(time_s, stops, matching, nominal)
    parts = reduce_standstills(run, stops, matching, stream, nominal)
    if run.mode == "standstill":
        if not parts:
            raise AlignmentError(
                "the machine never stood still long enough; dwell at least 0.2 s at a "
                "point"
            )
        left_out += _list_points_without_stop(run, parts)
        return concatenate_blocks(
            run, parts, matching.pose, (), matching.seats, left_out
        )
    nominal = nominal.shift_through(
        matching.waypoint,
        matching.pose.invert().apply(stops.position_mm[matching.stop]),
    )
    passes = cut_into_passes(stream, stops, matching, nominal)
    if not passes:
        raise AlignmentError(
            "no line was recognised between the standstills; use longer lines"
        )
    for line, each in enumerate(passes):
        curve = nominal.curve(each.row)
        parts += reduce_pass(run, line, each, stream, curve, cell_mm)
    parts.sort(key=lambda part: float(part.cells.time_s[0]))
    in_run = tuple(p.shift(lambda k: int(valid[k])) for p in passes)
    arcs = find_arc_drives(stream, stops, matching, nominal)
    left_out += _list_lines_without_pass(nominal, passes, arcs)
    seen = concatenate_blocks(
        run, parts, matching.pose, in_run, matching.seats, left_out
    )
    driving = _describe_driving(run, stream, stops, matching, nominal, passes)
    in_run_arcs = [
        ArcDrive(a.row, int(valid[a.first]), int(valid[a.last])) for a in arcs
    ]
    return replace(seen, driving=driving, arcs=tuple(in_run_arcs))


def _align_points(run: Run, points: PointRows) -> Observations:
    valid = select_measured(run.tracker)
    if len(valid) < _FEWEST_POINTS:
        raise AlignmentError(
            f"{len(valid)} points were measured; at least {_FEWEST_POINTS} tell where "
            "the tracker stands"
        )
    time_s = run.tracker.device_time_s[valid]
    tracker_mm = run.tracker.position_mm[valid]
    nominal, stops, matching = _match_or_explain(run, time_s, tracker_mm)
    parts, left_out = reduce_points(run, points, valid, matching, nominal)
    left_out += _list_points_without_stop(run, parts)
    left_out += _list_beyond(time_s, stops, matching, nominal)
    seen = concatenate_blocks(run, parts, matching.pose, (), matching.seats, left_out)
    return replace(seen, offered=int(points.count.sum()))


def _match_or_explain(
    run: Run, time_s: Float64[np.ndarray, " n"], tracker_mm: Float64[np.ndarray, "n 3"]
) -> tuple[NominalPath, StopSequence, Matching]:
    try:
        return _match(run, time_s, tracker_mm)
    except AlignmentError as error:
        for other in list_other_machines(run.machine):
            try:
                found = _match(replace(run, machine=other), time_s, tracker_mm)
            except AlignmentError:
                continue
            nominal, stops, matching = found
            fits, of = len(matching.stop), min(len(stops), len(nominal.first))
            if fits >= _CLEARLY * of:
                said = describe_other(run.machine, other)
                raise AlignmentError(
                    f"the recording fits {said.other} far better than "
                    f"{said.declared}, which machine.json states: {fits} of {of} "
                    f"standstills agree; write {said.remedy} there. As stated, {error}"
                ) from error
        raise


def _match(
    run: Run, time_s: Float64[np.ndarray, " n"], tracker_mm: Float64[np.ndarray, "n 3"]
) -> tuple[NominalPath, StopSequence, Matching]:
    machine, path = run.machine, run.commanded
    nominal = compute_nominal_path(machine, path)
    commanded = "path.csv" if run.mode == "otf" else "points.csv"
    _require_motion(nominal, commanded)
    require_mm(tracker_mm, nominal.place_mm, run.stream_file)
    if run.points is None:
        require_seconds(time_s, machine.tracker.rate_hz)
        stops = detect_stops(time_s, tracker_mm, nominal.slowest_mm_s)
    else:
        stops = list_as_stops(tracker_mm)
    seating = compute_seating(machine, path, nominal.first)
    matching = match_stops(
        stops, nominal.place_mm, ordered_by=commanded, seating=seating
    )
    if seating is not None:

        def places_of(name: str) -> Float64[np.ndarray, "w 3"]:
            measured = replace(path, target=(name,) * len(path))
            return compute_nominal_path(machine, measured, nominal.first).place_mm

        require_targets(seating, matching, stops, commanded, places_of)
    if matching.seats:
        seated = seat_targets(machine, matching.seats)
        nominal = compute_nominal_path(seated, path, nominal.first)
    return nominal, stops, matching


def _list_beyond(
    time_s: Float64[np.ndarray, " n"],
    stops: StopSequence,
    matching: Matching,
    nominal: NominalPath,
) -> list[LeftOut]:
    """Standstills before and after the path; samples where it is repeated."""
    found: list[LeftOut] = []
    expected = matching.pose.apply(nominal.place_mm)
    sides: tuple[tuple[Cause, int, int], ...] = (
        ("before", 0, int(matching.stop[0])),
        ("after", int(matching.stop[-1]) + 1, len(stops)),
    )
    for cause, first, end in sides:
        if end - first >= FEWEST_UNMATCHED:
            begin, last = int(stops.first[first]), int(stops.last[end - 1]) - 1
            span_s = float(time_s[begin]), float(time_s[last])
            positions_mm = stops.position_mm[first:end]
            same, _ = match_points(positions_mm, expected, matching.reach_mm)
            if 2 * len(same) > len(expected):
                found.append(LeftOut("again", -1, *span_s, last - begin, 0.0))
            else:
                found.append(LeftOut(cause, -1, *span_s, end - first, 0.0))
    return found


def _list_unmatched(
    stream: Stream, stops: StopSequence, matching: Matching, nominal: NominalPath
) -> list[LeftOut]:
    """Parts of the stream with several standstills in a row that match no point, where
    points are missing: the machine went on, and the stream lost its frame.
    """
    stop = np.concatenate([[-1], matching.stop, [len(stops)]])
    place = np.concatenate([[-1], matching.waypoint, [len(nominal.first)]])
    expected = matching.pose.apply(nominal.place_mm)
    found: list[LeftOut] = []
    for (a, b), (c, d) in zip(pairwise(stop), pairwise(place), strict=True):
        if min(b - a, d - c) <= FEWEST_UNMATCHED:
            continue
        away = stops.position_mm[a + 1 : b, None] - expected[None, c + 1 : d]
        off_mm = float(np.linalg.norm(away, axis=2).min(axis=1).max())
        first, last = int(stops.first[a + 1]), int(stops.last[b - 1])
        begin_s, end_s = stream.time_s[[first, last - 1]]
        row = int(nominal.first[c + 1])
        found.append(
            LeftOut("astray", row, float(begin_s), float(end_s), last - first, off_mm)
        )
    return found


def _list_lines_without_pass(
    nominal: NominalPath, passes: tuple[Pass, ...], arcs: tuple[ArcDrive, ...]
) -> list[LeftOut]:
    takes = nominal.length_mm >= _SHORTEST_LINE_S * nominal.speed_mm_s
    rows = np.flatnonzero(takes | (nominal.turn_deg > _TURN_DEG))
    known = {each.row for each in passes} | nominal.arcs | {0}
    missing = [int(row) for row in rows if int(row) not in known]
    missing += sorted(nominal.arcs - {each.row for each in arcs})
    return [LeftOut("no-pass", row, np.nan, np.nan, 0, 0.0) for row in missing]


def _list_points_without_stop(run: Run, parts: Sequence[CellBlock]) -> list[LeftOut]:
    seen = {part.row for part in parts}
    missing = [row for row in range(len(run.commanded)) if row not in seen]
    return [LeftOut("no-stop", row, np.nan, np.nan, 0, 0.0) for row in missing]


def _require_motion(nominal: NominalPath, commanded: str) -> None:
    """Rejects rotary axes that turn about the target, or do not carry it."""
    rows = len(nominal.end_mm)
    if rows < _FEWEST_ROWS:
        raise AlignmentError(
            f"{commanded} has {rows} rows, and at least {_FEWEST_ROWS} tell where the "
            "tracker stands: it is cut short; give all that was driven"
        )
    if len(nominal.first) < _FEWEST_ROWS:
        raise AlignmentError(
            f"{commanded} hardly moves the target where the tracker stands: it is on "
            "the axis that turns, or not carried by the axes that move; measure a "
            "target 50 mm or more off the axis, or move other axes"
        )


def drop_measured_elsewhere(
    runs: Sequence[Run], observed: Sequence[Observations]
) -> list[Observations]:
    """Removes missing rows from `left_out` that other Runs have measured.

    An interrupted measurement that was continued is several Runs: a row is missing only
    if none of them has it.
    """
    measured = [
        {_describe_row(run, row) for row in seen.measured_rows}
        for run, seen in zip(runs, observed, strict=True)
    ]
    found: list[Observations] = []
    for number, (run, seen) in enumerate(zip(runs, observed, strict=True)):
        others = set[tuple[object, ...]]()
        others.update(*(measured[k] for k in range(len(runs)) if k != number))
        kept = tuple(
            each
            for each in seen.left_out
            if each.cause not in NOT_MEASURED
            or _describe_row(run, each.row) not in others
        )
        driving = _add_driven_elsewhere(number, runs, observed)
        found.append(replace(seen, left_out=kept, driving=driving))
    return found


def _add_driven_elsewhere(
    number: int, runs: Sequence[Run], observed: Sequence[Observations]
) -> Driving | None:
    driving = observed[number].driving
    if driving is None or driving.is_complete:
        return driving
    others = {
        _describe_row(run, row)
        for k, (run, seen) in enumerate(zip(runs, observed, strict=True))
        if k != number and seen.driving is not None
        for row in range(max(seen.driving.first, 1), seen.driving.last + 1)
    }
    first, last, run = driving.first, driving.last, runs[number]
    while first > 1 and _describe_row(run, first - 1) in others:
        first -= 1
    while last < driving.rows - 1 and _describe_row(run, last + 1) in others:
        last += 1
    return replace(driving, first=first, last=last)


def _describe_row(run: Run, row: int) -> tuple[object, ...]:
    path = run.commanded
    first = row - 1 if isinstance(path, Path) else row
    ends = np.round(path.position[max(first, 0) : row + 1], _DECIMALS)
    target = path.target[row] if path.target else ""
    return (run.mode, path.axes, target, *map(tuple, ends.tolist()))


def _describe_driving(
    run: Run,
    stream: Stream,
    stops: StopSequence,
    matching: Matching,
    nominal: NominalPath,
    passes: Sequence[Pass],
) -> Driving:
    # For the operator; the measurement does not depend on it.
    place = matching.waypoint
    feeds = _measure_other_feeds(stream, nominal, passes)
    clock = _estimate_clock(run, stream, stops, matching, nominal, feeds, len(passes))
    step_s = np.diff(run.tracker.device_time_s)
    usual_s = float(np.median(step_s))
    gaps_s = step_s[step_s > _GAP * usual_s]
    return Driving(
        min(int(nominal.first[place[0]]), passes[0].row),
        max(int(nominal.last[place[-1]]), passes[-1].row),
        len(nominal.end_mm),
        feeds if clock == 1.0 else {},
        _detect_holds(stream, stops, matching, nominal),
        clock,
        tuple(gaps_s.tolist()),
        int((np.rint(gaps_s / usual_s) - 1).sum()),
    )


def _estimate_clock(
    run: Run,
    stream: Stream,
    stops: StopSequence,
    matching: Matching,
    nominal: NominalPath,
    feeds: dict[int, float],
    lines: int,
) -> float:
    """Ratio of measured to commanded times, 1 where it is not certain.

    An override changes the lines alone, a wrong rate the standstills as well.
    """
    if 2 * len(feeds) < lines or not feeds:
        return 1.0
    share = np.array([*feeds.values()])
    clock = 1.0 / float(np.median(share))
    if np.abs(share * clock - 1.0).max() > _OTHER_FEED:
        return 1.0
    rows = nominal.last[matching.waypoint]
    inner = (rows > 0) & (rows < len(run.commanded) - 1)
    dwell_s = run.commanded.dwell_s[rows]
    first, last = stops.first[matching.stop], stops.last[matching.stop] - 1
    rest_s = stream.time_s[last] - stream.time_s[first]
    is_inner_dwell = inner & (dwell_s >= _TELLING_S)
    if not is_inner_dwell.any():
        return 1.0
    rest_ratio = float(np.median(rest_s[is_inner_dwell] / dwell_s[is_inner_dwell]))
    off, limit = abs(np.log(rest_ratio / clock)), abs(np.log(clock))
    return clock if limit > _CLOCK and 2.0 * off < limit else 1.0


def _measure_other_feeds(
    stream: Stream, nominal: NominalPath, passes: Sequence[Pass]
) -> dict[int, float]:
    """Without rotary axes: each control splits the feed over them differently."""
    found: dict[int, float] = {}
    for each in passes:
        if not each.is_steady or nominal.turn_deg[each.row] > 0.0:
            continue
        took_s = stream.time_s[each.last - 1] - stream.time_s[each.first]
        share = each.speed_mm_s / float(nominal.speed_mm_s[each.row])
        if took_s >= _STEADY_S and abs(share - 1.0) > _OTHER_FEED:
            found[each.row] = share
    return found


def _detect_holds(
    stream: Stream, stops: StopSequence, matching: Matching, nominal: NominalPath
) -> tuple[tuple[int, float, float], ...]:
    found: list[tuple[int, float, float]] = []
    where_mm = matching.pose.invert().apply(stops.position_mm)
    matched = zip(matching.stop.tolist(), matching.waypoint.tolist(), strict=True)
    for (here, a), (there, b) in pairwise(matched):
        rows = range(int(nominal.last[a]) + 1, int(nominal.first[b]) + 1)
        for k in range(here + 1, there):
            begin_s = float(stream.time_s[stops.first[k]])
            rest_s = float(stream.time_s[stops.last[k] - 1]) - begin_s
            on = [r for r in rows if _is_on_line(nominal, r, where_mm[k], matching)]
            if on and rest_s >= _HOLD_S:
                found.append((on[0], begin_s, rest_s))
    return tuple(found)


def _is_on_line(
    nominal: NominalPath, row: int, place_mm: np.ndarray, matching: Matching
) -> bool:
    curve = nominal.curve(row)
    share, off_mm = curve.nearest(place_mm[None])
    way_mm = float(share[0]) * curve.length_mm
    is_between = _FROM_ENDS_MM < way_mm < curve.length_mm - _FROM_ENDS_MM
    return is_between and float(off_mm[0]) < matching.reach_mm
