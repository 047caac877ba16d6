"""Reduce samples to cells: short stretches whose mean keeps all information.

Within a cell the machine error is practically straight, so its mean loses nothing but
the noise. A cell's nominal position is its position on its commanded line by a constant
feed; the phase and speed of that feed are parameters of the solve. The controller's
clock is not used. The nominal motion within a cell is subtracted before the mean and
added after it, so that a cell on an arc lies on the arc.

Machine errors are long against a cell, so a cell lies where its neighbours on both
sides lie, their slope included. A deviation from the median of nine by ten times the
tracker's noise, and by more than the rest of the line varies, is no machine error: such
cells are excluded. A longer stretch shows against the other lines only, once these are
solved for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.lib.stride_tricks import sliding_window_view

from truepath.alignment.stream.left_out import LeftOut
from truepath.kinematics.machine.tracker_noise import TrackerNoise

# The longest cell: in it a machine error is as good as straight, and the air steady.
CELL_MM = 8.0
CELL_S = 0.25
CELL_DEG = 3.0
Way = Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, "n 3"]]
Sigma = Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, "n 2"]]

_ROUNDS = 2  # an outlier may hide another
_OUTLIER = 6.0  # of the samples' own standard deviation


@dataclass(frozen=True, slots=True)
class Cells:
    """Means of the samples of each cell, and the scatter of samples about them.

    time_s : (n,), tracker_mm : (n, 3), count : (n,)
    scatter_square : (2,) sums over samples of squared deviations along and across the
        beam, in units of the specified variance; freedom : (2,) their degrees of
        freedom
    outlier : (samples,) mask of the excluded ones; off_mm : their deviations
    """

    time_s: Float64[np.ndarray, " n"]
    tracker_mm: Float64[np.ndarray, "n 3"]
    count: Float64[np.ndarray, " n"]
    scatter_square: Float64[np.ndarray, "2"]
    freedom: Float64[np.ndarray, "2"]
    outlier: Bool[np.ndarray, " m"]
    off_mm: Float64[np.ndarray, " k"]

    def select(self, kept: Bool[np.ndarray, " n"]) -> Cells:
        """Scatter and outliers stay those of all cells."""
        return replace(
            self,
            time_s=self.time_s[kept],
            tracker_mm=self.tracker_mm[kept],
            count=self.count[kept],
        )


def count_cells(
    span_s: float,
    speed_mm_s: float = 0.0,
    turn_deg_s: float = 0.0,
    cell_mm: float = CELL_MM,
) -> int:
    most = max(1.0 / CELL_S, speed_mm_s / cell_mm, turn_deg_s / CELL_DEG)
    return max(1, int(np.ceil(span_s * most)))


def reduce_to_cells(
    time_s: Float64[np.ndarray, " n"],
    tracker_mm: Float64[np.ndarray, "n 3"],
    way: Way,
    sigma_mm: Sigma,
    cells: int,
) -> Cells:
    """Cut a pass or a standstill into cells of equal time; average.

    way : nominal position of the target at given times, in the tracker's frame, from
        any origin
    sigma_mm : of a sample along and across the beam, at given distances
    """
    span = float(time_s[-1] - time_s[0]) + 1e-9
    cell = ((time_s - time_s[0]) / span * cells).astype(np.int64)
    stretch = _Stretch(time_s, tracker_mm - way(time_s), cell, way, sigma_mm)
    good = np.ones(len(time_s), bool)
    means = stretch.average(good)
    scatter = stretch.scatter(means)
    for _ in range(_ROUNDS):
        limit = _OUTLIER * np.maximum(1.0, 1.4826 * np.median(np.abs(scatter), axis=0))
        inside = (np.abs(scatter) < limit).all(axis=1) & (means.count[cell] > 0)
        if (inside == good).all():
            break
        good = inside
        means = stretch.average(good)
        scatter = stretch.scatter(means)
    off_mm = stretch.off_mm(means, ~good)
    scatter = scatter[good]
    filled = means.count > 0
    free = max(1.0, len(scatter) - 2.0 * float(filled.sum()))
    square = (scatter**2).sum(axis=0)
    return Cells(
        means.time_s[filled],
        means.tracker_mm[filled],
        means.count[filled],
        np.array([square[0], square[1] + square[2]]),
        np.array([free, 2.0 * free]),
        ~good,
        off_mm,
    )


@dataclass(frozen=True, slots=True)
class _Means:
    """`rest_mm` without the nominal motion, `tracker_mm` with it."""

    time_s: Float64[np.ndarray, " c"]
    rest_mm: Float64[np.ndarray, "c 3"]
    tracker_mm: Float64[np.ndarray, "c 3"]
    count: Float64[np.ndarray, " c"]


@dataclass(frozen=True, slots=True)
class _Stretch:
    time_s: Float64[np.ndarray, " n"]
    rest_mm: Float64[np.ndarray, "n 3"]
    cell: Int64[np.ndarray, " n"]
    way: Way
    sigma_mm: Sigma

    def average(self, good: Bool[np.ndarray, " n"]) -> _Means:
        cell, size = self.cell, int(self.cell[-1]) + 1
        weight = good.astype(np.float64)
        count = np.bincount(cell, weight, size)
        safe = np.maximum(count, 1.0)
        # About the first sample, so that sums keep their digits.
        origin_s, origin_mm = self.time_s[0], self.rest_mm[0]
        lag, off = self.time_s - origin_s, self.rest_mm - origin_mm
        time = np.bincount(cell, weight * lag, size) / safe + origin_s
        total = np.column_stack([np.bincount(cell, weight * o, size) for o in off.T])
        rest = total / safe[:, None] + origin_mm
        return _Means(time, rest, rest + self.way(time), count)

    def off_mm(
        self, means: _Means, which: Bool[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " k"]:
        off = self.rest_mm[which] - means.rest_mm[self.cell[which]]
        return np.linalg.norm(off, axis=1)

    def scatter(self, means: _Means) -> Float64[np.ndarray, "n 3"]:
        """Deviation of each sample from its cell, in sigmas along the beam frame."""
        cell = self.cell
        lag = self.time_s - means.time_s[cell]
        off = self.rest_mm - means.rest_mm[cell]
        # Along a line the machine error changes within a cell; that is not noise.
        square = np.bincount(cell, lag**2)
        across = np.column_stack([np.bincount(cell, lag * o) for o in off.T])
        off -= lag[:, None] * (across / np.maximum(square, 1e-12)[:, None])[cell]
        distance = np.linalg.norm(means.tracker_mm, axis=1)
        sigma = self.sigma_mm(distance)[:, [0, 1, 1]]
        frame = beam_frame(means.tracker_mm) / sigma[:, :, None]
        return np.einsum("nij,nj->ni", frame[cell], off)


def beam_frame(tracker_mm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """(n, 3, 3), rows: unit beam, azimuth, elevation in the tracker's frame."""
    beam = tracker_mm / np.linalg.norm(tracker_mm, axis=1, keepdims=True)
    azimuth = np.cross(np.array([0.0, 0.0, 1.0]), beam)
    flat = np.linalg.norm(azimuth, axis=1, keepdims=True)
    azimuth = np.where(flat > 1e-9, azimuth / np.maximum(flat, 1e-9), [1.0, 0.0, 0.0])
    return np.stack([beam, azimuth, np.cross(beam, azimuth)], axis=1)


USUAL_OU = 0.15  # correlated part of the specified noise: hall and tracker
_BESIDE = 4  # cells on either side
_LIMIT = 10.0  # standard deviations of a cell
_LEAST_MM = 0.01  # smaller deviations are left to the solve


def exclude_cells(
    cells: Cells,
    expected_mm: Float64[np.ndarray, "n 3"],
    tracker: TrackerNoise,
    row: int,
) -> tuple[Cells, list[LeftOut]]:
    """The cells consistent with their neighbours, and a description of the others.

    expected_mm : expected positions, from any origin, in the tracker's frame
    """
    off_mm = _measure_deviation_mm(cells, expected_mm, tracker)
    bad = off_mm > 0.0
    if not bad.any():
        return cells, []
    return cells.select(~bad), describe_cells(
        bad, cells.time_s, cells.count, off_mm, row
    )


def describe_cells(
    bad: Bool[np.ndarray, " n"],
    time_s: Float64[np.ndarray, " n"],
    count: Float64[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
    row: int,
) -> list[LeftOut]:
    inside = np.flatnonzero(bad)
    half = 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return [
        LeftOut(
            "line" if bad.all() else "cells",
            row,
            float(time_s[part[0]]) - half,
            float(time_s[part[-1]]) + half,
            int(count[part].sum()),
            float(off_mm[part].max()),
        )
        for part in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    ]


def _measure_deviation_mm(
    cells: Cells, expected_mm: Float64[np.ndarray, "n 3"], tracker: TrackerNoise
) -> Float64[np.ndarray, " n"]:
    n = len(cells.time_s)
    if n < 3:
        return np.zeros(n)
    rest = cells.tracker_mm - expected_mm
    frame, aside = beam_frame(cells.tracker_mm), rest - _median_of_neighbours(rest)
    away = np.abs(np.einsum("nij,nj->ni", frame, aside))
    stated = tracker.sigma_mm(np.linalg.norm(cells.tracker_mm, axis=1))[:, [0, 1, 1]]
    known = stated * np.sqrt(1.0 / cells.count[:, None] + USUAL_OU**2)
    varies = 1.4826 * np.median(away, axis=0)
    limit = np.maximum(_LIMIT * np.maximum(known, varies), _LEAST_MM)
    size = np.linalg.norm(away, axis=1)
    return np.where((away > limit).any(axis=1), size, 0.0)


def _median_of_neighbours(
    rest: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n 3"]:
    n = len(rest)
    median = rest.copy()
    for reach in range(1, _BESIDE):
        for k in {reach, n - 1 - reach}:
            if reach <= k < n - reach:
                median[k] = np.median(rest[k - reach : k + reach + 1], axis=0)
    if n > 2 * _BESIDE:
        windows = sliding_window_view(rest, 2 * _BESIDE + 1, axis=0)
        median[_BESIDE : n - _BESIDE] = np.median(windows, axis=-1)
    return median
