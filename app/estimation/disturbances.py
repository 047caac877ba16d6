"""Estimate although the measurement was disturbed: leave out, or split at a step.

Solve, look at what is left (`misfit`), act on the plainest contradiction, solve again.
A step of the tracker's or reflector's place makes two Runs of one, each with a pose of
its own. Cells and whole lines that the rest of the measurement contradicts are left
out. Limits are such that a clean measurement of 3 000 cells loses none in 99 of 100;
what contradicts everywhere is no disturbance, and is left to the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.special import chdtri

from app.alignment.cell_gate import describe_cells
from app.alignment.left_out import LeftOut
from app.alignment.observations import Observations
from app.errors import Unidentifiable
from app.estimation.batch import Estimate, RunEstimate, estimate
from app.estimation.direction import Fit
from app.estimation.known_effects import KnownEffects
from app.estimation.misfit import (
    OF_LINE,
    Misfit,
    assess_misfit,
    compute_step_limit,
)
from app.estimation.setup_steps import Step
from app.estimation.usual_machine import (
    find_shifted_stops,
    fit_as_learnt,
    fit_usual_machine,
    is_doubtful,
)
from app.kinematics.coarse_model import RunModels
from app.numerics.rigid import RigidTransform
from app.progress import ShareProgress, ignore_progress

_ROUNDS = 8
_RISK = 0.003  # of a clean measurement, for each kind of test
_MARGIN = 1.5  # noise has longer tails than χ²
_LEAST_MM = 0.002  # of a knock; less is the air's
_OF_EXCESS = 0.25  # of what noise does not explain, that a step has to
_NO_DRIFT = 0.3  # of the gain of steps: a drift explains no more beside them
MOST = 0.2  # of the cells of a Run; more are no disturbance
_FEWEST_CELLS = 4  # of a line that was cut
_LEAST_SPREAD_MM = 10.0  # root mean square, of points that tell a pose
_OF_LARGEST = 0.05  # of the worst square: smaller ones may be its doing


@dataclass(frozen=True, slots=True)
class Knock:
    """A step of the place of tracker or reflector, both sides of which were solved.

    run : of those given; row : on the way to which, or at which, it happened
    moved_mm : of the pose, at the middle of the measured points; turned_rad : likewise
    """

    run: int
    row: int
    time_s: float
    moved_mm: float
    turned_rad: float


@dataclass(frozen=True, slots=True)
class CheckedEstimate:
    """An estimate, what was left out for it, and what contradicts it still.

    given : of each Run of the estimate, the Run given that it is of
    left_out : of each Run given; misfits : of each Run of the estimate
    """

    estimate: Estimate
    given: tuple[int, ...]
    left_out: tuple[tuple[LeftOut, ...], ...]
    knocks: tuple[Knock, ...]
    misfits: tuple[Misfit, ...]

    @property
    def first_parts(self) -> list[RunEstimate]:
        """What is estimated of each Run given, before its first knock."""
        firsts = [self.given.index(number) for number in range(len(self.left_out))]
        return [self.estimate.runs[k] for k in firsts]


@dataclass(frozen=True, slots=True)
class RunPart:
    """Observations of a Run given, or of its part between two knocks."""

    given: int
    seen: Observations


def estimate_checked(
    models: RunModels,
    observed: Sequence[Observations],
    *,
    known: KnownEffects | None = None,
    perpendicular_only: bool = False,
    on_progress: ShareProgress = ignore_progress,
) -> CheckedEstimate:
    """Estimate, and again without what the rest of the measurement contradicts.

    The estimate keeps what it was solved from. Arguments are those of `estimate`.
    Raises Unidentifiable if the lines do not determine the error motions.
    """
    parts = [RunPart(number, seen) for number, seen in enumerate(observed)]

    def solve(parts: list[RunPart], begin: float, end: float) -> Estimate:
        return estimate(
            models,
            [part.seen for part in parts],
            known=known,
            perpendicular_only=perpendicular_only,
            keep_fit=True,
            on_progress=lambda share: on_progress(begin + share * (end - begin)),
        )

    found = solve(parts, 0.0, 0.7)
    suspects = _find_shifted(found, models)
    if suspects:
        without = solve(_leave_out_lines(parts, suspects, found), 0.7, 0.75)
        confirmed = _confirm(suspects, without, found)
        if any(each.any() for each in confirmed):
            parts = _leave_out_lines(parts, confirmed, found)
            found = solve(parts, 0.75, 0.8)
    misfits = _assess(found)
    for turn in range(_ROUNDS):
        fewer = remove_plainest(parts, _list_fitted(found), misfits)
        if fewer is None:
            break
        try:
            found = solve(fewer, 0.8 + 0.02 * turn, 0.82 + 0.02 * turn)
        except Unidentifiable:
            break  # too little is left: the verdict says what contradicts
        parts = fewer
        misfits = _assess(found)
    on_progress(1.0)
    return CheckedEstimate(
        found,
        tuple(part.given for part in parts),
        tuple(
            tuple(x for part in parts if part.given == k for x in part.seen.left_out)
            for k in range(len(observed))
        ),
        tuple(_list_knocks(parts, found)),
        misfits,
    )


def _fit_of(found: Estimate) -> Fit:
    assert found.fit is not None  # noqa: S101 (it was asked to be kept)
    return found.fit


def _assess(found: Estimate) -> tuple[Misfit, ...]:
    return tuple(assess_misfit(_fit_of(found), k) for k in range(len(found.runs)))


def _list_fitted(found: Estimate) -> list[Observations]:
    return [run.observations for run in _fit_of(found).runs]


def _find_shifted(found: Estimate, models: RunModels) -> list[Bool[np.ndarray, " l"]]:
    """Return the stops of each Run that a usual machine cannot follow; or nothing."""
    fit = _fit_of(found)
    if not is_doubtful(fit):
        return []
    names = {effect.name for effect in models.nested.alone.effects}
    usual = fit_usual_machine(fit, names)
    lines = [find_shifted_stops(usual, k) for k in range(len(fit.runs))]
    return lines if any(each.any() for each in lines) else []


def _confirm(
    suspects: list[Bool[np.ndarray, " l"]], without: Estimate, found: Estimate
) -> list[Bool[np.ndarray, " l"]]:
    """Return the suspects that contradict what is learnt without them."""
    fit = fit_as_learnt(_fit_of(without), _list_fitted(found))
    return [
        lines & find_shifted_stops(fit, k) if lines.any() else lines
        for k, lines in enumerate(suspects)
    ]


def _leave_out_lines(
    parts: list[RunPart], lines: list[Bool[np.ndarray, " l"]], found: Estimate
) -> list[RunPart]:
    """Return the parts without some of their lines."""
    fewer: list[RunPart] = []
    for part, fitted, misfit, chosen in zip(
        parts, _list_fitted(found), _assess(found), lines, strict=True
    ):
        bad = _spread_over_cells(misfit, chosen)
        edges = part.seen.find_edges(fitted)
        seen = leave_out(part.seen, bad, misfit.off_mm, edges)
        fewer.append(RunPart(part.given, seen) if bad.any() else part)
    return fewer


def remove_plainest(
    parts: Sequence[RunPart],
    fitted: Sequence[Observations],
    misfits: Sequence[Misfit],
) -> list[RunPart] | None:
    """Return the parts without the plainest contradiction; None where there is none.

    fitted : what the misfits are of: cells of the parts, some of them joined
    """
    fewer: list[RunPart] = []
    for part, joined, misfit in zip(parts, fitted, misfits, strict=True):
        edges = part.seen.find_edges(joined)
        bad = _find_bad_cells(misfit)
        knocks = _find_knocks(misfit)
        gain = max((step.alone for step in knocks), default=0.0)
        if knocks and gain > OF_LINE * float(misfit.line.max(initial=0.0)):
            fewer += _split_at_all(part, knocks, edges, misfit)
        elif bad.any():
            seen = leave_out(part.seen, bad, misfit.off_mm, edges)
            fewer.append(RunPart(part.given, seen))
        elif knocks:
            fewer += _split_at_all(part, knocks, edges, misfit)
        else:
            fewer.append(part)
    same = len(fewer) == len(parts) and all(
        new.seen is old.seen for new, old in zip(fewer, parts, strict=True)
    )
    return None if same else fewer


def _find_knocks(misfit: Misfit) -> list[Step]:
    """Return the steps that neither noise nor drift explains.

    All together explain much of what noise does not; else an effect that the model
    lacks may look like steps.
    """
    limit = compute_step_limit(len(misfit.line)) * misfit.rest
    found = [
        step for step in misfit.steps if step.gain > limit and step.moved_mm > _LEAST_MM
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


def _find_bad_cells(misfit: Misfit) -> Bool[np.ndarray, " n"]:
    """Tell which cells, or else which whole lines, the others contradict."""
    bad = stand_out(misfit.cell)
    if not bad.any():
        bad = _spread_over_cells(misfit, stand_out(misfit.line))
    return bad if bad.mean() < MOST else np.zeros_like(bad)


def _spread_over_cells(
    misfit: Misfit, lines: Bool[np.ndarray, " l"]
) -> Bool[np.ndarray, " n"]:
    cells = np.zeros(len(misfit.cell), bool)
    for first, last in zip(misfit.begin[lines], misfit.end[lines], strict=True):
        cells[first:last] = True
    return cells


def stand_out(
    square: Float64[np.ndarray, " n"],
    usual: Float64[np.ndarray, " m"] | None = None,
    among: int = 0,
) -> Bool[np.ndarray, " n"]:
    """Tell which squares of three components are too large.

    usual : squares whose median is that of noise; these where left out
    among : how many are tested; these where there are more
    """
    usual = square if usual is None else usual
    if not len(square) or not len(usual):
        return np.zeros(len(square), bool)
    scale = max(1.0, float(np.median(usual)) / 2.366)
    limit = _MARGIN * scale * float(chdtri(3, _RISK / max(len(square), among)))
    return square > max(limit, _OF_LARGEST * float(square.max()))


def leave_out(
    seen: Observations,
    bad: Bool[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
    edges: Int64[np.ndarray, " e"],
) -> Observations:
    """Return observations without some cells, and with what is said of these.

    bad : of those that were fitted; edges : where they begin among those seen
    """
    said: list[LeftOut] = []
    sizes = np.diff(edges)
    bad, off_mm = np.repeat(bad, sizes), np.repeat(off_mm, sizes)
    for first, last in seen.lines:
        part = slice(first, last)
        if bad[part].any():
            said += describe_cells(
                bad[part],
                seen.at.time_s[part],
                seen.count[part],
                off_mm[part],
                int(seen.row[first]),
            )
    kept = _drop_remnants(seen, np.flatnonzero(~bad))
    left_out = tuple(sorted([*seen.left_out, *said], key=_order))
    return replace(kept, used=int(kept.count.sum()), left_out=left_out)


def _drop_remnants(seen: Observations, cells: Int64[np.ndarray, " n"]) -> Observations:
    """Return some of the cells, without lines of which too little is left.

    Phase and speed of a line take two cells; what they leave of few tells nothing.
    Cells on ramps are not timed.
    """
    line, timed = seen.at.line[cells], np.where(seen.is_ramp, -1, seen.at.line)
    count = int(seen.at.line.max(initial=0)) + 2
    own = np.bincount(timed[cells] + 1, minlength=count)
    before = np.bincount(timed + 1, minlength=count)
    whole = (line < 0) | (own == before)[line + 1] | (own >= _FEWEST_CELLS)[line + 1]
    return seen.select(cells[whole])


def _order(each: LeftOut) -> tuple[float, int]:
    return float(np.nan_to_num(each.begin_s)), each.row


def split(part: RunPart, cell: int, edges: Int64[np.ndarray, " e"]) -> list[RunPart]:
    """Return what is before a step at a cell, and what is after it, as two Runs.

    Where it is within a line, the cell that it may be in belongs to neither.
    edges : where the cells that were fitted begin among those of the part
    """
    seen, joined, cell = part.seen, cell, int(edges[cell])
    within = seen.row[cell] == seen.row[cell - 1] and bool(
        seen.at.line[cell] == seen.at.line[cell - 1]
    )
    before, after = (cell, cell)
    if within:
        before, after = int(edges[joined - 1]), int(edges[joined + 1])
    halves = [np.arange(before), np.arange(after, len(seen))]
    time_s = 0.5 * float(seen.at.time_s[cell] + seen.at.time_s[cell - 1])
    found: list[RunPart] = []
    used = 0
    for number, cells in enumerate(halves):
        some = _drop_remnants(seen, cells)
        count = int(some.count.sum())
        offered = seen.offered - used if number else count
        used += count
        late = (each.begin_s >= time_s for each in seen.left_out)
        said = tuple(
            each
            for each, is_late in zip(seen.left_out, late, strict=True)
            if is_late == bool(number)
        )
        own = replace(some, used=count, offered=offered, left_out=said)
        found.append(RunPart(part.given, own))
    return found


def _split_at_all(
    part: RunPart, knocks: list[Step], edges: Int64[np.ndarray, " e"], misfit: Misfit
) -> list[RunPart]:
    """Return what is before, between and after knocks, as Runs of their own."""
    found = [part]
    off_mm = np.repeat(misfit.off_mm, np.diff(edges))
    for step in reversed(knocks):  # the cells before it keep their numbers
        if edges[step.cell + 1] <= len(found[0].seen):
            halves = split(found[0], step.cell, edges)
            found[:1] = _join_scraps(halves, part.seen.at.time_s, off_mm)
    return found


def _join_scraps(
    halves: list[RunPart],
    time_s: Float64[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
) -> list[RunPart]:
    """Return the halves of which a pose can be told; what is of the others is said.

    time_s, off_mm : of the cells of both, how far they lie aside
    """
    kept = [part for part in halves if _tells_pose(part.seen)]
    halves = [part for part in halves if len(part.seen)]
    if len(kept) != 1:
        return halves
    scraps = [part.seen for part in halves if part is not kept[0]]
    if not scraps:
        return kept
    (scrap,) = scraps
    off_mm = off_mm[np.searchsorted(time_s, scrap.at.time_s)]
    said = [
        describe_cells(
            np.ones(last - first, bool),
            scrap.at.time_s[first:last],
            scrap.count[first:last],
            off_mm[first:last],
            int(scrap.row[first]),
        )[0]
        for first, last in scrap.lines
    ]
    seen = kept[0].seen
    left_out = sorted([*seen.left_out, *scrap.left_out, *said], key=_order)
    offered = seen.offered + scrap.offered
    return [
        RunPart(kept[0].given, replace(seen, offered=offered, left_out=tuple(left_out)))
    ]


def _tells_pose(seen: Observations) -> bool:
    """Tell whether points lie on no straight line."""
    if len(seen) < _FEWEST_CELLS:
        return False
    away = seen.at.point_mm - seen.at.point_mm.mean(axis=0)
    spread = np.linalg.svd(away, compute_uv=False) / np.sqrt(len(seen))
    return bool(spread[1] > _LEAST_SPREAD_MM)


def _list_knocks(parts: list[RunPart], found: Estimate) -> list[Knock]:
    """Return the steps between parts of one Run, as large as the solve finds them."""
    knocks: list[Knock] = []
    for k in range(1, len(parts)):
        before, after = parts[k - 1], parts[k]
        if before.given != after.given:
            continue
        poses = found.runs[k - 1].pose, found.runs[k].pose
        middle = 0.5 * (found.runs[k - 1].centre_mm + found.runs[k].centre_mm)
        knock = measure_knock((before, after), poses, middle)
        reach = float(np.ptp(after.seen.at.point_mm, axis=0).max())
        if knock.moved_mm + knock.turned_rad * reach > _LEAST_MM:
            knocks.append(knock)  # else what was between is left out, and all as before
    return knocks


def measure_knock(
    parts: tuple[RunPart, RunPart],
    poses: tuple[RigidTransform, RigidTransform],
    middle_mm: Float64[np.ndarray, "3"],
) -> Knock:
    """Return the step between the poses before and after it."""
    (before, after), (a, b) = parts, poses
    moved = b.apply(middle_mm[None]) - a.apply(middle_mm[None])
    turned = 0.5 * float(np.linalg.norm(b.rotation @ a.rotation.T - np.eye(3)))
    return Knock(
        after.given,
        int(after.seen.row[0]),
        0.5 * float(before.seen.at.time_s[-1] + after.seen.at.time_s[0]),
        float(np.linalg.norm(moved)),
        turned * float(np.sqrt(2.0)),
    )
