"""Cells of one pass, standstill or polled point, with the commanded positions there.

Of a polled tracker nothing is recognised from motion: a sample is the mean of a whole
dwell and names its row. The sequence of points still has to be that of the rows, so
that a wrong numbering, another target or a reflector that moved shows as a point off
its row. Shots without a number are assigned to rows by position and order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Pass
from truepath.alignment.observations.reduction import (
    CELL_MM,
    Cells,
    beam_frame,
    count_cells,
    exclude_cells,
    reduce_to_cells,
)
from truepath.alignment.observations.segmentation import Stream
from truepath.alignment.stream.left_out import LeftOut, describe_samples
from truepath.alignment.stream.nominal_path import (
    Curve,
    NominalPath,
    compute_nominal_path,
)
from truepath.alignment.stream.seating import compute_seating
from truepath.alignment.stream.sequence import TOLERANCE_MM, Matching, match_stops
from truepath.alignment.stream.stops import StopSequence, standstill_speed_mm_s
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointRows, Run
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Configurations
from truepath.numerics.rigid import RigidTransform
from truepath_drivers.interfaces.records import TrackerSamples

STANDSTILL_SETTLE_S = 0.05  # excluded at both ends of a standstill, at the least
_TO_REST = 4.0  # times distance over speed there: even soft jerks end
_FEWEST_SAMPLES = 5  # of a standstill
_PARABOLA = 5  # samples before and after, for a local parabola
_CREEP_SIGMAS = 5.0  # of a quarter of a standstill: rare samples are no creep
_CREEP_MM = 0.03  # several times the effect of air in a second


@dataclass(frozen=True, slots=True)
class CellBlock:
    """Cells of one pass (`line` counts passes) or of one standstill (`line` is −1).

    row : of the commanded path or points; velocity_mm_s : (n, 3), 0 at a standstill
    position_mm : (n, axes) nominal; line_time_s : (n,) from the middle of the pass
    line_speed_mm_s : mean speed along the line, of a pass at constant feed
    left_out : samples that are in no cell
    acceleration : (n, axes) mm/s² on a ramp; None elsewhere
    """

    cells: Cells
    row: int
    line: int
    velocity_mm_s: Float64[np.ndarray, "n 3"]
    position_mm: Float64[np.ndarray, "n a"]
    line_time_s: Float64[np.ndarray, " n"]
    line_speed_mm_s: float = 0.0
    left_out: tuple[LeftOut, ...] = ()
    acceleration: Float64[np.ndarray, "n a"] | None = None

    @property
    def is_ramp(self) -> bool:
        """True if the feed changes: positions are then measured ones."""
        return self.acceleration is not None


def reduce_pass(
    run: Run,
    line: int,
    each: Pass,
    stream: Stream,
    curve: Curve,
    cell_mm: float = CELL_MM,
) -> list[CellBlock]:
    found = [
        _reduce_ramp(run, line, each, slice(*ramp), stream, curve, cell_mm)
        for ramp in each.ramps
    ]
    if each.is_steady:
        found.append(_reduce_steady(run, line, each, stream, curve, cell_mm))
    return sorted(found, key=lambda block: float(block.cells.time_s[0]))


def _reduce_ramp(
    run: Run,
    line: int,
    each: Pass,
    part: slice,
    stream: Stream,
    curve: Curve,
    cell_mm: float,
) -> CellBlock:
    """Cells at their measured positions on a straight line.

    Machine errors change slowly, so a position that is wrong by their own size along
    the line has no effect across it. Scatter along the line is 0.
    """
    share, aside = curve.nearest(stream.points_mm(part.start, part.stop))
    on, rotation = aside < stream.reach_mm, stream.pose.rotation
    time, share, tracker_mm = stream.time_s[part], share[on], stream.tracker_mm[part]
    left_out = describe_samples("off-line", each.row, time[~on], aside[~on])
    time, tracker_mm = time[on], tracker_mm[on]

    def way(time_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        return curve.point_mm(np.interp(time_s, time, share)) @ rotation.T

    span = float(time[-1] - time[0])
    fastest = 1.5 * abs(float(share[-1] - share[0])) * curve.length_mm / span
    count = count_cells(span, fastest, cell_mm=cell_mm)
    cells = reduce_to_cells(time, tracker_mm, way, run.machine.tracker.sigma_mm, count)
    cells = replace(cells, scatter_square=np.zeros(2), freedom=np.zeros(2))
    left_out += _describe_outliers(cells, time, each.row)
    tracker, expected = run.machine.tracker, way(cells.time_s)
    cells, off = exclude_cells(cells, expected, tracker, each.row)
    place = np.interp(cells.time_s, time, share)
    rate, change = _differentiate(time, share, cells.time_s, span / count)
    rows = run.commanded.position[each.row - 1 : each.row + 1]
    return CellBlock(
        cells,
        each.row,
        line,
        curve.chord_mm * rate[:, None],
        rows[0] + place[:, None] * (rows[1] - rows[0]),
        np.zeros(len(place)),
        left_out=(*left_out, *off),
        acceleration=change[:, None] * (rows[1] - rows[0]),
    )


def _differentiate(
    time_s: Float64[np.ndarray, " m"],
    share: Float64[np.ndarray, " m"],
    at_s: Float64[np.ndarray, " n"],
    cell_s: float,
) -> Float64[np.ndarray, "2 n"]:
    """First and second derivative of the share of the line, at the cells: by parabolas
    through the samples of each, and a few more where it has few.
    """
    half_s = max(0.5 * cell_s, _PARABOLA * float(np.median(np.diff(time_s))))
    first = np.searchsorted(time_s, np.maximum(at_s - half_s, time_s[0]))
    last = np.searchsorted(time_s, np.minimum(at_s + half_s, time_s[-1]), "right")
    count = last - first
    cell = np.repeat(np.arange(len(at_s)), count)
    sample = np.arange(len(cell)) + np.repeat(last - np.cumsum(count), count)
    lag = (time_s[sample] - at_s[cell]) / half_s
    sums = np.array([np.bincount(cell, lag**p, len(at_s)) for p in range(5)])
    right = [np.bincount(cell, share[sample] * lag**p, len(at_s)) for p in range(3)]
    gram = sums[np.add.outer(range(3), range(3))].transpose(2, 0, 1)
    bent = np.linalg.pinv(gram, hermitian=True) @ np.array(right).T[:, :, None]
    return bent[:, 1:, 0].T * [[1.0 / half_s], [2.0 / half_s**2]]


def _reduce_steady(
    run: Run, line: int, each: Pass, stream: Stream, curve: Curve, cell_mm: float
) -> CellBlock:
    part = slice(each.first, each.last)
    time = stream.time_s[part]
    middle, rate = 0.5 * float(time[0] + time[-1]), each.speed_mm_s / curve.length_mm
    rotation = stream.pose.rotation

    def way(time_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        return curve.point_mm(each.share + rate * (time_s - middle)) @ rotation.T

    count = count_cells(
        float(time[-1] - time[0]),
        each.speed_mm_s * curve.fastest(),
        rate * curve.turn_deg,
        cell_mm,
    )
    aside = _distance_from_curve_mm(curve, each, stream, time - middle, rate)
    on = aside < stream.reach_mm
    tracker, tracker_mm = run.machine.tracker, stream.tracker_mm[part]
    left_out = describe_samples("off-line", each.row, time[~on], aside[~on])
    time = time[on]
    cells = reduce_to_cells(time, tracker_mm[on], way, tracker.sigma_mm, count)
    left_out += _describe_outliers(cells, time, each.row)
    cells, off = exclude_cells(cells, way(cells.time_s), tracker, each.row)
    line_time = cells.time_s - 0.5 * float(cells.time_s[0] + cells.time_s[-1])
    share = each.share + rate * (cells.time_s - middle)
    late, slow = _fit_timing(curve, share, stream.pose.invert(), cells, line_time)
    share, rate = share + late + slow * line_time, rate + slow
    rows = run.commanded.position[each.row - 1 : each.row + 1]
    return CellBlock(
        cells,
        each.row,
        line,
        curve.slope_mm(share) * rate,
        rows[0] + share[:, None] * (rows[1] - rows[0]),
        line_time,
        curve.length_mm * rate,
        (*left_out, *off),
    )


def _distance_from_curve_mm(
    curve: Curve,
    each: Pass,
    stream: Stream,
    lag_s: Float64[np.ndarray, " n"],
    rate: float,
) -> Float64[np.ndarray, " n"]:
    share = each.share + rate * lag_s
    slope = curve.slope_mm(share)
    away = stream.points_mm(each.first, each.last) - curve.point_mm(share)
    square = np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-12)
    along = np.einsum("ni,ni->n", away, slope) / square
    return np.linalg.norm(away - along[:, None] * slope, axis=1)


def _describe_outliers(
    cells: Cells, time_s: Float64[np.ndarray, " n"], row: int
) -> list[LeftOut]:
    return describe_samples("outliers", row, time_s[cells.outlier], cells.off_mm)


def _fit_timing(
    curve: Curve,
    share: Float64[np.ndarray, " n"],
    to_workpiece: RigidTransform,
    cells: Cells,
    line_time_s: Float64[np.ndarray, " n"],
) -> tuple[float, float]:
    """Lead of the cells at mid line, and its rate per second.

    In shares of the line, by least squares along it; one cell determines no rate.
    """
    slope = curve.slope_mm(share)
    off = to_workpiece.apply(cells.tracker_mm) - curve.point_mm(share)
    square = np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-12)
    ahead = np.einsum("ni,ni->n", off, slope) / square
    if len(share) < 2:
        return float(ahead[0]), 0.0
    weight = cells.count * square
    weight /= weight.sum()
    lag = line_time_s - weight @ line_time_s
    slow = float((weight * lag) @ ahead / ((weight * lag) @ lag))
    return float(weight @ ahead) - slow * float(weight @ line_time_s), slow


def reduce_standstills(
    run: Run,
    stops: StopSequence,
    matching: Matching,
    stream: Stream,
    nominal: NominalPath,
) -> list[CellBlock]:
    """Cells of every matched standstill, without settling.

    Those of lines too: phase and speed of a line are free, and the stops at its ends
    determine the errors along it. Not those at which an axis may have turned unseen.
    They begin and end where the machine is slow; its distance from rest there gives the
    time to rest.
    """
    slow_mm_s = standstill_speed_mm_s(nominal.slowest_mm_s)
    found: list[CellBlock] = []
    for stop, place in zip(matching.stop, matching.waypoint, strict=True):
        first, last = int(stops.first[stop]), int(stops.last[stop])
        row = int(nominal.first[place])
        if last - first < _FEWEST_SAMPLES or row != nominal.last[place]:
            continue
        left_mm = stream.tracker_mm[[first, last - 1]] - stops.position_mm[stop]
        wait_s = _TO_REST * np.linalg.norm(left_mm, axis=1) / slow_mm_s
        begin_s, end_s = np.maximum(wait_s, STANDSTILL_SETTLE_S)
        time_s = stream.time_s[first:last]
        settled = (time_s > time_s[0] + begin_s) & (time_s < time_s[-1] - end_s)
        inside = first + np.flatnonzero(settled)
        if len(inside) < _FEWEST_SAMPLES:
            continue
        excluded: list[LeftOut] = []
        if run.mode == "standstill":  # all its samples become one cell
            inside, excluded = _select_longer_side(stream, inside, row)
        distance_mm = np.linalg.norm(stops.position_mm[[stop]], axis=1)
        sigma_mm = float(run.machine.tracker.sigma_mm(distance_mm).max())
        if _is_creeping(stream.tracker_mm[inside], sigma_mm):
            continue
        span = float(stream.time_s[inside[-1]] - stream.time_s[inside[0]])
        cells = reduce_to_cells(
            stream.time_s[inside],
            stream.tracker_mm[inside],
            _no_motion,
            run.machine.tracker.sigma_mm,
            min(count_cells(span), max(1, len(inside) // _FEWEST_SAMPLES)),
        )
        if not len(cells.time_s):  # each sample is far off the others
            continue
        excluded += _describe_outliers(cells, stream.time_s[inside], row)
        expected = _no_motion(cells.time_s)
        cells, off = exclude_cells(cells, expected, run.machine.tracker, row)
        n = len(cells.time_s)
        position = np.tile(run.commanded.position[row], (n, 1))
        still, none = np.zeros((n, 3)), np.zeros(n)
        left_out = (*excluded, *off)
        found.append(CellBlock(cells, row, -1, still, position, none, 0.0, left_out))
    return found


def _select_longer_side(
    stream: Stream, inside: Int64[np.ndarray, " n"], row: int
) -> tuple[Int64[np.ndarray, " m"], list[LeftOut]]:
    """The samples before or after a shift, and a record of the others."""
    found = _detect_shift(stream.tracker_mm[inside])
    if found is None:
        return inside, []
    first, off_mm = found
    lost, kept = sorted((inside[:first], inside[first:]), key=len)
    off = np.full(len(lost), off_mm)
    return kept, describe_samples("cells", row, stream.time_s[lost], off)


# An unintended shift of tracker or reflector within a dwell, told from its own samples:
# all of them become one cell, whose mean would be of neither place. It is sudden: two
# means, before and after it, leave of either side no more than its noise, and the
# samples next to it differ as the sides do. A swing, a settling or a drift leaves a
# quarter of what the sides differ by, or more; air that wanders may leave less, but
# takes time.
_FEWEST_OF_SIDE, _SHORTEST = 5, 0.1  # samples of a side; share of the dwell
_QUARTERS = 4
_CLEARLY = 8.0  # times what a side varies by
_BESIDE, _AT_ONCE = 0.05, 0.7  # of the dwell; of the step
_LEAST_MM = 0.005  # less moves the mean by less than the air does


def _detect_shift(tracker_mm: Float64[np.ndarray, "n 3"]) -> tuple[int, float] | None:
    """The first sample after a shift and the size of the shift in mm.

    None where the target stood still.
    """
    n = len(tracker_mm)
    least = max(_FEWEST_OF_SIDE, round(_SHORTEST * n))
    first = np.arange(least, n - least + 1)
    if not len(first):
        return None
    middle_mm = tracker_mm.mean(axis=0)
    rest = (tracker_mm - middle_mm) @ beam_frame(middle_mm[None])[0].T
    noise = np.sqrt(np.mean(np.diff(rest, axis=0) ** 2, axis=0) / 2.0)
    before = np.cumsum(rest / np.maximum(noise, 1e-9), axis=0)[first - 1]
    gain = np.sum(before**2, axis=1) / (first * (n - first))
    shift = int(first[np.argmax(gain)])
    sides = rest[:shift], rest[shift:]
    by_noise = noise * np.sqrt(_QUARTERS / min(map(len, sides)))
    varies = np.max([by_noise, *map(_measure_variation, sides)], axis=0)
    step = sides[1].mean(axis=0) - sides[0].mean(axis=0)
    near = max(_FEWEST_OF_SIDE, round(_BESIDE * n))
    at_once = sides[1][:near].mean(axis=0) - sides[0][-near:].mean(axis=0)
    is_clear = np.abs(step) > np.maximum(_CLEARLY * varies, _LEAST_MM)
    is_sudden = at_once * np.sign(step) > _AT_ONCE * np.abs(step)
    if not (is_clear & is_sudden).any():
        return None
    return shift, float(np.linalg.norm(step))


def _measure_variation(side: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    means = np.array([part.mean(axis=0) for part in np.array_split(side, _QUARTERS)])
    return np.sqrt(np.mean((means - side.mean(axis=0)) ** 2, axis=0))


def _no_motion(time_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
    return np.zeros((len(time_s), 3))


def _is_creeping(tracker_mm: Float64[np.ndarray, "n 3"], sigma_mm: float) -> bool:
    """True if a target moves too slowly to be distinguished from one at rest. A target
    near a rotary axis, or on a table that hardly turns, does so during the motion.

    sigma_mm : noise of a sample
    """
    noise_mm = _CREEP_SIGMAS * sigma_mm / np.sqrt(0.25 * len(tracker_mm))
    quarters = np.array_split(tracker_mm, 4)
    means = np.array([quarter.mean(axis=0) for quarter in quarters])
    return bool(np.linalg.norm(np.ptp(means, axis=0)) > max(_CREEP_MM, noise_mm))


def select_measured(samples: TrackerSamples) -> Int64[np.ndarray, " m"]:
    return np.flatnonzero(samples.status == 0)


def list_as_stops(tracker_mm: Float64[np.ndarray, "n 3"]) -> StopSequence:
    """Each point becomes a separate standstill of one sample."""
    number = np.arange(len(tracker_mm))
    return StopSequence(number, number + 1, tracker_mm)


def reduce_points(
    run: Run,
    points: PointRows,
    measured: Int64[np.ndarray, " m"],
    matching: Matching,
    nominal: NominalPath,
) -> tuple[list[CellBlock], list[LeftOut]]:
    """A cell for each point near its row, and exclusions for the others.

    measured : indices of the samples that are measurements
    """
    expected = matching.pose.apply(nominal.end_mm[points.row[measured]])
    tracker_mm = run.tracker.position_mm[measured]
    off_mm = np.linalg.norm(tracker_mm - expected, axis=1)
    parts: list[CellBlock] = []
    left_out: list[LeftOut] = []
    for sample, off in zip(measured.tolist(), off_mm.tolist(), strict=True):
        row, count = int(points.row[sample]), int(points.count[sample])
        time_s = float(run.tracker.device_time_s[sample])
        if off > matching.reach_mm:
            left_out.append(LeftOut("astray", row, time_s, time_s, count, off))
        else:
            parts.append(reduce_point(run, points, sample))
    return parts, left_out


def reduce_point(run: Run, points: PointRows, sample: int) -> CellBlock:
    """One cell; its scatter is 0 where the covariance is unknown."""
    row, tracker_mm = int(points.row[sample]), run.tracker.position_mm[[sample]]
    frame = beam_frame(tracker_mm)[0]
    square = np.diag(frame @ points.covariance_mm2[sample] @ frame.T)
    sigma = run.machine.tracker.sigma_mm(np.linalg.norm(tracker_mm, axis=1))[0]
    # An unknown covariance contains nothing on the scatter.
    free = float(points.count[sample] - 1) * bool(square.any())
    scatter = free * np.array([square[0], square[1] + square[2]]) / sigma**2
    cells = Cells(
        run.tracker.device_time_s[[sample]],
        tracker_mm,
        points.count[[sample]].astype(np.float64),
        scatter,
        np.array([free, 2.0 * free]),
        np.zeros(1, bool),
        np.empty(0),
    )
    position = run.commanded.position[[row]]
    return CellBlock(cells, row, -1, np.zeros((1, 3)), position, np.zeros(1))


def order_shots(
    machine: Machine, points: Configurations, tracker_mm: Float64[np.ndarray, "n 3"]
) -> Int64[np.ndarray, " n"] | None:
    """Row of each shot, −1 off all points; None if shots do not follow them.

    Consecutive shots at one position are of one point; any point may be missing.
    """
    if not len(tracker_mm):
        return None
    step_mm = np.linalg.norm(np.diff(tracker_mm, axis=0), axis=1)
    stay = np.append(0, np.cumsum(step_mm > TOLERANCE_MM))
    count = np.bincount(stay)
    place_mm = np.stack(
        [np.bincount(stay, tracker_mm[:, axis]) / count for axis in range(3)], axis=1
    )
    nominal = compute_nominal_path(machine, points)
    try:
        found = match_stops(
            list_as_stops(place_mm),
            nominal.place_mm,
            ordered_by="points.csv",
            seating=compute_seating(machine, points, nominal.first),
        )
    except AlignmentError:
        return None
    row = np.full(len(place_mm), -1)
    row[found.stop] = nominal.first[found.waypoint]
    return row[stay]
