"""Contradictions within a measurement, by the residuals of each of its parts.

Cells and whole lines that are outliers, and steps of the set-up that neither noise nor
drift explains. Limits are such that a clean measurement of 3 000 cells loses none in 99
of 100; a contradiction that is everywhere is no disturbance, and is left to the
verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.special import chdtri

from truepath.alignment.observations.observations import Observations
from truepath.estimation.checks.lack_of_fit import (
    OF_LINE,
    LackOfFit,
    compute_step_limit,
)
from truepath.estimation.checks.run_segments import (
    LEAST_KNOCK_MM,
    RunSegment,
    exclude_cells,
    join_empty,
    split_at_all,
)
from truepath.estimation.checks.setup_shifts import RANGE, Step

_RISK = 0.003  # of a clean measurement, for each kind of test
_MARGIN = 1.5  # noise has longer tails than χ²
_OF_EXCESS = 0.25  # of what noise does not explain, that a step has to
_NO_DRIFT = 0.3  # of the gain of steps: a drift explains no more given them
MOST = 0.2  # of the cells of a Run; more are no disturbance
_OF_LARGEST = 0.05  # of the worst square: smaller ones may be its effect


def remove_plainest(
    parts: Sequence[RunSegment],
    fitted: Sequence[Observations],
    misfits: Sequence[LackOfFit],
) -> list[RunSegment] | None:
    """One round of removal: the strongest contradiction only; None if there is none.

    fitted : the observations of each misfit: cells of the parts, some of them merged
    """
    fewer: list[RunSegment] = []
    for part, joined, misfit in zip(parts, fitted, misfits, strict=True):
        edges = part.seen.find_edges(joined)
        bad = _find_bad_cells(misfit)
        knocks = find_setup_shifts(misfit)
        gain = max((step.alone for step in knocks), default=0.0)
        if knocks and gain > OF_LINE * float(misfit.line.max(initial=0.0)):
            fewer += split_at_all(part, knocks, edges, misfit.off_mm)
        elif bad.any():
            seen = exclude_cells(part.seen, bad, misfit.off_mm, edges)
            fewer.append(replace(part, seen=seen))
        elif knocks:
            fewer += split_at_all(part, knocks, edges, misfit.off_mm)
        else:
            fewer.append(part)
    fewer = join_empty(fewer)
    same = len(fewer) == len(parts) and all(
        new.seen is old.seen for new, old in zip(fewer, parts, strict=True)
    )
    return None if same else fewer


def find_setup_shifts(misfit: LackOfFit) -> list[Step]:
    """Steps of the set-up that neither noise nor drift explains.

    All together have to explain much of what noise does not; else a missing effect may
    look like steps.
    """
    limit = compute_step_limit(len(misfit.line)) * misfit.rest
    found = [
        step
        for step in misfit.steps
        if (step.gain > limit or step.kind == RANGE) and step.moved_mm > LEAST_KNOCK_MM
    ]
    excess = misfit.square - misfit.freedom
    alone = max((step.alone for step in found), default=0.0)
    beside = sum(step.gain for step in found)
    if misfit.drift_left < _NO_DRIFT * beside:
        return found
    if alone < 0.5 * max((step.gain for step in found), default=0.0):
        return []
    is_most = beside > 2.0 * _OF_EXCESS * (excess - misfit.drift)
    return found if alone > _OF_EXCESS * excess or is_most else []


def _find_bad_cells(misfit: LackOfFit) -> Bool[np.ndarray, " n"]:
    """Single cells first; whole lines only if no cell is an outlier."""
    bad = mark_outliers(misfit.cell)
    if not bad.any():
        bad = mark_cells_of_lines(misfit, mark_outliers(misfit.line))
    return bad if bad.mean() < MOST else np.zeros_like(bad)


def mark_cells_of_lines(
    misfit: LackOfFit, lines: Bool[np.ndarray, " l"]
) -> Bool[np.ndarray, " n"]:
    cells = np.zeros(len(misfit.cell), bool)
    for first, last in zip(misfit.begin[lines], misfit.end[lines], strict=True):
        cells[first:last] = True
    return cells


def mark_outliers(
    square: Float64[np.ndarray, " n"],
    usual: Float64[np.ndarray, " m"] | None = None,
    among: int = 0,
) -> Bool[np.ndarray, " n"]:
    """Mask of outliers among squares of three components (χ² of 3, robust scale).

    usual : squares whose median gives the scale; `square` if None
    among : number of tests, if more than these
    """
    usual = square if usual is None else usual
    if not len(square) or not len(usual):
        return np.zeros(len(square), bool)
    scale = max(1.0, float(np.median(usual)) / 2.366)
    limit = _MARGIN * scale * float(chdtri(3, _RISK / max(len(square), among)))
    return square > max(limit, _OF_LARGEST * float(square.max()))
