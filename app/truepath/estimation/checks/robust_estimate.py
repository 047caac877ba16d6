"""Estimate despite disturbances: exclude outliers, or split a Run at a step.

Solve, examine the residuals (`lack_of_fit`), act on the strongest contradiction, solve
again. A step of the tracker's or reflector's place splits one Run into two, each with a
separate pose; a new range offset is one more parameter. Cells and whole lines that the
rest of the measurement contradicts are excluded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Bool

from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.left_out import LeftOut
from truepath.errors import Unidentifiable
from truepath.estimation.checks.lack_of_fit import LackOfFit, assess_misfit
from truepath.estimation.checks.outlier_detection import (
    find_setup_shifts,
    mark_cells_of_lines,
    remove_plainest,
)
from truepath.estimation.checks.run_segments import (
    LEAST_KNOCK_MM,
    RunSegment,
    SetupShift,
    exclude_cells,
    join_empty,
    list_new_offsets,
    list_range_steps,
    measure_setup_shift,
    split_at_all,
)
from truepath.estimation.checks.standstill_outliers import (
    bends_freely,
    find_shifted_stops,
    fit_as_learnt,
    fit_typical_machine,
    is_doubtful,
)
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.prior_effects import PriorEffects
from truepath.estimation.solve.batch import Estimate, estimate
from truepath.estimation.solve.run_estimate import RunEstimate
from truepath.kinematics.coarse_model import RunModels
from truepath.progress import ShareProgress, ignore_progress

_OF_SHIFT = 2.0  # of the gain of the worst line
_ROUNDS, _HIDDEN_ROUNDS = 8, 3


@dataclass(frozen=True, slots=True)
class CheckedEstimate:
    """An estimate, the data excluded from it, and the remaining contradictions.

    given : for each Run of the estimate, the number of the original Run
    left_out : for each original Run; misfits : for each Run of the estimate
    """

    estimate: Estimate
    given: tuple[int, ...]
    left_out: tuple[tuple[LeftOut, ...], ...]
    knocks: tuple[SetupShift, ...]
    misfits: tuple[LackOfFit, ...]

    @property
    def first_parts(self) -> list[RunEstimate]:
        """For each original Run, its estimate before the first step."""
        firsts = [self.given.index(number) for number in range(len(self.left_out))]
        return [self.estimate.runs[k] for k in firsts]


def estimate_checked(
    models: RunModels,
    observed: Sequence[Observations],
    *,
    known: PriorEffects | None = None,
    perpendicular_only: bool = False,
    on_progress: ShareProgress = ignore_progress,
) -> CheckedEstimate:
    """Estimate repeated without what the rest of the measurement contradicts.

    The estimate keeps its fit. Arguments are those of `estimate`. Raises Unidentifiable
    if the lines do not determine the error motions.
    """
    parts = [RunSegment(number, seen) for number, seen in enumerate(observed)]

    def solve(parts: Sequence[RunSegment], begin: float, end: float) -> Estimate:
        return estimate(
            _add_range_steps(models, parts),
            [part.seen for part in parts],
            known=known,
            perpendicular_only=perpendicular_only,
            keep_fit=True,
            given=[part.given for part in parts],
            on_progress=lambda share: on_progress(begin + share * (end - begin)),
        )

    solved = _Solved.of(parts, solve(parts, 0.0, 0.7))
    solved = _split_at_hidden_steps(solved, models, solve)
    solved = _remove_shifted(solved, models, solve)
    solved = _remove_in_turn(solved, solve)
    on_progress(1.0)
    return solved.to_checked_estimate(len(observed))


# Parts of Runs, and the shares of progress at its begin and end.
_Solve = Callable[[Sequence[RunSegment], float, float], Estimate]


@dataclass(frozen=True, slots=True)
class _Solved:
    parts: list[RunSegment]
    found: Estimate
    misfits: tuple[LackOfFit, ...]

    @classmethod
    def of(cls, parts: list[RunSegment], found: Estimate) -> Self:
        fit = _fit_of(found)
        misfits = (assess_misfit(fit, k, names=True) for k in range(len(found.runs)))
        return cls(parts, found, tuple(misfits))

    def to_checked_estimate(self, runs: int) -> CheckedEstimate:
        left_out = [
            [x for part in self.parts if part.given == k for x in part.seen.left_out]
            for k in range(runs)
        ]
        knocks = _list_setup_shifts(self.parts, self.found)
        fit = _fit_of(self.found)
        knocks += list_new_offsets(self.parts, fit.model, fit.result.theta)
        return CheckedEstimate(
            self.found,
            tuple(part.given for part in self.parts),
            tuple(map(tuple, left_out)),
            tuple(sorted(knocks, key=lambda knock: (knock.run, knock.time_s))),
            self.misfits,
        )


def _split_at_hidden_steps(
    solved: _Solved, models: RunModels, solve: _Solve
) -> _Solved:
    """Where points are few, error motions that bend by millimetres can follow a step of
    the set-up, and then nothing contradicts it. A typical machine cannot; the evidence
    decides between both.
    """
    for turn in range(_HIDDEN_ROUNDS):
        fit = _fit_of(solved.found)
        if not bends_freely(fit):
            break
        usual = fit_typical_machine(fit, _list_names(models, solved.parts))
        misfits = [assess_misfit(usual, k, names=True) for k in range(len(fit.runs))]
        if not _has_plain_step(misfits):
            break
        parts = _split(solved, misfits)
        try:
            found = solve(parts, 0.7 + 0.01 * turn, 0.71 + 0.01 * turn)
        except Unidentifiable:
            break
        if _fit_of(found).cost >= fit.cost:
            break
        solved = _Solved.of(parts, found)
    return solved


def _split(solved: _Solved, misfits: Sequence[LackOfFit]) -> list[RunSegment]:
    parts: list[RunSegment] = []
    for part, joined, misfit in zip(
        solved.parts, _list_fitted(solved.found), misfits, strict=True
    ):
        edges = part.seen.find_edges(joined)
        parts += split_at_all(part, find_setup_shifts(misfit), edges, misfit.off_mm)
    return join_empty(parts)


def _add_range_steps(models: RunModels, parts: Sequence[RunSegment]) -> RunModels:
    return models.with_effects(*list_range_steps(parts))


def _list_names(models: RunModels, parts: Sequence[RunSegment]) -> set[str]:
    nested = _add_range_steps(models, parts).nested
    return {effect.name for effect in nested.alone.effects}


def _remove_shifted(solved: _Solved, models: RunModels, solve: _Solve) -> _Solved:
    """Excludes stops that a machine with a typical prior cannot follow."""
    suspects = _find_shifted(solved, models)
    if not suspects:
        return solved
    without = solve(_exclude_lines(solved, suspects), 0.7, 0.75)
    confirmed = _confirm(suspects, without, solved.found)
    if not any(each.any() for each in confirmed):
        return solved
    parts = _exclude_lines(solved, confirmed)
    return _Solved.of(parts, solve(parts, 0.75, 0.8))


def _remove_in_turn(solved: _Solved, solve: _Solve) -> _Solved:
    for turn in range(_ROUNDS):
        fitted = _list_fitted(solved.found)
        fewer = remove_plainest(solved.parts, fitted, solved.misfits)
        if fewer is None:
            break
        try:
            found = solve(fewer, 0.8 + 0.02 * turn, 0.82 + 0.02 * turn)
        except Unidentifiable:
            break  # too few data remain: the verdict reports the contradiction
        solved = _Solved.of(fewer, found)
    return solved


def _fit_of(found: Estimate) -> Fit:
    assert found.fit is not None  # noqa: S101 (it was asked to be kept)
    return found.fit


def _list_fitted(found: Estimate) -> list[Observations]:
    return [run.observations for run in _fit_of(found).runs]


def _has_plain_step(misfits: Sequence[LackOfFit]) -> bool:
    """A step counts only if it explains much more than a shift of any line.

    A line alone can pull the fit with it, which leaves less of the gain to a shift.
    """
    return any(
        step.alone > _OF_SHIFT * float(misfit.line.max(initial=0.0))
        for misfit in misfits
        for step in find_setup_shifts(misfit)
    )


def _find_shifted(solved: _Solved, models: RunModels) -> list[Bool[np.ndarray, " l"]]:
    """The last points of a target look shifted after a step of the set-up if the seats
    of later targets can follow it: then the step has to be found, and the list is
    empty.
    """
    fit = _fit_of(solved.found)
    if not is_doubtful(fit):
        return []
    usual = fit_typical_machine(fit, _list_names(models, solved.parts))
    lines = [find_shifted_stops(usual, k) for k in range(len(fit.runs))]
    if not any(each.any() for each in lines):
        return []
    misfits = [assess_misfit(usual, k) for k in range(len(fit.runs))]
    return [] if _has_plain_step(misfits) else lines


def _confirm(
    suspects: list[Bool[np.ndarray, " l"]], without: Estimate, found: Estimate
) -> list[Bool[np.ndarray, " l"]]:
    """Only the suspects that also contradict the estimate made without them."""
    fit = fit_as_learnt(_fit_of(without), _list_fitted(found))
    return [
        lines & find_shifted_stops(fit, k) if lines.any() else lines
        for k, lines in enumerate(suspects)
    ]


def _exclude_lines(
    solved: _Solved, lines: list[Bool[np.ndarray, " l"]]
) -> list[RunSegment]:
    fewer: list[RunSegment] = []
    for part, fitted, misfit, chosen in zip(
        solved.parts, _list_fitted(solved.found), solved.misfits, lines, strict=True
    ):
        bad = mark_cells_of_lines(misfit, chosen)
        edges = part.seen.find_edges(fitted)
        seen = exclude_cells(part.seen, bad, misfit.off_mm, edges)
        fewer.append(replace(part, seen=seen) if bad.any() else part)
    return fewer


def _list_setup_shifts(parts: list[RunSegment], found: Estimate) -> list[SetupShift]:
    knocks: list[SetupShift] = []
    for k in range(1, len(parts)):
        before, after = parts[k - 1], parts[k]
        if before.given != after.given:
            continue
        poses = found.runs[k - 1].pose, found.runs[k].pose
        middle = 0.5 * (found.runs[k - 1].centre_mm + found.runs[k].centre_mm)
        knock = measure_setup_shift((before, after), poses, middle)
        reach = float(np.ptp(after.seen.at.point_mm, axis=0).max())
        if knock.moved_mm + knock.turned_rad * reach > LEAST_KNOCK_MM:
            knocks.append(knock)  # a smaller step only excludes the cells between
    return knocks
