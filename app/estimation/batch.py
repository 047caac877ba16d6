"""The batch estimate: errors, poses, timing and noise of all Runs together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64, Int64

from app.alignment.observations import Observations
from app.errors import Unidentifiable
from app.estimation.design_matrix import DesignMatrix
from app.estimation.direction import Fit, include_confounded, select_fit
from app.estimation.extrapolation import Ranges, find_measured_ranges, soften_ends
from app.estimation.information import Posterior
from app.estimation.knots import (
    add_hidden_variance,
    find_intervals,
    join_cells,
    refine_motions,
)
from app.estimation.known_effects import KnownEffects
from app.estimation.large_errors import is_linear, linearise_about
from app.estimation.noise import NoiseModel, floor_mm
from app.estimation.noise_fit import guess_noise, refine_runs
from app.estimation.observability import (
    Observability,
    assess_observability,
    name_undetermined,
)
from app.estimation.prior import widen_by_unknown_precision
from app.estimation.ramp_noise import widen_ramps
from app.estimation.runs import RunInformation, RunInput
from app.files.model_file import EstimatedModel
from app.kinematics.coarse_model import NestedModels, RunModels
from app.kinematics.effects.nuisance import TargetSeat
from app.kinematics.machine import Target, TrackerNoise
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform
from app.progress import ShareProgress, ignore_progress

_RAMP_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class Residuals:
    """What the model leaves of the cells.

    residual_mm : (n, 3) measured minus modelled, along beam, azimuth, elevation; only
        what is across the travel, where only that counts
    across_mm : (n,) size of the residual across the travel
    row : (n,) row of the path or points; position_mm : (n, axes)
    rms_mm : over all; floor_mm : what the noise alone would leave
    """

    residual_mm: Float64[np.ndarray, "n 3"]
    across_mm: Float64[np.ndarray, " n"]
    row: Int64[np.ndarray, " n"]
    position_mm: Float64[np.ndarray, "n a"]
    rms_mm: float
    floor_mm: float


@dataclass(frozen=True, slots=True)
class SeatEstimate:
    """How far a target sits off where the machine file states it, in mm.

    On the tool: against the first target there, for which the errors are stated.
    """

    target: Target
    shift_mm: Float64[np.ndarray, "3"]
    sigma_mm: Float64[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class RunEstimate:
    """What belongs to one Run of an estimate.

    pose : workpiece to tracker; pose_covariance : (6, 6) shift in mm and turn in rad
        about `centre_mm`
    tracker : as the Run's own machine file states it
    distance_mm : mean distance of the measured points from the tracker
    measured_rows : lines of the path, or points, that it has data of
    seats : of its targets, those that are a matter of the pose left out
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

    @property
    def lines(self) -> int:
        """How many lines or points it has data of."""
        return len(self.measured_rows)


@dataclass(frozen=True, slots=True)
class Estimate(EstimatedModel):
    """The machine's error motions, and everything that was solved together with them.

    model : effects of the machine proper, in the order of theta
    theta : (p,), covariance : (p, p), of those effects alone; poses and timing laws are
        integrated out
    prior_precision : of each error motion's bending, found from the data
    direction : `none`, `constant` or `tables`: what the direction of approach does
    runs : the Runs that it was made from, in the order given
    measured : by axis, lowest and highest position that was measured, mm or deg; what
        lies beyond is extrapolated
    known : effects known from an earlier measurement, which are in the model
    chances : of each, that it moves so far with the Runs if nothing has changed; None
        where they do not tell
    fit : what it was solved from, if that was to be kept
    """

    prior_precision: dict[str, float]
    observability: Observability
    direction: str
    perpendicular_only: bool
    runs: tuple[RunEstimate, ...]
    measured: Ranges
    known: KnownEffects = field(default_factory=KnownEffects)
    chances: tuple[float | None, ...] = ()
    fit: Fit | None = None

    @property
    def main(self) -> int:
        """The Run that most used samples come from."""
        return int(np.argmax([run.used_samples for run in self.runs]))

    @property
    def rms_mm(self) -> float:
        """Root mean square of one residual component over all cells."""
        return self._over_cells([run.residuals.rms_mm for run in self.runs])

    @property
    def floor_mm(self) -> float:
        """What of it the noise alone would leave."""
        return self._over_cells([run.residuals.floor_mm for run in self.runs])

    def _over_cells(self, values: list[float]) -> float:
        cells = [run.cells for run in self.runs]
        return float(np.sqrt(np.average(np.square(values), weights=cells)))


def estimate(
    models: RunModels,
    observed: Sequence[Observations],
    *,
    known: KnownEffects | None = None,
    perpendicular_only: bool = False,
    keep_fit: bool = False,
    on_progress: ShareProgress = ignore_progress,
) -> Estimate:
    """Estimate all error motions that the observations can tell.

    models : of the machine, for the targets of all Runs
    observed : of one Run each, in either mode; with surroundings where effects are
        known that depend on them
    known : effects known from an earlier measurement, to be estimated beside
    perpendicular_only : leave out what is measured along the travel (sanders-2023)
    keep_fit : keep what the estimate was solved from, for trials by Monte Carlo
    on_progress : receives the share done, 0 to 1

    Raises Unidentifiable if the lines do not determine the error motions.
    """
    known = known or KnownEffects()
    seen = [
        replace(each, at=replace(each.at, run=k)) for k, each in enumerate(observed)
    ]
    inputs = tuple(
        RunInput(
            each, each.pose, guess_noise(each, perpendicular_only=perpendicular_only)
        )
        for each in join_cells(seen, models.nested.alone)
    )
    if any(each.is_ramp.any() for each in seen):
        models = models.add_bends()
    try:
        inputs = refine_runs(models.coarse, inputs, known=known)
        on_progress(0.5)
        fit = soften_ends(_fit_ramps(inputs, seen, models.nested, known))
        if not all(is_linear(each, fit.model, fit.result) for each in seen):
            seen, inputs = _linearise_again(seen, inputs, fit, models.nested.alone)
            inputs = refine_runs(models.coarse, inputs, known=known)
            fit = soften_ends(_fit_ramps(inputs, seen, models.nested, known))
    except Unidentifiable as error:
        undetermined = name_undetermined(models.shapes, inputs)
        if not undetermined:
            raise
        raise Unidentifiable(undetermined) from error
    fit = include_confounded(fit, models.nested.confounded)
    on_progress(0.9)
    result = widen_by_unknown_precision(fit.prior, fit.result)
    result = add_hidden_variance(result, fit.model, fit.prior.precision)
    found = Estimate(
        fit.model,
        result.theta,
        result.covariance,
        fit.prior.precision,
        assess_observability(models.shapes, inputs),
        fit.direction,
        perpendicular_only,
        tuple(_estimate_run(run, result) for run in fit.runs),
        find_measured_ranges(*observed),
        known,
        known.compute_chances(fit.model, fit.result),
        fit if keep_fit else None,
    )
    on_progress(1.0)
    return found


def _linearise_again(
    seen: Sequence[Observations],
    inputs: Sequence[RunInput],
    fit: Fit,
    alone: MachineModel,
) -> tuple[list[Observations], tuple[RunInput, ...]]:
    """Return the Runs about the machine that a fit has found, and in its cells."""
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
    known: KnownEffects,
) -> Fit:
    """Return the fit in which ramps count by how far they are off."""
    fit = _fit(inputs, seen, nested, known)
    for _ in range(_RAMP_ROUNDS):
        left = [
            _compute_residuals(run, run.own.restore(fit.result)[0]) for run in fit.runs
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
    known: KnownEffects,
) -> Fit:
    """Return the fit whose knots are as close as the error motions need.

    seen : of each Run, in the shortest cells
    """
    fit = select_fit(inputs, nested, known)
    while intervals := find_intervals(fit.model, fit.prior.precision, fit.result):
        nested = replace(nested, alone=refine_motions(nested.alone, intervals))
        inputs = [
            replace(run, observations=cells)
            for run, cells in zip(inputs, join_cells(seen, nested.alone), strict=True)
        ]
        fit = select_fit(inputs, nested, known)
    return fit


def _estimate_run(run: RunInformation, machine: Posterior) -> RunEstimate:
    theta, pose_covariance = run.own.restore(machine)
    observations, residuals = run.observations, _compute_residuals(run, theta)
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
        tuple(_find_seats(run, machine)),
    )


def _find_seats(run: RunInformation, machine: Posterior) -> Iterator[SeatEstimate]:
    """Yield how its targets sit: what was found before lines were cut, and the rest."""
    at, model = run.observations.at, run.linearisation.machine_model
    for effect in model.effects:
        if isinstance(effect, TargetSeat) and effect.run == at.run:
            part, rows = model.slices[effect.name], np.flatnonzero(effect.select(at))
            shift = machine.theta[part]
            if at.seat_mm is not None and len(rows):
                shift = shift + at.seat_mm[rows[0]]
            sigma = np.sqrt(np.maximum(np.diag(machine.covariance[part, part]), 0.0))
            yield SeatEstimate(effect.target, shift, sigma)


def _travel(run: RunInformation) -> Float64[np.ndarray, "n 3"]:
    """Return the direction of travel of each cell in the beam frame."""
    seen = run.observations
    turned = seen.direction @ run.linearisation.pose.rotation.T
    return np.einsum("nij,nj->ni", seen.beam_frame, turned)


def _compute_residuals(
    run: RunInformation, theta: Float64[np.ndarray, " p"]
) -> Residuals:
    parts = [
        (_fit_lines(design, theta, run.noise), design.travel)
        for design in run.linearisation.split(run.observations)
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
        floor_mm(run.observations, run.noise, travel),
    )


def _fit_lines(
    design: DesignMatrix, theta: Float64[np.ndarray, " p"], noise: NoiseModel
) -> Float64[np.ndarray, "n 3"]:
    """Return the residual, the timing of each line at its best."""
    rest = (design.residual - design.columns @ theta)[:, :, None]
    timing, _ = design.fit_timing(design.whiten(noise), rest)
    return (rest - design.timing @ timing)[:, :, 0]
