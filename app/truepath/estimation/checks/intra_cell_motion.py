"""Information in samples within their cells: motion faster than cells can follow.

The mean of a cell and the deviations of its samples from a straight line in time are
independent where the noise is white, so their information on an effect adds up. Machine
errors are practically straight within a cell; only motion that is fast in time shows
here.

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
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.reduction import beam_frame
from truepath.alignment.stream.cleaning import detect_valid_samples
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.estimation.problem.knots import compute_spacing
from truepath.estimation.solve.batch import Estimate, RunEstimate
from truepath.files.bundle.run import Run
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.effects.family import Wave
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.symbols import DIRECTION, is_turn
from truepath.numerics.rigid import RigidTransform

_OUTLIER = 5.0
_KEPT = 8  # fast effects with cached columns: those chosen, and one on trial


@dataclass(frozen=True)
class _Fast:
    """An effect's columns (3n, p) without mean and slope in each cell, and weighted."""

    effect: Effect
    plain: Float64[np.ndarray, "m p"]
    weighted: Float64[np.ndarray, "m p"]


@dataclass(frozen=True)
class CellDeviations:
    """Deviations of all samples on lines from their cells' straight lines.

    time_s : (n,); deviation_mm : (n, 3) in the frame that the tracker is mounted on;
        cell : (n,)
    lag : (n,) time from the middle of the cell, its sum of squares 1 in each cell
    precision : (c, 3, 3) of one sample, for each cell; line : (c,) number of the line
    """

    time_s: Float64[np.ndarray, " n"]
    deviation_mm: Float64[np.ndarray, "n 3"]
    cell: Int64[np.ndarray, " n"]
    lag: Float64[np.ndarray, " n"]
    precision: Float64[np.ndarray, "c 3 3"]
    line: Int64[np.ndarray, " c"]
    rate_hz: float
    run: int

    @cached_property
    def weighted(self) -> Float64[np.ndarray, "n 3"]:
        return np.einsum("nij,nj->ni", self.precision[self.cell], self.deviation_mm)

    def sums(
        self, effects: Sequence[Effect], folds: int
    ) -> tuple[Float64[np.ndarray, "k q q"], list[tuple[int, int]]]:
        """Normal sums of fast effects, data last, in folds of lines.

        And their columns: number of the effect, number of its parameter.
        """
        found = [(k, self._of(effect)) for k, effect in enumerate(effects)]
        fast = [(k, one) for k, one in found if one is not None]
        columns = [(k, p) for k, one in fast for p in range(one.plain.shape[1])]
        total = np.zeros((folds, len(columns) + 1, len(columns) + 1))
        if not columns:
            return total, columns
        data = self.deviation_mm.reshape(-1, 1), self.weighted.reshape(-1, 1)
        plain = np.concatenate([*(one.plain for _, one in fast), data[0]], axis=1)
        weighted = np.concatenate([*(one.weighted for _, one in fast), data[1]], axis=1)
        for line, first, last in self._lines:
            mine = slice(3 * first, 3 * last)
            total[line % folds] += plain[mine].T @ weighted[mine]
        return total, columns

    @cached_property
    def _lines(self) -> list[tuple[int, int, int]]:
        line = self.line[self.cell]
        begin = np.flatnonzero(np.diff(line, prepend=line[0] - 1))
        end = np.append(begin[1:], len(line))
        return [(int(line[a]), int(a), int(b)) for a, b in zip(begin, end, strict=True)]

    @cached_property
    def _known(self) -> dict[Effect, _Fast]:
        return {}

    def _of(self, effect: Effect) -> _Fast | None:
        found = self._known.pop(effect, None) or self._build(effect)
        if found is not None:
            self._known[effect] = found  # the newest is last
        if len(self._known) > _KEPT:
            del self._known[next(iter(self._known))]
        return found

    def _build(self, effect: Effect) -> _Fast | None:
        columns = (
            effect.jacobian_in_time(self.time_s) if self._is_here(effect) else None
        )
        if columns is None:
            return None
        size = columns.shape[2]
        flat = columns.reshape(len(columns), -1)
        plain = remove_mean_and_slope(flat, self.cell, self.lag, len(self.line))
        plain = plain.reshape(columns.shape)
        weighted = self.precision[self.cell] @ plain
        return _Fast(effect, plain.reshape(-1, size), weighted.reshape(-1, size))

    def shows(self, effect: Effect) -> bool:
        return (
            self._is_here(effect)
            and effect.jacobian_in_time(self.time_s[:1]) is not None
        )

    def _is_here(self, effect: Effect) -> bool:
        return effect.own_run in (None, self.run)

    def wave(
        self, wave: Wave
    ) -> tuple[NDArray[np.complex128], Float64[np.ndarray, " v"]]:
        """Complex amplitudes of the data and weights at the wave's frequencies.

        Mean and slope of each cell are removed from the wave: it keeps little in a long
        cell.
        """
        arm = wave.arm[0]
        count = np.bincount(self.cell)
        weight = np.einsum("i,cij,j->c", arm, self.precision, arm) * count
        x = np.pi * wave.waves * float(np.median(count)) / self.rate_hz
        mean = np.sinc(x / np.pi)
        slope = np.sqrt(3.0) * (mean - np.cos(x)) / np.maximum(x, 1e-9)
        left = np.maximum(1.0 - mean**2 - slope**2, 0.0)
        found = transform(self.time_s, self.weighted @ arm, wave.waves)
        return found, 0.5 * left * float(weight.sum())

    def squares(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Weighted squares of the deviations, by fold."""
        square = np.einsum("ni,ni->n", self.deviation_mm, self.weighted)
        return np.bincount(self.line[self.cell] % folds, square, folds)

    def freedom(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Degrees of freedom by fold: 3 (samples − 2) a cell."""
        count = np.bincount(self.cell, minlength=len(self.line))
        free = 3.0 * np.maximum(count - 2, 0)
        return np.bincount(self.line % folds, free, folds)


def compute_cell_deviations(
    run: Run, seen: Observations, base: Linearisation
) -> CellDeviations | None:
    """Straight lines only; None if there are too few samples on them."""
    valid = np.zeros(len(run.tracker), bool)
    valid[detect_valid_samples(run.tracker, run.commanded.target)] = True
    around, machine = seen.at.recorded, seen.at.machine
    turning = [machine.axis_names.index(axis.name) for axis in machine.rotary_axes]
    parts: list[CellDeviations] = []
    for number, (first, last) in enumerate(seen.lines):
        line = int(seen.at.line[first])
        is_arc = around is not None and around.rate[first, turning].any()
        if line < 0 or is_arc:  # straight in no cell
            continue
        each = seen.passes[line]
        samples = each.first + np.flatnonzero(valid[each.first : each.last])
        steady = first + np.flatnonzero(~seen.is_ramp[first:last])
        if len(samples) > 3 * len(steady) > 0:
            cells = slice(int(steady[0]), int(steady[-1]) + 1)
            parts.append(_part(run, seen, base, samples, cells, number))
    return _join(parts) if parts else None


def _part(
    run: Run,
    seen: Observations,
    base: Linearisation,
    samples: Int64[np.ndarray, " n"],
    cells: slice,
    number: int,
) -> CellDeviations:
    time_s = run.tracker.device_time_s[samples]
    count = cells.stop - cells.start
    span = float(time_s[-1] - time_s[0]) + 1e-9
    cell = ((time_s - time_s[0]) / span * count).astype(np.int64)
    lag = measure_lag(time_s, cell, count)
    local = run.tracker.position_mm[samples] @ base.pose.rotation
    off = remove_mean_and_slope(local - local[0], cell, lag, count)
    precision = _precision(seen, base, cells)
    size = np.sqrt(np.einsum("ni,nij,nj->n", off, precision[cell], off))
    good = size < _OUTLIER * max(1.0, float(np.median(size)))
    lag = measure_lag(time_s[good], cell[good], count)
    off = remove_mean_and_slope((local - local[0])[good], cell[good], lag, count)
    line = np.full(count, number)
    rate_hz = run.machine.tracker.rate_hz
    return CellDeviations(
        time_s[good], off, cell[good], lag, precision, line, rate_hz, seen.at.run
    )


def _join(blocks: list[CellDeviations]) -> CellDeviations:
    begin = np.cumsum([0, *(len(b.line) for b in blocks[:-1])])
    return CellDeviations(
        np.concatenate([b.time_s for b in blocks]),
        np.concatenate([b.deviation_mm for b in blocks]),
        np.concatenate([b.cell + f for b, f in zip(blocks, begin, strict=True)]),
        np.concatenate([b.lag for b in blocks]),
        np.concatenate([b.precision for b in blocks]),
        np.concatenate([b.line for b in blocks]),
        blocks[0].rate_hz,
        blocks[0].run,
    )


def measure_lag(
    time_s: Float64[np.ndarray, " n"], cell: Int64[np.ndarray, " n"], count: int
) -> Float64[np.ndarray, " n"]:
    """Time from the middle of each cell, its sum of squares 1 there."""
    number = np.maximum(np.bincount(cell, minlength=count), 1)
    origin = time_s - time_s[0]
    lag = origin - (np.bincount(cell, origin, count) / number)[cell]
    square = np.bincount(cell, lag**2, count)
    return lag / np.sqrt(np.maximum(square, 1e-300))[cell]


def remove_mean_and_slope(
    columns: Float64[np.ndarray, "n p"],
    cell: Int64[np.ndarray, " n"],
    lag: Float64[np.ndarray, " n"],
    count: int,
) -> Float64[np.ndarray, "n p"]:
    number = np.maximum(np.bincount(cell, minlength=count), 1)
    left = np.zeros_like(columns)
    for k, column in enumerate(columns.T):
        if not column.any():
            continue
        mean = np.bincount(cell, column, count) / number
        slope = np.bincount(cell, column * lag, count)
        left[:, k] = column - mean[cell] - slope[cell] * lag
    return left


def _precision(
    seen: Observations, base: Linearisation, cells: slice
) -> Float64[np.ndarray, "c 3 3"]:
    tracker_mm = seen.tracker_mm[cells]
    distance = np.linalg.norm(tracker_mm, axis=1)
    sigma = seen.at.machine.tracker.sigma_mm(distance)[:, [0, 1, 1]]
    beam, across = base.noise.white
    sigma = sigma * np.array([beam, across, across])
    frame = beam_frame(tracker_mm) @ base.pose.rotation
    return np.einsum("nki,nk,nkj->nij", frame, sigma**-2, frame)


_FINE, _PADDED = 6, 4  # grid points to the shortest wave, and its length over the data


def transform(
    coordinate: Float64[np.ndarray, " n"],
    data: Float64[np.ndarray, " n"],
    waves: Float64[np.ndarray, " v"],
) -> NDArray[np.complex128]:
    """Σ data exp(−2πi coordinate · wave), by linear weights on a fine grid."""
    first, step = float(coordinate.min()), 1.0 / (_FINE * float(waves.max()))
    place = (coordinate - first) / step
    left = np.floor(place).astype(np.int64)
    size = next_fast_len(_PADDED * (int(left.max()) + 2), real=True)
    part = place - left
    grid = np.bincount(left, data * (1.0 - part), size)
    grid += np.bincount(left + 1, data * part, size)
    found = rfft(grid)
    at_wave = waves * size * step
    index = np.minimum(at_wave.astype(np.int64), len(found) - 2)
    share = at_wave - index
    # Seen from the middle of the data, neighbours differ least in phase.
    middle = int(left.max()) // 2
    turn = middle / size
    value = found[index] * (1.0 - share)
    value += found[index + 1] * np.exp(2j * np.pi * turn) * share
    phase = np.exp(2j * np.pi * (turn * index - (first + middle * step) * waves))
    return np.asarray(value * phase / np.sinc(waves * step) ** 2, np.complex128)


_PLACE_MM = 1.0  # lines meet at one position within this
_BLOCK = 2.0  # knots: longer waves are followed by the error motions
_FEWEST_CELLS = 4  # of a line whose fit is interpolated between cells
_LEAST_SHARE = 0.2  # of a line, along an axis
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


def add_short_wave_variance(found: Estimate, runs: Sequence[Run]) -> Estimate:
    """Adds short-wave axis errors to the covariance; the fit is kept.

    runs : the Run that each Run of the estimate is, or is part of
    """
    lines = [
        line
        for run, fitted, own in zip(
            runs, found.stored_fit.runs, found.runs, strict=True
        )
        for line in _follow_lines(run, fitted.observations, own)
    ]
    extra = np.zeros(len(found.theta))
    for motion in found.model.error_motions:
        if not (is_turn(motion.symbol) or isinstance(motion.axis, RotaryAxis)):
            variance = _compute_variance(motion, found.model.machine.axis_names, lines)
            # Of each parameter, for this mean variance of a position.
            rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, _GRID))
            square = float((rows**2).sum(axis=1).mean())
            extra[found.model.slices[motion.name]] = variance / square
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
    # Imported where it is used: discovery, which does not use it, starts faster.
    from scipy.interpolate import CubicSpline

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


def _compute_variance(
    motion: ErrorMotion, names: Sequence[str], lines: Sequence[_LineRest]
) -> float:
    """Common variance of the lines along the axis, mm²; 0 if it may be chance."""
    number, direction = names.index(motion.axis.name), DIRECTION[motion.symbol[1]]
    block_mm = _BLOCK * compute_spacing(motion)
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
        block = (off / block_mm).astype(np.int64)
        block -= block.min()
        count = int(block.max()) + 1
        lag = measure_lag(off, block, count)
        rest = line.rest_mm[:, [direction]]
        rest = remove_mean_and_slope(rest, block, lag, count)[:, 0]
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
