"""A grade of a set-up from its geometry alone, before anything moves.

One number, as the dilution of precision of satellite navigation: the expected standard
uncertainty of the volumetric error, root mean square over the travel, in units of the
standard deviation of a single tracker sample. It follows from machine, path or points,
targets and the tracker's station; deviations of the machine play no part (as in the
valuation numbers of HEIDENHAIN's cycle 451).

Indices of robot calibration (Menq & Borm 1988, Nahvi & Hollerbach 1996) are similar
functions of singular values, but those depend on units and on how a spline is cut; the
variance of the map does not.

Up to 0.25 a set-up is good: twice the uncertainty of the map is half of the scatter of
one sample. Up to 1 it is usable: the map is still worth more than measuring its every
point once. Above it is poor: it rests on the prior of typical machines more than on
data. Remaining errors of random simulated set-ups are in `docs/grade.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.information import Information, compute_posterior
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import compute_information
from truepath.estimation.problem.observability import (
    PoorlyObservableShape,
    describe_confounded,
    detect_poorly_observable,
    typical_precision_matrix,
)
from truepath.estimation.problem.prior import diagonal_precision
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.identifiable import list_confounded_effects
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import (
    ShapeModel,
    build_shape_model,
    compute_volumetric_gram,
)
from truepath.motion.configurations import Commanded
from truepath.planning.forecast import Assumptions
from truepath.planning.line_suggestions import Remedy, append_line, find_best_line
from truepath.planning.simulated_cells import assume_stations_mm, predict_cells

GOOD, USABLE = 0.25, 1.0
_SHAPES = 5  # intervals of the knots, for shapes that a person can picture
_INTERVALS = 2 * _SHAPES  # finer shapes are bridged by the prior
_NAMED = 3  # weakest motions
# What any measurement shows of the tracker's pose: 1 mm, 10 mrad. Less drowns in
# rounding where a set-up determines hardly anything.
_ROUGH_POSE = {"mm": 1.0, "rad": 1e-2}


@dataclass(frozen=True, slots=True)
class WeakMotion:
    """One of the weakest error motions.

    at_tool_mm : its own part of the standard uncertainty at the tool, root mean square
        over the travel
    remedy : the line that helps it most, None where the set-up is good
    """

    symbol: str
    at_tool_mm: float
    remedy: Remedy | None


@dataclass(frozen=True, slots=True)
class Grade:
    """Grade of a set-up, with its weakest motions.

    number : expected sigma_mm over sample_sigma_mm; the worst of the stations
    verdict : `good`, `usable` or `poor`
    sigma_mm : expected standard uncertainty of the volumetric error vector
    sample_sigma_mm : standard deviation of one tracker sample as a vector
    station_mm : station for this number; assumed : True if it was not given
    best : number of the best of the stations
    improved : number with the line for the weakest motion, None where the set-up is
        good
    """

    number: float
    verdict: str
    sigma_mm: float
    sample_sigma_mm: float
    station_mm: Float64[np.ndarray, "3"]
    assumed: bool
    best: float
    improved: float | None
    weakest: tuple[WeakMotion, ...]
    shapes: tuple[PoorlyObservableShape, ...]
    unobservable: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SetUp:
    """One Run of a set-up: its machine (with its targets), its rows and its station.

    station_mm : of the tracker in the frame that it is mounted on
    """

    machine: Machine
    commanded: Commanded
    station_mm: Float64[np.ndarray, "3"]

    def predict(self) -> Observations:
        """The cells that it would give."""
        return predict_cells(self.machine, self.commanded, self.station_mm)


@dataclass(frozen=True, slots=True)
class _Evaluation:
    """Predicted posterior of set-ups.

    information : (p, p) on the determined effects, the tracker's poses integrated out
    covariance : (p, p) of them; sigma_mm : undetermined effects included
    """

    set_ups: tuple[SetUp, ...]
    information: Float64[np.ndarray, "p p"]
    covariance: Float64[np.ndarray, "p p"]
    sigma_mm: float
    sample_sigma_mm: float

    @property
    def number(self) -> float:
        return self.sigma_mm / self.sample_sigma_mm


@dataclass(frozen=True, slots=True)
class _Criterion:
    """The criterion of set-ups; gram is of the model's θ.

    determined : number of parameters that the targets determine; they come first
    """

    model: MachineModel
    gram: Float64[np.ndarray, "p p"]
    noise: NoiseModel
    determined: int

    def evaluate(self, set_ups: tuple[SetUp, ...]) -> _Evaluation:
        cells = [one.predict() for one in set_ups]
        information = np.sum([self._marginalise_pose(one) for one in cells], axis=0)
        prior = typical_precision_matrix(self.model)
        every = _compute_covariance(information, prior)
        sigma = float(np.sqrt(max(np.sum(self.gram * every), 0.0)))
        information, prior = (
            m[: self.determined, : self.determined] for m in (information, prior)
        )
        covariance = _compute_covariance(information, prior)
        return _Evaluation(
            set_ups, information, covariance, sigma, sample_sigma_mm(cells)
        )

    def _marginalise_pose(self, cells: Observations) -> Float64[np.ndarray, "p p"]:
        base = linearise(cells, self.model, cells.pose, self.noise)
        matrix = compute_information(cells, base).matrix
        p, pose = self.model.size, TrackerPose((0.0, 0.0, 0.0)).parameters
        own = matrix[p:, p:] + diagonal_precision(pose, _ROUGH_POSE)
        cross = matrix[:p, p:]
        return matrix[:p, :p] - cross @ np.linalg.solve(own, cross.T)


def _compute_covariance(
    information: Float64[np.ndarray, "p p"], prior: Float64[np.ndarray, "p p"]
) -> Float64[np.ndarray, "p p"]:
    return compute_posterior(Information.of_matrix(information), prior).covariance


def grade(
    machine: Machine,
    commanded: Commanded,
    *,
    station_mm: Float64[np.ndarray, "3"] | None = None,
    perpendicular_only: bool = False,
) -> Grade:
    """Grade a planned measurement.

    station_mm : of the tracker in the frame that it is mounted on. None tries four
        typical stations a metre off each side of the travel; the worst counts
    perpendicular_only : ignore deviations along the lines
    Raises PlanningError if nothing would be measured at all.
    """
    stations = (
        assume_stations_mm(machine) if station_mm is None else station_mm[None, :]
    )
    candidates = [(SetUp(machine, commanded, station),) for station in stations]
    found = _grade_stations(machine, candidates, perpendicular_only)
    return replace(found, assumed=station_mm is None)


def grade_together(
    machine: Machine, set_ups: Sequence[SetUp], *, perpendicular_only: bool = False
) -> Grade:
    """Grade several Runs that are solved together, each with its own station.

    machine : with the targets of all
    """
    return _grade_stations(machine, [tuple(set_ups)], perpendicular_only)


def _grade_stations(
    machine: Machine, candidates: list[tuple[SetUp, ...]], perpendicular_only: bool
) -> Grade:
    offsets_mm = np.concatenate([one.predict().at.offset_mm for one in candidates[0]])
    shapes = build_shape_model(machine, offsets_mm, intervals=_INTERVALS)
    model = shapes.model
    noise = Assumptions(perpendicular_only=perpendicular_only).used_noise
    effects = list_confounded_effects(machine, offsets_mm)
    every = model.with_confounded([e.coarsen(_INTERVALS) for e in effects])
    gram = compute_volumetric_gram(every)
    criterion = _Criterion(every, gram, noise, model.size)
    evaluated = [criterion.evaluate(set_ups) for set_ups in candidates]
    worst = max(evaluated, key=lambda one: one.number)
    weakest, improved = _find_weakest(worst, shapes), None
    if remedy := weakest[0].remedy:  # a line more, at the end of the last Run
        *others, last = worst.set_ups
        longer = replace(last, commanded=append_line(last.commanded, remedy))
        improved = criterion.evaluate((*others, longer)).number
    coarse, refined = _coarser(model)
    return Grade(
        worst.number,
        verdict(worst.number),
        worst.sigma_mm,
        worst.sample_sigma_mm,
        worst.set_ups[-1].station_mm,
        False,
        min(one.number for one in evaluated),
        improved,
        weakest,
        detect_poorly_observable(
            refined.T @ worst.information @ refined,
            coarse,
            refined.T @ shapes.gram @ refined,
        ),
        describe_confounded(offsets_mm, shapes.confounded, model, worst.covariance),
    )


def sample_sigma_mm(cells: Sequence[Observations]) -> float:
    distance = np.concatenate([np.linalg.norm(s.tracker_mm, axis=1) for s in cells])
    tracker = cells[0].at.machine.tracker
    along, across = tracker.sigma_mm(distance[:, None].mean(axis=0))[0]
    return float(np.sqrt(along**2 + 2.0 * across**2))


def verdict(number: float) -> str:
    """`good`, `usable` or `poor`."""
    if number <= GOOD:
        return "good"
    return "usable" if number <= USABLE else "poor"


def _coarser(
    model: MachineModel,
) -> tuple[MachineModel, Float64[np.ndarray, "p c"]]:
    """A model of fewer knots, and its shapes in the parameters of the finer.

    Every second knot of a spline makes a spline of the same space, so nothing is lost.
    """
    effects = tuple(effect.coarsen(_SHAPES) for effect in model.effects)
    coarse = replace(model, effects=effects)
    refined = np.zeros((model.size, coarse.size))
    for fine, rough in zip(model.effects, effects, strict=True):
        part = (model.slices[fine.name], coarse.slices[rough.name])
        if fine.motion and rough.motion:
            # The gauge's columns are orthonormal.
            knots = fine.motion.spline.knots
            refined[part] = fine.motion.gauge.T @ rough.motion.rows(knots)
        else:
            refined[part] = np.eye(len(fine.parameters))
    return coarse, refined


def _find_weakest(one: _Evaluation, shapes: ShapeModel) -> tuple[WeakMotion, ...]:
    model, gram = shapes.model, shapes.gram
    share = {
        m.name: float(np.sqrt(max(np.sum(gram[p, p] * one.covariance[p, p]), 0.0)))
        for m in model.error_motions
        for p in (model.slices[m.name],)
    }
    names = sorted(share, key=lambda name: -share[name])[:_NAMED]
    if one.number <= GOOD:
        return tuple(WeakMotion(name, share[name], None) for name in names)
    cells = one.set_ups[-1].predict()
    return tuple(
        WeakMotion(
            name, share[name], find_best_line(name, cells, model, one.covariance, gram)
        )
        for name in names
    )
