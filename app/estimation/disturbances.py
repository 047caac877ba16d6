"""Estimate although the measurement was disturbed: leave out, or split at a step.

Solve, look at what is left (`misfit`), act on the plainest contradiction, solve again.
A step of the tracker's or reflector's place makes two Runs of one, each with a pose of
its own. Cells and whole lines that the rest of the measurement contradicts are left
out. Limits are such that a clean measurement of 3 000 cells loses none in 99 of 100;
what contradicts everywhere is no disturbance, and is left to the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.special import chdtri

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
from app.estimation.run_parts import (
    Knock,
    RunPart,
    leave_out,
    measure_knock,
    split_at_all,
)
from app.estimation.setup_steps import Step
from app.estimation.usual_machine import (
    find_shifted_stops,
    fit_as_learnt,
    fit_usual_machine,
    is_doubtful,
)
from app.kinematics.coarse_model import RunModels
from app.progress import ShareProgress, ignore_progress

_ROUNDS = 8
_RISK = 0.003  # of a clean measurement, for each kind of test
_MARGIN = 1.5  # noise has longer tails than χ²
_LEAST_MM = 0.002  # of a knock; less is the air's
_OF_EXCESS = 0.25  # of what noise does not explain, that a step has to
_NO_DRIFT = 0.3  # of the gain of steps: a drift explains no more beside them
MOST = 0.2  # of the cells of a Run; more are no disturbance
_OF_LARGEST = 0.05  # of the worst square: smaller ones may be its doing


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
    misfits = _assess(found)
    suspects = _find_shifted(found, models)
    if suspects:
        fewer = _leave_out_lines(parts, suspects, found, misfits)
        confirmed = _confirm(suspects, solve(fewer, 0.7, 0.75), found)
        if any(each.any() for each in confirmed):
            parts = _leave_out_lines(parts, confirmed, found, misfits)
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


def _has_plain_step(misfits: Sequence[Misfit]) -> bool:
    """Tell whether a step of the set-up explains more than a shift of any one line."""
    return any(
        step.alone > float(misfit.line.max(initial=0.0))
        for misfit in misfits
        for step in _find_knocks(misfit)
    )


def _find_shifted(found: Estimate, models: RunModels) -> list[Bool[np.ndarray, " l"]]:
    """Return the stops of each Run that a usual machine cannot follow; or nothing.

    The last points of a target look so after a step of the set-up, if the seats of
    later targets can follow it: then the step is to be found.
    """
    fit = _fit_of(found)
    if not is_doubtful(fit):
        return []
    names = {effect.name for effect in models.nested.alone.effects}
    usual = fit_usual_machine(fit, names)
    lines = [find_shifted_stops(usual, k) for k in range(len(fit.runs))]
    if not any(each.any() for each in lines):
        return []
    misfits = [assess_misfit(usual, k) for k in range(len(fit.runs))]
    return [] if _has_plain_step(misfits) else lines


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
    parts: list[RunPart],
    lines: list[Bool[np.ndarray, " l"]],
    found: Estimate,
    misfits: Sequence[Misfit],
) -> list[RunPart]:
    """Return the parts without some of their lines."""
    fewer: list[RunPart] = []
    for part, fitted, misfit, chosen in zip(
        parts, _list_fitted(found), misfits, lines, strict=True
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
            fewer += split_at_all(part, knocks, edges, misfit.off_mm)
        elif bad.any():
            seen = leave_out(part.seen, bad, misfit.off_mm, edges)
            fewer.append(RunPart(part.given, seen))
        elif knocks:
            fewer += split_at_all(part, knocks, edges, misfit.off_mm)
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
