"""The batch estimate: errors, poses, timing and noise of all Runs together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.direction import Fit, include_confounded, select_fit
from truepath.estimation.problem.information import Posterior
from truepath.estimation.problem.knots import (
    add_hidden_variance,
    find_intervals,
    join_cells,
    refine_motions,
)
from truepath.estimation.problem.noise import split_sigma_mm
from truepath.estimation.problem.observability import (
    Observability,
    assess_observability,
    name_undetermined,
)
from truepath.estimation.problem.prior import widen_by_unknown_precision
from truepath.estimation.problem.prior_effects import PriorEffects
from truepath.estimation.problem.runs import RunInformation, RunInput
from truepath.estimation.solve.extrapolation import (
    Ranges,
    find_measured_ranges,
    soften_ends,
)
from truepath.estimation.solve.run_estimate import (
    RunEstimate,
    compute_residuals,
    estimate_run,
)
from truepath.kinematics.coarse_model import NestedModels, RunModels
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import EstimatedModel, MachineModel
from truepath.kinematics.volumetric_map import (
    ShapeModel,
    compute_second_order_mm,
    is_nearly_linear,
)
from truepath.progress import ShareProgress, ignore_progress

_RAMP_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class Estimate(EstimatedModel):
    """The machine's error motions, and everything that was solved together with them.

    model : effects of the machine proper, in the order of theta
    theta : (p,), covariance : (p, p), of those effects alone; poses and timing laws are
        integrated out
    prior_precision : of each error motion's bending, found from the data
    direction : `none`, `constant` or `tables`: model of the direction of approach
    runs : source Runs, in the order given
    measured : by axis, lowest and highest position that was measured, mm or deg; beyond
        it the tables are extrapolated
    known : effects known from an earlier measurement, which are in the model
    chances : of each, probability of its change with the Runs if nothing has changed;
        None where they do not determine it
    fit : the fit, if it was to be kept
    """

    prior_precision: dict[str, float]
    observability: Observability
    direction: str
    perpendicular_only: bool
    runs: tuple[RunEstimate, ...]
    measured: Ranges
    known: PriorEffects = field(default_factory=PriorEffects)
    chances: tuple[float | None, ...] = ()
    fit: Fit | None = None

    @property
    def main(self) -> int:
        """Number of the Run with most used samples."""
        return int(np.argmax([run.used_samples for run in self.runs]))

    @property
    def rms_mm(self) -> float:
        """Root mean square of one residual component over all cells."""
        return self._over_cells([run.residuals.rms_mm for run in self.runs])

    @property
    def floor_mm(self) -> float:
        """The part of `rms_mm` expected from noise alone."""
        return self._over_cells([run.residuals.floor_mm for run in self.runs])

    def _over_cells(self, values: list[float]) -> float:
        cells = [run.cells for run in self.runs]
        return float(np.sqrt(np.average(np.square(values), weights=cells)))


def estimate(
    models: RunModels,
    observed: Sequence[Observations],
    *,
    known: PriorEffects | None = None,
    perpendicular_only: bool = False,
    keep_fit: bool = False,
    given: Sequence[int] | None = None,
    on_progress: ShareProgress = ignore_progress,
) -> Estimate:
    """Estimate all error motions that the observations determine.

    models : of the machine, for the targets of all Runs
    observed : of one Run each, in either mode; with surroundings where known effects
        depend on them
    known : effects known from an earlier measurement, estimated too
    perpendicular_only : ignore deviations along the travel (sanders-2023)
    keep_fit : keep the fit, for trials by Monte Carlo
    given : the Run of the models that each is a part of; else each is one
    on_progress : receives the share done, 0 to 1

    Raises Unidentifiable if the lines do not determine the error motions.
    """
    known = known or PriorEffects()
    numbers = range(len(observed)) if given is None else given
    seen = [
        replace(each, at=replace(each.at, run=k))
        for k, each in zip(numbers, observed, strict=True)
    ]
    inputs = _guess_inputs(seen, models, perpendicular_only=perpendicular_only)
    if any(each.is_ramp.any() for each in seen):
        models = models.add_bends()
    try:
        inputs = refine_runs(models.coarse, inputs, known=known)
        on_progress(0.5)
        inputs, fit = _fit_linear(inputs, seen, models, known)
    except Unidentifiable as error:
        undetermined = name_undetermined(models.shapes, inputs)
        if not undetermined:
            raise
        raise Unidentifiable(undetermined) from error
    fit = include_confounded(fit, models.nested.confounded)
    on_progress(0.9)
    found = _state(fit, observed, models.shapes, inputs, known, perpendicular_only)
    on_progress(1.0)
    return found if keep_fit else replace(found, fit=None)


def _state(
    fit: Fit,
    observed: Sequence[Observations],
    shapes: ShapeModel,
    inputs: Sequence[RunInput],
    known: PriorEffects,
    perpendicular_only: bool,
) -> Estimate:
    """The covariance includes the uncertainty of the prior's precisions."""
    tracker = {e.name for e in fit.model.effects if is_tracker_error(e)}
    found = fit.prior.precision.items()
    result = widen_by_unknown_precision(fit.prior, fit.result)
    result = add_hidden_variance(result, fit.model, fit.prior.precision)
    return Estimate(
        fit.model,
        result.theta,
        result.covariance,
        {name: value for name, value in found if name not in tracker},
        assess_observability(shapes, inputs),
        fit.direction,
        perpendicular_only,
        tuple(estimate_run(run, result) for run in fit.runs),
        find_measured_ranges(*observed),
        known,
        known.compute_chances(fit.model, fit.result),
        fit,
    )


def _guess_inputs(
    seen: Sequence[Observations], models: RunModels, *, perpendicular_only: bool
) -> tuple[RunInput, ...]:
    return tuple(
        RunInput(
            each, each.pose, guess_noise(each, perpendicular_only=perpendicular_only)
        )
        for each in join_cells(seen, models.nested.alone)
    )


def _fit_linear(
    inputs: tuple[RunInput, ...],
    seen: Sequence[Observations],
    models: RunModels,
    known: PriorEffects,
) -> tuple[tuple[RunInput, ...], Fit]:
    """A machine with large errors is linearised again about the first fit."""
    fit = soften_ends(_fit_ramps(inputs, seen, models.nested, known))
    if all(is_linear(each, fit.model, fit.result) for each in seen):
        return inputs, fit
    seen, inputs = _linearise_again(seen, inputs, fit, models.nested.alone)
    inputs = refine_runs(models.coarse, inputs, known=known)
    return inputs, soften_ends(_fit_ramps(inputs, seen, models.nested, known))


def _linearise_again(
    seen: Sequence[Observations],
    inputs: Sequence[RunInput],
    fit: Fit,
    alone: MachineModel,
) -> tuple[list[Observations], tuple[RunInput, ...]]:
    seen = [
        linearise_about(each, run, fit.model, fit.result)
        for each, run in zip(seen, fit.runs, strict=True)
    ]
    cells = zip(inputs, join_cells(seen, alone), strict=True)
    return seen, tuple(
        replace(run, observations=each, pose=each.pose) for run, each in cells
    )


def _fit_ramps(
    inputs: Sequence[RunInput],
    seen: Sequence[Observations],
    nested: NestedModels,
    known: PriorEffects,
) -> Fit:
    fit = _fit(inputs, seen, nested, known)
    for _ in range(_RAMP_ROUNDS):
        left = [
            compute_residuals(run, run.own.restore(fit.result)[0]) for run in fit.runs
        ]
        across = [each.across_mm for each in left]
        wider = widen_ramps(
            inputs, fit.runs, across, [_travel(run) for run in fit.runs]
        )
        if wider is None:
            break
        inputs, fit = wider, _fit(wider, seen, nested, known)
    return fit


def _fit(
    inputs: Sequence[RunInput],
    seen: Sequence[Observations],
    nested: NestedModels,
    known: PriorEffects,
) -> Fit:
    """Refines the knots as needed. `seen` has the shortest cells of each Run."""
    fit = select_fit(inputs, nested, known)
    while intervals := find_intervals(fit.model, fit.prior.precision, fit.result):
        nested = replace(nested, alone=refine_motions(nested.alone, intervals))
        inputs = [
            replace(run, observations=cells)
            for run, cells in zip(inputs, join_cells(seen, nested.alone), strict=True)
        ]
        fit = select_fit(inputs, nested, known)
    return fit


def _travel(run: RunInformation) -> Float64[np.ndarray, "n 3"]:
    seen = run.observations
    turned = seen.direction @ run.linearisation.pose.rotation.T
    return np.einsum("nij,nj->ni", seen.beam_frame, turned)


# A Run of a machine with large errors as one whose small errors add. The estimate takes
# error motions at the commanded position, and adds their displacements: for a machine
# with errors of a millimetre neither holds to micrometres. A first estimate gives both:
# the actual position on the line, and the effect of error motions on each other.
def is_linear(seen: Observations, model: MachineModel, machine: Posterior) -> bool:
    """True if the errors of the machine are small enough to superpose."""
    return is_nearly_linear(model, seen.at, machine.theta)


def linearise_about(
    seen: Observations, run: RunInformation, model: MachineModel, machine: Posterior
) -> Observations:
    """The Run with cells at their actual positions, second-order terms removed.

    run : a first estimate of its pose; machine : of the machine
    """
    theta = machine.theta
    pose = run.linearisation.correct_pose(run.own.restore(machine)[0])
    added_mm = compute_second_order_mm(model, seen.at, theta)
    moved_mm = added_mm + model.displacement_mm(seen.at, theta)
    rest_mm = pose.invert().apply(seen.tracker_mm) - seen.at.point_mm - moved_mm
    position = seen.at.position_mm + _find_lead(seen, rest_mm)
    return replace(
        seen,
        at=replace(seen.at, position_mm=position),
        tracker_mm=seen.tracker_mm - added_mm @ pose.rotation.T,
        pose=pose,
    )


def _find_lead(
    seen: Observations, rest_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n a"]:
    """Lead of the axes over the commanded positions of cells on straight lines. At
    constant feed a constant and a rate for each line; on ramps one value for each cell.

    rest_mm : measured less modelled
    """
    at, lead = seen.at, np.zeros_like(seen.at.position_mm)
    ahead = np.einsum("ni,ni->n", rest_mm, seen.direction)
    is_rotary = np.isin(at.machine.axis_names, [a.name for a in at.machine.rotary_axes])
    for first, last in seen.stretches:
        ends = [first, last - 1]
        moved = np.diff(at.position_mm[ends], axis=0)[0]
        way_mm = float(np.diff(at.point_mm[ends], axis=0)[0] @ seen.direction[first])
        if at.line[first] < 0 or last - first < 3 or moved[is_rotary].any():
            continue
        own: Float64[np.ndarray, " k"] = ahead[first:last]
        if not seen.is_ramp[first]:
            root = np.sqrt(seen.count[first:last])
            law = np.column_stack([np.ones(last - first), at.line_time_s[first:last]])
            own = law @ np.linalg.lstsq(law * root[:, None], own * root, rcond=None)[0]
        lead[first:last] = own[:, None] * moved / way_mm
    return lead


# Scatter of ramps beyond the noise: a machine that vibrates after each jerk, say.
# The part in proportion to the acceleration is solved for with the error motions. The
# rest has no model: data of ramps are then weighted by their scatter.
_TOLERATED = 0.3  # of the variance of noise: less is chance
_CLOSE = 0.1  # of the variance that ramps have already


def widen_ramps(
    inputs: Sequence[RunInput],
    runs: Sequence[RunInformation],
    across_mm: Sequence[Float64[np.ndarray, " _n"]],
    travel: Sequence[Float64[np.ndarray, "_n 3"]],
) -> tuple[RunInput, ...] | None:
    """The Runs with the scatter of their ramps; None if it has hardly changed.

    runs : as solved; across_mm : residual of each cell across the travel
    """
    found: list[RunInput] = []
    for given, run, across, along in zip(inputs, runs, across_mm, travel, strict=True):
        sigma_mm = _compute_scatter_mm(run, across, along)
        noise = replace(run.noise, ramp_sigma_mm=sigma_mm)
        found.append(replace(given, noise=noise))
    changes = [
        abs(new.noise.ramp_sigma_mm**2 - old.noise.ramp_sigma_mm**2)
        > _CLOSE * old.noise.ramp_sigma_mm**2
        for new, old in zip(found, runs, strict=True)
    ]
    return tuple(found) if any(changes) else None


def _compute_scatter_mm(
    run: RunInformation,
    across_mm: Float64[np.ndarray, " n"],
    travel: Float64[np.ndarray, "n 3"],
) -> float:
    """Standard deviation of a ramp's cell beyond the noise.

    All cells of a ramp may be off together, so each counts for less.
    """
    seen = run.observations
    ramp = seen.is_ramp
    if not ramp.any():
        return 0.0
    white, ou = split_sigma_mm(seen, replace(run.noise, ramp_sigma_mm=0.0))
    stated = ((white**2 + ou**2) * (1.0 - travel**2)).sum(axis=1)
    usual = max(1.0, float((across_mm[~ramp] ** 2).mean() / stated[~ramp].mean()))
    noise = usual * float(stated[ramp].mean())
    excess = float((across_mm[ramp] ** 2).mean()) - noise
    if excess < _TOLERATED * noise:
        return 0.0
    return float(np.sqrt(0.5 * excess * _count_cells_of_ramp(seen)))


def _count_cells_of_ramp(seen: Observations) -> float:
    ramp = seen.is_ramp
    begins = [first for first, _ in seen.stretches if ramp[first]]
    return float(np.count_nonzero(ramp)) / len(begins)
