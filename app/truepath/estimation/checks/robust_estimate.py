"""Estimate despite disturbances: exclude outliers, or split a Run at a step.

Solve, examine the residuals (`lack_of_fit`), act on the strongest contradiction, solve
again. A step of the tracker's or reflector's place splits one Run into two, each with a
separate pose; a new range offset is one more parameter. Cells and whole lines that the
rest of the measurement contradicts are excluded.

Precisions of the prior, noise and the direction of approach are learnt from all data,
wrong data included. One standstill that is 20 µm off lets error motions bend until it
fits, and then nothing contradicts it. A machine that bends as typical, and whose
direction of approach does not matter, cannot follow it: the standstill then shows a
separate shift (score test, Rao 1948), conditional on those of others. Whether the
machine is typical is unknown: standstills are excluded only if they also contradict
what is learnt without them. Lines have many cells, which show where one of them is
wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Bool, Float64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.left_out import LeftOut
from truepath.errors import Unidentifiable
from truepath.estimation.checks.lack_of_fit import (
    LackOfFit,
    assess_lack_of_fit,
    free_range_offset,
)
from truepath.estimation.checks.run_segments import (
    LEAST_SETUP_SHIFT_MM,
    RunSegment,
    SetupShift,
    detect_setup_shifts,
    exclude_cells,
    list_new_offsets,
    list_range_steps,
    mark_cells_of_lines,
    measure_setup_shift,
    merge_empty,
    remove_plainest,
    split_at_all,
)
from truepath.estimation.checks.score import (
    MEDIAN_OF_THREE,
    compute_limit,
    compute_score,
)
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import compute_posterior
from truepath.estimation.problem.noise import cap_correlated_noise
from truepath.estimation.problem.normal_equations import RunInput, collect_information
from truepath.estimation.problem.prior import guess_prior
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.estimation.solve.batch import Estimate, RunEstimate, estimate
from truepath.kinematics.coarse_model import RunModels
from truepath.numerics.scaled_cholesky import ScaledCholesky
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
    setup_shifts: tuple[SetupShift, ...]
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
            models.with_effects(*list_range_steps(parts)),
            [part.seen for part in parts],
            known=known,
            perpendicular_only=perpendicular_only,
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
        fit = found.stored_fit
        misfits = (
            assess_lack_of_fit(fit, k, names=True) for k in range(len(found.runs))
        )
        return cls(parts, found, tuple(misfits))

    def to_checked_estimate(self, runs: int) -> CheckedEstimate:
        left_out = [
            [x for part in self.parts if part.given == k for x in part.seen.left_out]
            for k in range(runs)
        ]
        setup_shifts = _list_setup_shifts(self.parts, self.found)
        fit = self.found.stored_fit
        setup_shifts += list_new_offsets(self.parts, fit.model, fit.result.theta)
        return CheckedEstimate(
            self.found,
            tuple(part.given for part in self.parts),
            tuple(map(tuple, left_out)),
            tuple(
                sorted(
                    setup_shifts,
                    key=lambda shift: (shift.run, shift.time_s),
                )
            ),
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
        fit = solved.found.stored_fit
        if not _bends_freely(fit):
            break
        typical = _fit_typical_machine(fit, _list_names(models, solved.parts))
        misfits = [
            assess_lack_of_fit(typical, k, names=True) for k in range(len(fit.runs))
        ]
        if not _has_plain_step(misfits):
            break
        parts = _split(solved, misfits)
        try:
            found = solve(parts, 0.7 + 0.01 * turn, 0.71 + 0.01 * turn)
        except Unidentifiable:
            break
        if found.stored_fit.cost >= fit.cost:
            break
        solved = _Solved.of(parts, found)
    return solved


def _split(solved: _Solved, misfits: Sequence[LackOfFit]) -> list[RunSegment]:
    parts: list[RunSegment] = []
    for part, joined, misfit in zip(
        solved.parts, _list_fitted(solved.found), misfits, strict=True
    ):
        edges = part.seen.compute_edges(joined)
        parts += split_at_all(part, detect_setup_shifts(misfit), edges, misfit.off_mm)
    return merge_empty(parts)


def _list_names(models: RunModels, parts: Sequence[RunSegment]) -> set[str]:
    nested = models.with_effects(*list_range_steps(parts)).nested
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


def _list_fitted(found: Estimate) -> list[Observations]:
    return [run.observations for run in found.stored_fit.runs]


def _has_plain_step(misfits: Sequence[LackOfFit]) -> bool:
    """A step counts only if it explains much more than a shift of any line.

    A line alone can pull the fit with it, which leaves less of the gain to a shift.
    """
    return any(
        step.alone > _OF_SHIFT * float(misfit.line.max(initial=0.0))
        for misfit in misfits
        for step in detect_setup_shifts(misfit)
    )


def _find_shifted(solved: _Solved, models: RunModels) -> list[Bool[np.ndarray, " l"]]:
    """The last points of a target look shifted after a step of the set-up if the seats
    of later targets can follow it: then the step has to be found, and the list is
    empty.
    """
    fit = solved.found.stored_fit
    if not _bends_freely(fit) and fit.direction == "none":
        return []  # no wrong point has bent the motions
    typical = _fit_typical_machine(fit, _list_names(models, solved.parts))
    lines = [_find_shifted_stops(typical, k) for k in range(len(fit.runs))]
    if not any(each.any() for each in lines):
        return []
    misfits = [assess_lack_of_fit(typical, k) for k in range(len(fit.runs))]
    return [] if _has_plain_step(misfits) else lines


def _confirm(
    suspects: list[Bool[np.ndarray, " l"]], without: Estimate, found: Estimate
) -> list[Bool[np.ndarray, " l"]]:
    """Only the suspects that also contradict the estimate made without them."""
    fit = without.stored_fit
    inputs = [
        RunInput(each, run.linearisation.pose, run.noise)
        for each, run in zip(_list_fitted(found), fit.runs, strict=True)
    ]
    fit = _solve_again(replace(fit, runs=collect_information(inputs, fit.model)))
    return [
        lines & _find_shifted_stops(fit, k) if lines.any() else lines
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
        edges = part.seen.compute_edges(fitted)
        seen = exclude_cells(part.seen, bad, misfit.off_mm, edges)
        fewer.append(replace(part, seen=seen) if bad.any() else part)
    return fewer


def _list_setup_shifts(parts: list[RunSegment], found: Estimate) -> list[SetupShift]:
    setup_shifts: list[SetupShift] = []
    for k in range(1, len(parts)):
        before, after = parts[k - 1], parts[k]
        if before.given != after.given:
            continue
        poses = found.runs[k - 1].pose, found.runs[k].pose
        middle = 0.5 * (found.runs[k - 1].centre_mm + found.runs[k].centre_mm)
        shift = measure_setup_shift((before, after), poses, middle)
        reach = float(np.ptp(after.seen.at.point_mm, axis=0).max())
        if shift.moved_mm + shift.turned_rad * reach > LEAST_SETUP_SHIFT_MM:
            setup_shifts.append(shift)  # a smaller step only excludes the cells between
    return setup_shifts


_UNUSUAL = 0.1  # of the typical precision of bending
_FEW_CELLS = 1000  # fewer may be dominated by a few wrong ones
_MARGIN = 2.0  # noise has longer tails than χ²
_MOST = 0.1  # of the lines


def _bends_freely(fit: Fit) -> bool:
    """True if error motions bend more than typical, or there are few cells."""
    typical, found = guess_prior(fit.model).precision, fit.prior.precision
    is_weak = any(found[name] < _UNUSUAL * typical[name] for name in typical)
    return is_weak or sum(len(run.observations) for run in fit.runs) < _FEW_CELLS


def _fit_typical_machine(fit: Fit, effects: Collection[str]) -> Fit:
    """Data of a fit, solved again with the typical prior.

    effects : names of those kept, without the direction of approach
    """
    kept = tuple(effect for effect in fit.model.effects if effect.name in effects)
    model = replace(fit.model, effects=kept)
    runs = tuple(run.restrict(kept) for run in fit.found)
    return _solve_again(replace(fit, model=model, runs=runs, prior=guess_prior(model)))


def _solve_again(fit: Fit) -> Fit:
    precision = fit.prior.precision_matrix(fit.model.size)
    return replace(fit, result=compute_posterior(fit.data, precision))


def _find_shifted_stops(fit: Fit, number: int) -> Bool[np.ndarray, " l"]:
    """Mask of the standstills, among all lines of a Run, that need a separate shift.

    The largest first, the others conditional on it; scaled by the median over the
    lines.
    """
    seen = fit.runs[number].observations
    moves = np.array([seen.at.line[first] >= 0 for first, _ in seen.lines])
    lines = len(moves)
    if moves.all():
        return np.zeros(lines, bool)
    left, raw, pulled = _list_shifts(fit, number)
    limit = _MARGIN * compute_limit(3, lines)
    found = np.zeros(lines, bool)
    own = np.arange(lines)
    for _ in range(int(_MOST * lines)):
        gain = np.sum(compute_score(left[own, :, own], raw, pulled)[1] ** 2, axis=1)
        scale = max(1.0, float(np.median(gain)) / MEDIAN_OF_THREE)
        gain[found | moves] = 0.0
        best = int(np.argmax(gain))
        if gain[best] < limit * scale:
            return found
        found[best] = True
        left, pulled = _condition_on(left, pulled, best)
    return np.zeros(lines, bool)  # more than a few: no wrong points


def _condition_on(
    left: Float64[np.ndarray, "l 3 l 3"], pulled: Float64[np.ndarray, "l 3"], one: int
) -> tuple[Float64[np.ndarray, "l 3 l 3"], Float64[np.ndarray, "l 3"]]:
    shared = left[:, :, one]
    share = shared @ np.linalg.pinv(left[one, :, one], hermitian=True)
    return (
        left - np.einsum("iab,jcb->iajc", share, shared),
        pulled - share @ pulled[one],
    )


def _list_shifts(
    fit: Fit, number: int
) -> tuple[
    Float64[np.ndarray, "l 3 l 3"],
    Float64[np.ndarray, "l 3 3"],
    Float64[np.ndarray, "l 3"],
]:
    """Remaining information on a shift of each line, information `raw` before
    elimination, and score. Noise is correlated within lines only.
    """
    about, known = free_range_offset(fit, number)
    noise = cap_correlated_noise(about.noise)
    size = about.machine_model.size
    shift = slice(size, size + 3)  # of the pose
    total = np.zeros((about.size, about.size + 1))
    total[:size, :size] += known.matrix
    total[:size, -1] += known.vector
    shared: list[Float64[np.ndarray, "p 3"]] = []
    pulled: list[Float64[np.ndarray, "3"]] = []
    for line in _cut(about, fit.runs[number].observations):
        every = np.concatenate([line.columns, line.residual[:, :, None]], axis=2)
        free = line.weigh(line.whiten(noise), every)
        products = np.tensordot(line.columns, free, axes=((0, 1), (0, 1)))
        total += products
        shared.append(products[:, shift])
        pulled.append(products[shift, -1])
    factor = ScaledCholesky.of(total[:, :-1])
    theta = factor.solve(total[:, -1])
    pull = np.array(pulled) - np.einsum("lps,p->ls", np.array(shared), theta)
    columns = np.concatenate(shared, axis=1)
    left = -(columns.T @ factor.solve(columns)).reshape(len(pull), 3, len(pull), 3)
    own, raw = np.arange(len(pull)), np.array(shared)[:, shift]
    left[own, :, own] += raw
    return left, raw, pull


def _cut(about: Linearisation, seen: Observations) -> Iterator[DesignMatrix]:
    for design in about.split(seen):
        timing = slice(design.fixed + 1, None)
        for first, last in design.observations.lines:
            rows = design.rows[first:last]
            kept = np.ones(rows.shape[2], bool)
            kept[timing] = rows[:, :, timing].any(axis=(0, 1))
            yield replace(
                design,
                observations=design.observations.select(np.arange(first, last)),
                frame=design.frame[first:last],
                rows=rows[:, :, kept],
            )
