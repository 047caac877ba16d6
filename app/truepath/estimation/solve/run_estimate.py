"""The part of an estimate on one Run: noise, pose, seats of targets, residuals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from truepath.estimation.problem.design_matrix import DesignMatrix
from truepath.estimation.problem.information import Posterior
from truepath.estimation.problem.noise import (
    NoiseModel,
    compute_places_um,
    expected_rms_mm,
)
from truepath.estimation.problem.normal_equations import RunInformation
from truepath.kinematics.effects.pose_timing_seats import TargetSeat
from truepath.kinematics.machine.machine import Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.numerics.rigid import RigidTransform


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
        tuple(_find_seats(run, machine)),
        None if recorded is None else recorded.rotation,
        "" if recorded is None else recorded.set_up,
    )


def _find_seats(run: RunInformation, machine: Posterior) -> Iterator[SeatEstimate]:
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
        (_remove_timing(design, run.noise), design.travel)
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


def _remove_timing(
    design: DesignMatrix, noise: NoiseModel
) -> Float64[np.ndarray, "n 3"]:
    rest = design.residual
    return rest - design.explain_timing(design.whiten(noise), rest)
