"""Cells that deviate from their neighbours several times more than noise and machine.

Machine errors are long against a cell, so a cell lies where its neighbours on both
sides lie, their slope included. A deviation from the median of nine by ten times the
tracker's noise, and by more than the rest of the line varies, is no machine error. A
longer stretch shows against the other lines only, once these are solved for.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64
from numpy.lib.stride_tricks import sliding_window_view

from truepath.alignment.observations.reduction import Cells, beam_frame
from truepath.alignment.stream.left_out import LeftOut
from truepath.kinematics.machine.tracker_noise import TrackerNoise

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
    off_mm = _stand_off_mm(cells, expected_mm, tracker)
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
    """Records of excluded cells of one line, one for each stretch."""
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


def _stand_off_mm(
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
    for beside in range(1, _BESIDE):
        for k in {beside, n - 1 - beside}:
            if beside <= k < n - beside:
                median[k] = np.median(rest[k - beside : k + beside + 1], axis=0)
    if n > 2 * _BESIDE:
        windows = sliding_window_view(rest, 2 * _BESIDE + 1, axis=0)
        median[_BESIDE : n - _BESIDE] = np.median(windows, axis=-1)
    return median
