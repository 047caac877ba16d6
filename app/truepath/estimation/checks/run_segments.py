"""Parts of a Run: without outliers, or before and after steps of the set-up.

A new range offset splits nothing: it is a parameter of all that comes after it. All
excluded data are listed, by line and time.

Outliers are cells and whole lines. Limits are such that a clean measurement of 3 000
cells loses none in 99 of 100; a contradiction that is everywhere is no disturbance, and
is left to the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.reduction import describe_cells
from truepath.alignment.stream.left_out import LeftOut
from truepath.estimation.checks.lack_of_fit import (
    OF_LINE,
    LackOfFit,
    compute_step_limit,
)
from truepath.estimation.checks.score import MEDIAN_OF_THREE, compute_limit
from truepath.estimation.checks.setup_shifts import POSE, RANGE, Step
from truepath.kinematics.effects.instrument import RangeStep
from truepath.kinematics.model import MachineModel
from truepath.numerics.rigid import RigidTransform

LEAST_SETUP_SHIFT_MM = 0.002  # smaller shifts are due to air
_FEWEST_CELLS = 4  # of a line that was cut
_LEAST_SPREAD_MM = 10.0  # root mean square, of points that determine a pose


@dataclass(frozen=True, slots=True)
class RunSegment:
    """Observations of an original Run, or of its part between two steps of the set-up.

    kind : of the step that it begins with; range_steps : found in the Run
    """

    given: int
    seen: Observations
    kind: str = POSE
    range_steps: tuple[RangeStep, ...] = ()


@dataclass(frozen=True, slots=True)
class SetupShift:
    """A step of the set-up, both sides of which were solved.

    run : number of the original Run; row : during or before which it happened
    between_s : times of the last cell before it and the first after it
    moved_mm : shift of the pose at the middle of the measured points; turned_rad : its
        rotation
    kind : `place` or `tilt` of the tracker, `pose` where it is neither alone, or
        `range`: distances are longer by `moved_mm`
    """

    run: int
    row: int
    between_s: tuple[float, float]
    moved_mm: float
    turned_rad: float
    kind: str = POSE

    @property
    def time_s(self) -> float:
        return 0.5 * sum(self.between_s)


def exclude_cells(
    seen: Observations,
    bad: Bool[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
    edges: Int64[np.ndarray, " e"],
) -> Observations:
    """Observations without the bad cells, which are listed in `left_out`.

    bad : mask of the fitted cells; edges : where these begin among those observed
    """
    excluded: list[LeftOut] = []
    sizes = np.diff(edges)
    bad, off_mm = np.repeat(bad, sizes), np.repeat(off_mm, sizes)
    for first, last in seen.lines:
        part = slice(first, last)
        if bad[part].any():
            excluded += describe_cells(
                bad[part],
                seen.at.time_s[part],
                seen.count[part],
                off_mm[part],
                int(seen.row[first]),
            )
    kept = _drop_remnants(seen, np.flatnonzero(~bad))
    left_out = tuple(sorted([*seen.left_out, *excluded], key=_sort_key))
    return replace(kept, used=int(kept.count.sum()), left_out=left_out)


def _drop_remnants(seen: Observations, cells: Int64[np.ndarray, " n"]) -> Observations:
    """Drops lines of which too little remains: phase and speed take two cells.

    Cells on ramps are not timed.
    """
    line, timed = seen.at.line[cells], np.where(seen.is_ramp, -1, seen.at.line)
    count = int(seen.at.line.max(initial=0)) + 2
    own = np.bincount(timed[cells] + 1, minlength=count)
    before = np.bincount(timed + 1, minlength=count)
    whole = (line < 0) | (own == before)[line + 1] | (own >= _FEWEST_CELLS)[line + 1]
    return seen.select(cells[whole])


def _sort_key(each: LeftOut) -> tuple[float, int]:
    return float(np.nan_to_num(each.begin_s)), each.row


def _find_gap(
    seen: Observations, cell: int, edges: Int64[np.ndarray, " e"]
) -> tuple[int, int, float]:
    """Number of cells before a step, first cell after it, and its time. Within a line,
    the cell that may contain the step belongs to neither.

    edges : where the fitted cells begin among those observed
    """
    joined, cell = cell, int(edges[cell])
    within = seen.row[cell] == seen.row[cell - 1] and bool(
        seen.at.line[cell] == seen.at.line[cell - 1]
    )
    before, after = (cell, cell)
    if within and cell not in seen.new_locks:
        before, after = int(edges[joined - 1]), int(edges[joined + 1])
    return before, after, 0.5 * float(seen.at.time_s[cell] + seen.at.time_s[cell - 1])


def add_range_step(
    part: RunSegment, before: int, after: int, time_s: float
) -> RunSegment:
    """Adds a range-offset parameter from `time_s` on.

    before : number of cells before it; after : index of the first cell after it
    """
    seen = part.seen
    kept = _drop_remnants(seen, np.r_[:before, after : len(seen)])
    assert seen.at.recorded is not None  # noqa: S101 (steps have names only there)
    step = RangeStep(seen.at.recorded.set_up, time_s)
    seen = replace(kept, used=int(kept.count.sum()))
    return replace(part, seen=seen, range_steps=(*part.range_steps, step))


def split_at_step(
    part: RunSegment, before: int, after: int, time_s: float
) -> list[RunSegment]:
    """Both sides of a step as separate Runs.

    before : number of cells of the first; after : first cell of the second; time_s :
        excluded data since then belong to the second
    """
    seen = part.seen
    halves = [np.arange(before), np.arange(after, len(seen))]
    found: list[RunSegment] = []
    used = 0
    for number, cells in enumerate(halves):
        some = _drop_remnants(seen, cells)
        count = int(some.count.sum())
        offered = seen.offered - used if number else count
        used += count
        late = (each.begin_s >= time_s for each in seen.left_out)
        excluded = tuple(
            each
            for each, is_late in zip(seen.left_out, late, strict=True)
            if is_late == bool(number)
        )
        own = replace(some, used=count, offered=offered, left_out=excluded)
        found.append(replace(part, seen=own))
    return found


def split_at_all(
    part: RunSegment,
    setup_shifts: Sequence[Step],
    edges: Int64[np.ndarray, " e"],
    off_mm: Float64[np.ndarray, " n"],
) -> list[RunSegment]:
    """Parts before, between and after steps, as separate Runs.

    A new range offset does not end a Run. A part that does not determine a pose loses
    all cells, which are listed.

    off_mm : size of the residuals of the fitted cells
    """
    found = [part]
    for step in reversed(setup_shifts):  # the cells before it keep their numbers
        if edges[step.cell + 1] > len(found[0].seen):
            continue
        gap = _find_gap(found[0].seen, step.cell, edges)
        if step.kind == RANGE:
            found[0] = add_range_step(found[0], *gap)
        else:
            before, after = split_at_step(found[0], *gap)
            found[:1] = [before, replace(after, kind=step.kind)]
    off_mm = np.repeat(off_mm, np.diff(edges))
    time_s = part.seen.at.time_s
    return [
        each if _determines_pose(each.seen) else _exclude_all(each, time_s, off_mm)
        for each in found
    ]


def _exclude_all(
    part: RunSegment,
    time_s: Float64[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
) -> RunSegment:
    seen = part.seen
    off_mm = off_mm[np.searchsorted(time_s, seen.at.time_s)]
    edges = np.arange(len(seen) + 1, dtype=np.int64)
    seen = exclude_cells(seen, np.ones(len(seen), bool), off_mm, edges)
    return replace(part, seen=seen)


def merge_empty(parts: Sequence[RunSegment]) -> list[RunSegment]:
    """Parts that have cells; excluded data of empty parts go to the neighbour.

    A Run without any cell stays as one part.
    """
    found: list[RunSegment] = []
    for part in parts:
        last = found[-1] if found and found[-1].given == part.given else None
        if last is None or (len(last.seen) and len(part.seen)):
            found.append(part)
        else:
            kept = max(last, part, key=lambda each: len(each.seen))
            left_out = sorted([*last.seen.left_out, *part.seen.left_out], key=_sort_key)
            offered = last.seen.offered + part.seen.offered
            seen = replace(kept.seen, offered=offered, left_out=tuple(left_out))
            found[-1] = replace(kept, seen=seen)
    return found


def _determines_pose(seen: Observations) -> bool:
    if len(seen) < _FEWEST_CELLS:
        return False
    away = seen.at.point_mm - seen.at.point_mm.mean(axis=0)
    spread = np.linalg.svd(away, compute_uv=False) / np.sqrt(len(seen))
    return bool(spread[1] > _LEAST_SPREAD_MM)


def measure_setup_shift(
    parts: tuple[RunSegment, RunSegment],
    poses: tuple[RigidTransform, RigidTransform],
    middle_mm: Float64[np.ndarray, "3"],
) -> SetupShift:
    """Shift at `middle_mm` and rotation from the first pose to the second."""
    (before, after), (a, b) = parts, poses
    moved = b.apply(middle_mm[None]) - a.apply(middle_mm[None])
    turned = 0.5 * float(np.linalg.norm(b.rotation @ a.rotation.T - np.eye(3)))
    return SetupShift(
        after.given,
        int(after.seen.row[0]),
        (float(before.seen.at.time_s[-1]), float(after.seen.at.time_s[0])),
        float(np.linalg.norm(moved)),
        turned * float(np.sqrt(2.0)),
        after.kind,
    )


def list_range_steps(parts: Sequence[RunSegment]) -> tuple[RangeStep, ...]:
    """New range offsets without repetition: parts of one Run share them."""
    return tuple(dict.fromkeys(s for part in parts for s in part.range_steps))


def list_new_offsets(
    parts: Sequence[RunSegment], model: MachineModel, theta: Float64[np.ndarray, " p"]
) -> list[SetupShift]:
    """Steps of the range offset that are not small, sized by the solve."""
    setup_shifts: list[SetupShift] = []
    steps = {step: part.given for part in parts for step in part.range_steps}
    for step, given in steps.items():
        seen = [part.seen for part in parts if part.given == given]
        time_s = np.concatenate([each.at.time_s for each in seen])
        row = np.concatenate([each.row for each in seen])
        first = int(np.searchsorted(time_s, step.time_s))
        (size_mm,) = theta[model.slices[step.name]]
        if 0 < first < len(time_s) and abs(size_mm) > LEAST_SETUP_SHIFT_MM:
            between_s = float(time_s[first - 1]), float(time_s[first])
            setup_shifts.append(
                SetupShift(
                    given, int(row[first]), between_s, float(size_mm), 0.0, RANGE
                )
            )
    return setup_shifts


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
        edges = part.seen.compute_edges(joined)
        bad = _mark_bad_cells(misfit)
        setup_shifts = detect_setup_shifts(misfit)
        gain = max((step.alone for step in setup_shifts), default=0.0)
        if setup_shifts and gain > OF_LINE * float(misfit.line.max(initial=0.0)):
            fewer += split_at_all(part, setup_shifts, edges, misfit.off_mm)
        elif bad.any():
            seen = exclude_cells(part.seen, bad, misfit.off_mm, edges)
            fewer.append(replace(part, seen=seen))
        elif setup_shifts:
            fewer += split_at_all(part, setup_shifts, edges, misfit.off_mm)
        else:
            fewer.append(part)
    fewer = merge_empty(fewer)
    same = len(fewer) == len(parts) and all(
        new.seen is old.seen for new, old in zip(fewer, parts, strict=True)
    )
    return None if same else fewer


def detect_setup_shifts(misfit: LackOfFit) -> list[Step]:
    """Steps of the set-up that neither noise nor drift explains.

    All together have to explain much of what noise does not; else a missing effect may
    look like steps.
    """
    limit = compute_step_limit(len(misfit.line)) * misfit.rest
    found = [
        step
        for step in misfit.steps
        if (step.gain > limit or step.kind == RANGE)
        and step.moved_mm > LEAST_SETUP_SHIFT_MM
    ]
    excess = misfit.square - misfit.freedom
    alone = max((step.alone for step in found), default=0.0)
    total_gain = sum(step.gain for step in found)
    if misfit.drift_left < _NO_DRIFT * total_gain:
        return found
    if alone < 0.5 * max((step.gain for step in found), default=0.0):
        return []
    is_most = total_gain > 2.0 * _OF_EXCESS * (excess - misfit.drift)
    return found if alone > _OF_EXCESS * excess or is_most else []


def _mark_bad_cells(misfit: LackOfFit) -> Bool[np.ndarray, " n"]:
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
    reference: Float64[np.ndarray, " m"] | None = None,
    among: int = 0,
) -> Bool[np.ndarray, " n"]:
    """Mask of outliers among squares of three components (χ² of 3, robust scale).

    reference : squares whose median gives the scale; `square` if None
    among : number of tests, if more than these
    """
    reference = square if reference is None else reference
    if not len(square) or not len(reference):
        return np.zeros(len(square), bool)
    scale = max(1.0, float(np.median(reference)) / MEDIAN_OF_THREE)
    limit = _MARGIN * scale * compute_limit(3, max(len(square), among))
    return square > max(limit, _OF_LARGEST * float(square.max()))
