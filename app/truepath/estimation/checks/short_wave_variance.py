"""Short-wave axis errors between the knots of error motions, from lines that cross.

A screw pitch of some millimetres, or a kink of a guide, is too short for the splines
and for the cells: it stays in the residuals of samples. Noise differs from line to
line, but an axis error at a position is the same on all lines that pass it. The mean
product of residuals of different lines at one position is therefore the variance of
their common part, whatever its shape:

    E[rᵢ rⱼ] = h²(x),    lines i ≠ j.

The variance found counts as uncertainty of the error motion at every position.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline

from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.reduction import beam_frame
from truepath.estimation.noise.intra_cell_motion import (
    measure_lag,
    remove_mean_and_slope,
)
from truepath.estimation.solve.batch import Estimate
from truepath.estimation.solve.run_estimate import RunEstimate
from truepath.files.bundle.run import Run
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.symbols import DIRECTION, is_turn
from truepath.numerics.rigid import RigidTransform

_PLACE_MM = 1.0  # lines meet at one position within this
_BLOCK = 2.0  # knots: longer waves are followed by the error motions
_FEWEST_CELLS = 4  # of a line whose fit is interpolated between cells
_LEAST_SHARE = 0.2  # of a line, along an axis
_OUTLIER = 5.0  # of the median residual of a line
_GAP = 1.6  # cells: beyond, cells between were excluded
_SURE = 3.0  # standard deviations of the variance found; less is chance
_GRID = 101  # positions of an axis


@dataclass(frozen=True, slots=True)
class _LineRest:
    """Residuals of the samples of one line.

    position : (n, axes); rest_mm : (n, 3) in the frame that the tracker is mounted on;
        sigma_mm : (3,) of one sample
    """

    position: Float64[np.ndarray, "n a"]
    rest_mm: Float64[np.ndarray, "n 3"]
    sigma_mm: Float64[np.ndarray, "3"]


def add_ripple(found: Estimate, runs: Sequence[Run]) -> Estimate:
    """Adds short-wave axis errors to the covariance; the fit is kept.

    runs : the Run that each Run of the estimate is, or is part of
    """
    assert found.fit is not None  # noqa: S101 (it was asked to be kept)
    lines = [
        line
        for run, fitted, own in zip(runs, found.fit.runs, found.runs, strict=True)
        for line in _follow_lines(run, fitted.observations, own)
    ]
    extra = np.zeros(len(found.theta))
    for motion in found.model.error_motions:
        if not (is_turn(motion.symbol) or isinstance(motion.axis, RotaryAxis)):
            variance = _find_variance(motion, found.model.machine.axis_names, lines)
            extra[found.model.slices[motion.name]] = _spread(motion, variance)
    return replace(found, covariance=found.covariance + np.diag(extra))


def _follow_lines(
    run: Run, seen: Observations, own: RunEstimate
) -> Iterator[_LineRest]:
    """Straight lines at constant feed only."""
    machine = seen.at.machine
    turning = [machine.axis_names.index(axis.name) for axis in machine.rotary_axes]
    frame = beam_frame(seen.tracker_mm)
    left_mm = np.einsum("nij,ni->nj", frame, own.residuals.residual_mm)
    for first, last in seen.stretches:
        moved = np.ptp(seen.at.position_mm[first:last], axis=0)
        is_steady = seen.at.line[first] >= 0 and not seen.is_ramp[first]
        if is_steady and last - first >= _FEWEST_CELLS and not moved[turning].any():
            line = seen.select(np.arange(first, last))
            fitted_mm = line.tracker_mm - left_mm[first:last]
            sigma_mm = _compute_sample_sigma_mm(own, frame[(first + last) // 2])
            yield _follow(run, line, own.pose, fitted_mm, sigma_mm)


def _compute_sample_sigma_mm(
    own: RunEstimate, frame: Float64[np.ndarray, "3 3"]
) -> Float64[np.ndarray, "3"]:
    sigma = own.tracker.sigma_mm(np.array([own.distance_mm]))[0, [0, 1, 1]]
    beam, across = own.noise.white
    towards = frame @ own.pose.rotation
    return np.sqrt((sigma * [beam, across, across]) ** 2 @ towards**2)


def _follow(
    run: Run,
    line: Observations,
    pose: RigidTransform,
    fitted_mm: Float64[np.ndarray, "c 3"],
    sigma_mm: Float64[np.ndarray, "3"],
) -> _LineRest:
    each = line.passes[int(line.at.line[0])]
    time_s, cell_s = run.tracker.device_time_s[each.first : each.last], line.at.time_s
    place_mm = run.tracker.position_mm[each.first : each.last]
    usable = run.tracker.status[each.first : each.last] == 0
    usable &= np.isfinite(place_mm).all(axis=1)
    inside = usable & (time_s > cell_s[0]) & (time_s < cell_s[-1])
    step = np.diff(cell_s)
    after = np.searchsorted(cell_s, time_s[inside]).clip(1, len(step)) - 1
    inside[inside] = step[after] < _GAP * np.median(step)
    time_s, place_mm = time_s[inside], place_mm[inside]
    rest = place_mm - CubicSpline(cell_s, fitted_mm)(time_s)
    size = np.linalg.norm(rest, axis=1)
    good = size < _OUTLIER * (np.median(size) if len(size) else 0.0)
    share = (time_s[good] - cell_s[0]) / (cell_s[-1] - cell_s[0])
    begin, end = line.at.position_mm[[0, -1]]
    return _LineRest(
        begin + share[:, None] * (end - begin),
        rest[good] @ pose.rotation,
        sigma_mm,
    )


def _find_variance(
    motion: ErrorMotion, names: Sequence[str], lines: Sequence[_LineRest]
) -> float:
    """Common variance of the lines along the axis, mm²; 0 if it may be chance."""
    number, direction = names.index(motion.axis.name), DIRECTION[motion.symbol[1]]
    block_mm = _BLOCK * float(np.diff(motion.spline.knots).mean())
    places = int((motion.axis.high - motion.axis.low) / _PLACE_MM) + 1
    total = np.zeros((4, places))
    for line in lines:
        position = line.position[:, number]
        if len(position) < _FEWEST_CELLS:
            continue
        way = np.abs(line.position[-1] - line.position[0])
        if way[number] < _LEAST_SHARE * np.linalg.norm(way):
            continue
        off = position - motion.axis.low
        rest = _take_off_blocks(off, line.rest_mm[:, [direction]], block_mm)[:, 0]
        place = (off / _PLACE_MM).astype(np.int64).clip(0, places - 1)
        weight = np.bincount(place, minlength=places) / line.sigma_mm[direction] ** 2
        pulled = np.bincount(place, rest, places) / line.sigma_mm[direction] ** 2
        total += [weight, pulled, weight**2, pulled**2]
    pairs, products = total[0] ** 2 - total[2], total[1] ** 2 - total[3]
    if not pairs.any():
        return 0.0
    variance = float(products.sum() / pairs.sum())
    chance = float(np.linalg.norm(products - variance * pairs) / pairs.sum())
    return variance if variance > _SURE * chance else 0.0


def _take_off_blocks(
    off_mm: Float64[np.ndarray, " n"],
    rest_mm: Float64[np.ndarray, "n k"],
    block_mm: float,
) -> Float64[np.ndarray, "n k"]:
    block = (off_mm / block_mm).astype(np.int64)
    block -= block.min()
    count = int(block.max()) + 1
    lag = measure_lag(off_mm, block, count)
    return remove_mean_and_slope(rest_mm, block, lag, count)


def _spread(motion: ErrorMotion, variance: float) -> float:
    """Variance of each parameter for this mean variance of a position."""
    rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, _GRID))
    return variance / float((rows**2).sum(axis=1).mean())
