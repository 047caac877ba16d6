"""The batch estimate: errors, poses, timing and noise of all Runs together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.direction import Fit, include_confounded, select_fit
from truepath.estimation.problem.information import Posterior
from truepath.estimation.problem.knots import (
    add_hidden_variance,
    compute_intervals,
    merge_cells,
    refine_motions,
)
from truepath.estimation.problem.noise import (
    NoiseModel,
    compute_places_um,
    expected_rms_mm,
    split_sigma_mm,
)
from truepath.estimation.problem.normal_equations import RunInformation, RunInput
from truepath.estimation.problem.observability import (
    Observability,
    assess_observability,
    name_undetermined,
)
from truepath.estimation.problem.prior import widen_by_unknown_precision
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.estimation.solve.extrapolation import (
    Ranges,
    compute_measured_ranges,
    soften_ends,
)
from truepath.kinematics.coarse_model import NestedModels, RunModels
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.effects.pose_timing_seats import TargetSeat
from truepath.kinematics.machine.machine import Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.model import EstimatedModel, MachineModel
from truepath.kinematics.volumetric_map import (
    compute_second_order_mm,
    is_nearly_linear,
)
from truepath.numerics.rigid import RigidTransform
from truepath.progress import ShareProgress, ignore_progress


@dataclass(frozen=True, slots=True)
class Residuals:
    """Residuals of the cells of one Run.

    residual_mm : (n, 3) measured minus modelled, along beam, azimuth, elevation; only
        the part across the travel, where only that counts
    across_mm : (n,) size of the residual across the travel
    row : (n,) row of the path or points; position_mm : (n, axes)
    rms_mm : over all; floor_mm : expected from noise alone
    """

    residual_mm: Float64[np.ndarray, "n 3"]
    across_mm: Float64[np.ndarray, " n"]
    row: Int64[np.ndarray, " n"]
    position_mm: Float64[np.ndarray, "n a"]
    rms_mm: float
    floor_mm: float


@dataclass(frozen=True, slots=True)
class SeatEstimate:
    """Offset of a target from its position in the machine file, mm.

    On the tool: against the first target there, to which the errors refer.
    """

    target: Target
    shift_mm: Float64[np.ndarray, "3"]
    sigma_mm: Float64[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class RunEstimate:
    """The part of an estimate that belongs to one Run.

    pose : workpiece to tracker; pose_covariance : (6, 6) shift in mm and turn in rad
        about `centre_mm`
    tracker : as in the Run's machine file
    distance_mm : mean distance of the measured points from the tracker
    measured_rows : lines of the path, or points, that it has data of
    seats : of its targets, without those that the pose absorbs
    rotation, set_up : of the tracker, as recorded
    """

    noise: NoiseModel
    pose: RigidTransform
    pose_covariance: Float64[np.ndarray, "6 6"]
    centre_mm: Float64[np.ndarray, "3"]
    tracker: TrackerNoise
    distance_mm: float
    residuals: Residuals
    cells: int
    used_samples: int
    offered_samples: int
    measured_rows: frozenset[int]
    seats: tuple[SeatEstimate, ...] = ()
    rotation: Float64[np.ndarray, "3 3"] | None = None
    set_up: str = ""

    @property
    def place_um(self) -> list[float]:
        """What one standstill differs from the next by: range, azimuth, elevation."""
        return compute_places_um(self.tracker, self.distance_mm, self.noise)

    @property
    def lines(self) -> int:
        return len(self.measured_rows)


def estimate_run(run: RunInformation, machine: Posterior) -> RunEstimate:
    """Pose, seats and residuals of one Run. machine : posterior from all Runs"""
    theta, pose_covariance = run.own.restore(machine)
    observations, residuals = run.observations, compute_residuals(run, theta)
    recorded = observations.at.recorded
    return RunEstimate(
        run.noise,
        run.linearisation.correct_pose(theta),
        pose_covariance,
        observations.at.point_mm.mean(axis=0),
        observations.at.machine.tracker,
        float(np.linalg.norm(observations.tracker_mm, axis=1).mean()),
        residuals,
        len(observations),
        observations.used,
        observations.offered,
        observations.measured_rows,
        tuple(_estimate_seats(run, machine)),
        None if recorded is None else recorded.rotation,
        "" if recorded is None else recorded.set_up,
    )


def _estimate_seats(run: RunInformation, machine: Posterior) -> Iterator[SeatEstimate]:
    at, model = run.observations.at, run.linearisation.machine_model
    for effect in model.effects:
        if isinstance(effect, TargetSeat) and effect.run == at.run:
            part, rows = model.slices[effect.name], np.flatnonzero(effect.select(at))
            if not len(rows):
                continue  # a part of the Run may measure some targets alone
            shift = machine.theta[part]
            if at.seat_mm is not None:
                shift = shift + at.seat_mm[rows[0]]
            sigma = np.sqrt(np.maximum(np.diag(machine.covariance[part, part]), 0.0))
            yield SeatEstimate(effect.target, shift, sigma)


def compute_residuals(
    run: RunInformation, theta: Float64[np.ndarray, " p"]
) -> Residuals:
    """Residuals from all parameters of machine and pose, timing at its best fit."""
    parts = [
        (
            design.residual
            - design.explain_timing(design.whiten(run.noise), design.residual),
            design.travel,
        )
        for design in run.linearisation.split(run.observations, theta)
    ]
    residual, travel = (np.concatenate(each) for each in zip(*parts, strict=True))
    across = residual - np.einsum("ni,ni->n", residual, travel)[:, None] * travel
    is_across = np.isinf(run.noise.along_sigma_mm) | run.observations.is_ramp
    counted = np.where(is_across[:, None], across, residual)
    return Residuals(
        counted,
        np.linalg.norm(across, axis=1),
        run.observations.row,
        run.observations.at.position_mm,
        float(np.sqrt(np.mean(counted**2))),
        expected_rms_mm(run.observations, run.noise, travel),
    )


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
    fit : what it was solved from, as long as it is needed
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
    def stored_fit(self) -> Fit:
        """The fit of an estimate that still has it. Raises ValueError."""
        if self.fit is None:
            raise ValueError("an estimate that keeps what it was solved from is needed")
        return self.fit

    @property
    def main(self) -> int:
        return int(np.argmax([run.used_samples for run in self.runs]))

    @property
    def rms_mm(self) -> float:
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
    given: Sequence[int] | None = None,
    on_progress: ShareProgress = ignore_progress,
) -> Estimate:
    """Estimate all error motions that the observations determine.

    models : of the machine, for the targets of all Runs
    observed : of one Run each, in either mode; with surroundings where known effects
        depend on them
    known : effects known from an earlier measurement, estimated too
    perpendicular_only : ignore deviations along the travel (sanders-2023)
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
    inputs = tuple(
        RunInput(
            each, each.pose, guess_noise(each, perpendicular_only=perpendicular_only)
        )
        for each in merge_cells(seen, models.nested.alone)
    )
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
    tracker = {e.name for e in fit.model.effects if is_tracker_error(e)}
    precision = fit.prior.precision
    # The covariance includes the uncertainty of the prior's precisions.
    result = widen_by_unknown_precision(fit.prior, fit.result)
    result = add_hidden_variance(result, fit.model, precision)
    found = Estimate(
        fit.model,
        result.theta,
        result.covariance,
        {name: value for name, value in precision.items() if name not in tracker},
        assess_observability(models.shapes, inputs),
        fit.direction,
        perpendicular_only,
        tuple(estimate_run(run, result) for run in fit.runs),
        compute_measured_ranges(*observed),
        known,
        known.compute_chances(fit.model, fit.result),
        fit,
    )
    on_progress(1.0)
    return found


def _fit_linear(
    inputs: tuple[RunInput, ...],
    seen: Sequence[Observations],
    models: RunModels,
    known: PriorEffects,
) -> tuple[tuple[RunInput, ...], Fit]:
    """A machine with large errors is linearised again about the first fit."""
    fit = soften_ends(_fit_ramps(inputs, seen, models.nested, known))
    if all(is_nearly_linear(fit.model, each.at, fit.result.theta) for each in seen):
        return inputs, fit
    seen = [
        linearise_about(each, run, fit.model, fit.result)
        for each, run in zip(seen, fit.runs, strict=True)
    ]
    inputs = tuple(
        replace(run, observations=each, pose=each.pose)
        for run, each in zip(
            inputs, merge_cells(seen, models.nested.alone), strict=True
        )
    )
    inputs = refine_runs(models.coarse, inputs, known=known)
    return inputs, soften_ends(_fit_ramps(inputs, seen, models.nested, known))


def _fit_ramps(
    inputs: Sequence[RunInput],
    seen: Sequence[Observations],
    nested: NestedModels,
    known: PriorEffects,
) -> Fit:
    fit = _fit_with_knots(inputs, seen, nested, known)
    for _ in range(2):  # the scatter has settled then
        left = [
            compute_residuals(run, run.own.restore(fit.result)[0]) for run in fit.runs
        ]
        across = [each.across_mm for each in left]
        wider = widen_ramps(inputs, fit.runs, across)
        if wider is None:
            break
        inputs, fit = wider, _fit_with_knots(wider, seen, nested, known)
    return fit


def _fit_with_knots(
    inputs: Sequence[RunInput],
    seen: Sequence[Observations],
    nested: NestedModels,
    known: PriorEffects,
) -> Fit:
    """Refines the knots as needed. `seen` has the shortest cells of each Run."""
    fit = select_fit(inputs, nested, known)
    while intervals := compute_intervals(fit.model, fit.prior.precision, fit.result):
        nested = replace(nested, alone=refine_motions(nested.alone, intervals))
        inputs = [
            replace(run, observations=cells)
            for run, cells in zip(inputs, merge_cells(seen, nested.alone), strict=True)
        ]
        fit = select_fit(inputs, nested, known)
    return fit


# A Run of a machine with large errors as one whose small errors add. The estimate takes
# error motions at the commanded position, and adds their displacements: for a machine
# with errors of a millimetre neither holds to micrometres. A first estimate gives both:
# the actual position on the line, and the effect of error motions on each other.
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
    position = seen.at.position_mm + _estimate_lead(seen, rest_mm)
    return replace(
        seen,
        at=replace(seen.at, position_mm=position),
        tracker_mm=seen.tracker_mm - added_mm @ pose.rotation.T,
        pose=pose,
    )


def _estimate_lead(
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
) -> tuple[RunInput, ...] | None:
    """The Runs with the scatter of their ramps; None if it has hardly changed.

    runs : as solved; across_mm : residual of each cell across the travel
    """
    found: list[RunInput] = []
    for given, run, across in zip(inputs, runs, across_mm, strict=True):
        sigma_mm = _compute_scatter_mm(run, across)
        noise = replace(run.noise, ramp_sigma_mm=sigma_mm)
        found.append(replace(given, noise=noise))
    changes = [
        abs(new.noise.ramp_sigma_mm**2 - old.noise.ramp_sigma_mm**2)
        > _CLOSE * old.noise.ramp_sigma_mm**2
        for new, old in zip(found, runs, strict=True)
    ]
    return tuple(found) if any(changes) else None


def _compute_scatter_mm(
    run: RunInformation, across_mm: Float64[np.ndarray, " n"]
) -> float:
    """Standard deviation of a ramp's cell beyond the noise.

    All cells of a ramp may be off together, so each counts for less.
    """
    seen = run.observations
    ramp = seen.is_ramp
    if not ramp.any():
        return 0.0
    white, ou = split_sigma_mm(seen, replace(run.noise, ramp_sigma_mm=0.0))
    stated = ((white**2 + ou**2) * (1.0 - run.travel**2)).sum(axis=1)
    ratio = max(1.0, float((across_mm[~ramp] ** 2).mean() / stated[~ramp].mean()))
    noise = ratio * float(stated[ramp].mean())
    excess = float((across_mm[ramp] ** 2).mean()) - noise
    if excess < _TOLERATED * noise:
        return 0.0
    ramps = sum(ramp[first] for first, _ in seen.stretches)
    cells_of_ramp = float(np.count_nonzero(ramp)) / ramps
    return float(np.sqrt(0.5 * excess * cells_of_ramp))
