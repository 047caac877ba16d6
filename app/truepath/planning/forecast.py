"""Uncertainty after a planned measurement, by the estimator's own model.

The cells of the plan, the noise and the prior of the estimator, and its posterior:
nothing is estimated, so the result is a covariance. The prior's precisions, which an
estimate finds from its data, are those of typical machines, or those of a live
estimate. The tracker's systematic errors are estimated together with the machine's
parameters, as in every estimate; the scale of the air, which no data determine, is
added to the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64
from scipy.linalg import block_diag

from truepath.alignment.observations.observations import Observations
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.information import (
    Information,
    OwnParameters,
    compute_posterior,
)
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import (
    RecursiveEstimator,
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.observability import (
    assess_observability,
    name_undetermined,
    typical_precision_matrix,
)
from truepath.estimation.problem.prior import diagonal_precision, guess_prior
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.files.environment import Refraction, state_length_ppm
from truepath.files.units import PER_PPM
from truepath.kinematics.coarse_model import add_bends
from truepath.kinematics.effects.instrument import (
    is_tracker_error,
    list_instrument_errors,
)
from truepath.kinematics.identifiable import (
    build_identifiable_model,
    list_confounded_effects,
)
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import (
    EstimatedModel,
    MachineModel,
    compute_scale_parameters,
)
from truepath.kinematics.volumetric_map import (
    build_shape_model,
    compute_volumetric_gram,
)
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import row_times_s
from truepath.numerics.scaled_cholesky import ScaledCholesky
from truepath.planning.simulated_cells import EXPECTED_NOISE, predict_cells
from truepath_drivers.interfaces.records import Path

_NAMED = 3  # of the weakest error motions
_CURVE = 24  # rows of the plan at which the uncertainty is given
# Of the tracker's pose before enough lines locate it: a millimetre, a milliradian.
_POSE = {"mm": 1.0, "rad": 1e-3}
# Estimates find machines smoother than their prior: by 3 to 9 on simulated
# ones, in the median of their error motions, and with less lost motion.
_SMOOTHER, _LESS_LOST = 6.0, 4.0
_LONGEST_DWELL_S, _LONGEST_LINE_S = 1.0, 5.0  # for the rank of rows
_POSITIONS = 41  # of an axis, at which an error motion's uncertainty is averaged


@dataclass(frozen=True)
class Assumptions:
    """Assumptions on a machine and its tracker before a measurement.

    known : effects in addition to the error motions, from an earlier measurement
    perpendicular_only : only deviations across the path are used
    prior_precision : by the effect's name; None for that of typical machines
    """

    known: PriorEffects = field(default_factory=PriorEffects)
    perpendicular_only: bool = False
    noise: NoiseModel = EXPECTED_NOISE
    prior_precision: Mapping[str, float] | None = None

    @property
    def used_noise(self) -> NoiseModel:
        """The noise, infinite along the path where that is not used."""
        if self.perpendicular_only:
            return replace(self.noise, along_sigma_mm=np.inf)
        return self.noise

    def make_prior(self, model: MachineModel) -> Float64[np.ndarray, "p p"]:
        """Prior precision for a model that contains the known effects."""
        precision = self.prior_precision
        if not precision:
            typical = guess_prior(model)
            motions = {effect.name for effect in model.error_motions}
            precision = {
                name: value * (_SMOOTHER if name in motions else _LESS_LOST)
                for name, value in typical.precision.items()
                if not typical.penalties[name].is_known
            }
        prior = typical_precision_matrix(model, precision)
        part = self.known.locate(model)
        prior[part, part] += self.known.precision_matrix()
        return prior


@dataclass(frozen=True, slots=True)
class Step:
    """Uncertainty after a row of the plan.

    sigma_mm : volumetric, as of the whole plan
    random_mm : its part with a perfect tracker in known air
    weakest_mm : its parts by the least determined error motions, at the tool, by name,
        the largest first
    """

    row: int
    sigma_mm: float
    random_mm: float
    weakest_mm: Mapping[str, float]


@dataclass(frozen=True)
class Forecast:
    """The uncertainty after a plan, and on the way.

    covariance : (p, p) of the model's parameters
    known : effects in the model, from an earlier measurement
    volumetric_sigma_mm : root mean square over the travel of the standard uncertainty
        of the volumetric error vector, without its rigid motion
    random_mm : its part with a perfect tracker in known air
    curve : the same after rows of the plan, in its order
    unobservable : sentences on what the plan does not determine
    stations : predicted measurement at each station
    """

    model: MachineModel
    known: PriorEffects
    covariance: Float64[np.ndarray, "p p"]
    volumetric_sigma_mm: float
    random_mm: float
    curve: tuple[Step, ...]
    unobservable: tuple[str, ...]
    stations: tuple[RunInput, ...]

    def motion_sigmas(self) -> dict[str, float]:
        """Standard uncertainty of each error, mm or rad, by its symbol.

        Of an error motion the root mean square over its travel.
        """
        found: dict[str, float] = {}
        nothing = np.zeros(self.model.size)
        reduced = EstimatedModel(self.model, nothing, self.covariance).reduce_to_targets
        for effect in reduced.model.effects:
            if not effect.iso_symbol or effect.name in reduced.model.confounded:
                continue
            _, C = reduced.part(effect.name)
            mean_square = float(np.trace(C))
            if motion := effect.motion:
                low, high = motion.axis.low, motion.axis.high
                rows = motion.rows(np.linspace(low, high, _POSITIONS))
                mean_square = float(np.sum((rows @ C) * rows)) / _POSITIONS
            found[effect.name] = mean_square**0.5
        return found


def forecast(
    machine: Machine,
    commanded: Commanded,
    station_mm: Float64[np.ndarray, "3"],
    assumed: Assumptions | None = None,
    before: Forecast | None = None,
) -> Forecast:
    """Predicted uncertainty of a plan with the tracker at a station.

    station_mm : in the frame that the tracker is mounted on
    before : forecast after the stations that are measured first
    """
    cells = predict_cells(machine, commanded, station_mm)
    assumed = assumed or Assumptions()
    known, noise = assumed.known, assumed.used_noise
    earlier = before.stations if before else ()
    stations = (*earlier, RunInput(cells, cells.pose, noise))
    model = _build_model(machine, known, stations)
    prior = assumed.make_prior(model)
    if earlier:
        prior += combine_runs(collect_information(earlier, model)).matrix
    covariance, curve = _trace_curve(cells, noise, model, prior)
    offset_mm = np.vstack([run.observations.at.offset_mm for run in stations])
    observed = assess_observability(build_shape_model(machine, offset_mm), stations)
    return Forecast(
        model,
        known,
        covariance,
        curve[-1].sigma_mm,
        curve[-1].random_mm,
        curve,
        observed.unobservable,
        stations,
    )


def predict_with_each(
    machine: Machine,
    found: Forecast,
    further: Sequence[Observations],
    assumed: Assumptions,
) -> list[float]:
    """Volumetric sigma in mm after a plan and one of several further measurements.

    further : cells of each alternative
    """
    runs = [RunInput(cells, cells.pose, assumed.used_noise) for cells in further]
    stations = (*found.stations, *runs)
    model = _build_model(machine, found.known, stations)
    gram, size = compute_volumetric_gram(model), model.size
    stretch = _state_length_scale(machine) * compute_scale_parameters(model)
    by_air_mm2 = float(stretch @ gram @ stretch)
    information: list[Float64[np.ndarray, "p p"]] = []
    for run in collect_information(stations, model):
        matrix = run.data.matrix.copy()
        pose = run.linearisation.pose_parameters
        matrix[size:, size:] += diagonal_precision(pose, _POSE)
        own = OwnParameters.of(Information.of_matrix(matrix), size)
        information.append(own.eliminate().matrix)
    planned = len(found.stations)
    prior = assumed.make_prior(model) + np.sum(information[:planned], axis=0)
    after = [
        compute_posterior(Information.of_matrix(one), prior)
        for one in information[planned:]
    ]
    return [(float(np.sum(gram * one.covariance)) + by_air_mm2) ** 0.5 for one in after]


def _state_length_scale(machine: Machine) -> float:
    """Relative standard uncertainty of all lengths, as of any recording."""
    return PER_PPM * state_length_ppm(Refraction(), machine.tracker.range_ppm)


def _build_model(
    machine: Machine, known: PriorEffects, stations: Sequence[RunInput]
) -> MachineModel:
    seen = [run.observations for run in stations]
    offset_mm = np.vstack([each.at.offset_mm for each in seen])
    model, _ = build_identifiable_model(machine, offset_mm)
    instrument = list_instrument_errors([each.at for each in seen])
    model = model.with_effects(*known.effects, *instrument)
    if any(each.is_ramp.any() for each in seen):
        model = add_bends(model)
    return model.with_confounded(list_confounded_effects(machine, offset_mm))


def predict_undetermined(
    machine: Machine, commanded: Commanded, station_mm: Float64[np.ndarray, "3"]
) -> str:
    """Sentence on shapes that rows alone do not determine; else empty.

    By the rank of their information on straight shapes, of which no prior knows, with
    the tracker's pose and the timing of the lines unknown.

    station_mm : in the frame that the tracker is mounted on
    Raises Unidentifiable if not even the pose is determined, PlanningError if nothing
    would be measured.
    """
    cells = predict_cells(machine, _shorten(machine, commanded), station_mm)
    shapes = build_shape_model(machine, cells.at.offset_mm)
    return name_undetermined(shapes, [RunInput(cells, cells.pose, EXPECTED_NOISE)])


def _shorten(machine: Machine, commanded: Commanded) -> Commanded:
    """Rows that take seconds each: the rank of their information is the same.

    An hour of dwell, or a line at a millimetre a minute, would be thousands of cells.
    """
    dwell_s = np.minimum(commanded.dwell_s, _LONGEST_DWELL_S)
    commanded = replace(commanded, dwell_s=dwell_s)
    if not isinstance(commanded, Path):
        return commanded
    line_s = row_times_s(commanded, limits=machine.motion) - dwell_s
    faster = np.maximum(line_s / _LONGEST_LINE_S, 1.0)
    return replace(commanded, feed_mm_min=commanded.feed_mm_min * faster)


def _trace_curve(
    cells: Observations,
    noise: NoiseModel,
    model: MachineModel,
    prior: Float64[np.ndarray, "p p"],
) -> tuple[Float64[np.ndarray, "p p"], tuple[Step, ...]]:
    gram = compute_volumetric_gram(model)
    of_tracker = np.zeros(model.size, bool)
    for effect in filter(is_tracker_error, model.effects):
        of_tracker[model.slices[effect.name]] = True
    length_scale = _state_length_scale(model.machine)
    sums = RecursiveEstimator.start(linearise(cells, model, cells.pose, noise))
    steps, nothing = list[Step](), np.zeros(model.size)
    left = EstimatedModel(model, nothing, np.zeros((model.size, model.size)))
    ends = np.flatnonzero(np.diff(cells.row, append=cells.row[-1] + 1)) + 1
    some = np.linspace(0, len(ends) - 1, _CURVE).round().astype(np.int64)
    for first, last in pairwise([0, *ends[np.unique(some)].tolist()]):
        sums = sums.add(cells.select(np.arange(first, last)))
        pose = diagonal_precision(sums.linearisation.pose_parameters, _POSE)
        posterior = compute_posterior(sums.information(), block_diag(prior, pose))
        covariance = posterior.covariance[: model.size, : model.size]
        left = replace(left, covariance=covariance).widen_by_scale(length_scale)
        sigma_mm, random_mm = (
            max(float(np.sum(gram * each)), 0.0) ** 0.5
            for each in (left.covariance, _hold(covariance, of_tracker))
        )
        weakest_mm = _compute_weakest_mm(left)
        row = int(cells.row[last - 1])
        steps.append(Step(row, sigma_mm, random_mm, weakest_mm))
    return left.covariance, tuple(steps)


def _hold(
    covariance: Float64[np.ndarray, "p p"], fixed: Bool[np.ndarray, " p"]
) -> Float64[np.ndarray, "p p"]:
    if not fixed.any():
        return covariance
    factor = ScaledCholesky.of(covariance[np.ix_(fixed, fixed)])
    half = factor.solve_half(covariance[fixed])
    return covariance - half.T @ half


def _compute_weakest_mm(found: EstimatedModel) -> dict[str, float]:
    """Volumetric part of the least determined error motions, the largest first.

    Only motions that the targets show: the others are reported separately.
    """
    reduced = found.reduce_to_targets
    gram = compute_volumetric_gram(reduced.model)
    square: dict[str, float] = {}
    for motion in reduced.model.error_motions:
        if motion.name not in reduced.model.confounded:
            part = reduced.model.slices[motion.name]
            own = gram[part, part] * reduced.covariance[part, part]
            square[motion.name] = max(float(np.sum(own)), 0.0)
    names = sorted(square, key=lambda name: -square[name])[:_NAMED]
    return {name: square[name] ** 0.5 for name in names}
