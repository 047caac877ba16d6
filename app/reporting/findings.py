"""Everything that a result states, gathered once for the result file and the report."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.estimate import Estimate
from app.estimation.grade import Grade
from app.kinematics.effects.base import standstill
from app.reporting.error_tables import MILLI, ErrorTables, error_tables
from app.reporting.held_trials import HeldTrials
from app.reporting.run_account import RunAccount
from app.reporting.volumetric_error import VolumetricError, volumetric_error


@dataclass(frozen=True, slots=True)
class Provenance:
    """Which program computed a result from which Run, when and how."""

    run: RunAccount
    software_version: str
    created: datetime


@dataclass(frozen=True, slots=True)
class LineResiduals:
    """Residuals by row of the path or points: root mean square of one component.

    row : (m,), cells : (m,), rms_um : (m,)
    """

    row: Int64[np.ndarray, " m"]
    cells: Int64[np.ndarray, " m"]
    rms_um: Float64[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """Standard deviations along and across the beam at the mean distance.

    stated_um : (2,) of one sample, as the machine file states it
    white_um : (2,) of one sample, as found; slow_um : (2,) of the correlated part
    along_travel_um : of a cell, beyond phase and speed; None where not used
    """

    distance_mm: float
    stated_um: Float64[np.ndarray, "2"]
    white_um: Float64[np.ndarray, "2"]
    slow_um: Float64[np.ndarray, "2"]
    slow_time_s: float
    along_travel_um: float | None


@dataclass(frozen=True, slots=True)
class Findings:
    """An estimate and what follows from it.

    trials : what trials say of it, if they were run
    grade : what the set-up was worth before the measurement, if it was asked
    """

    estimate: Estimate
    provenance: Provenance
    tables: ErrorTables
    volumetric: VolumetricError
    by_line: LineResiduals
    noise: NoiseFound
    trials: HeldTrials | None = None
    grade: Grade | None = None


def find(
    estimate: Estimate,
    provenance: Provenance,
    trials: HeldTrials | None = None,
    grade: Grade | None = None,
) -> Findings:
    """Return the findings of an estimate."""
    parts = estimate.model, estimate.theta, estimate.covariance
    return Findings(
        estimate,
        provenance,
        error_tables(*parts, estimate.measured),
        volumetric_error(*parts),
        residuals_by_line(estimate),
        noise_found(estimate),
        trials,
        grade,
    )


def residuals_by_line(estimate: Estimate) -> LineResiduals:
    """Return the residuals of each row, as `Residuals.rms_mm` counts them."""
    residuals = estimate.residuals
    if estimate.perpendicular_only:
        square = residuals.across_mm**2 / 3.0
    else:
        square = np.mean(residuals.residual_mm**2, axis=1)
    row, place, cells = np.unique(
        residuals.row, return_inverse=True, return_counts=True
    )
    mean = np.bincount(place, square, len(row)) / cells
    return LineResiduals(row, cells, MILLI * np.sqrt(mean))


def noise_found(estimate: Estimate) -> NoiseFound:
    """Return the noise of the Run in µm."""
    machine, noise = estimate.model.machine, estimate.noise
    position_mm = estimate.residuals.position_mm
    offset_mm = np.tile(np.array(machine.target().offset_mm), (len(position_mm), 1))
    at = standstill(machine, position_mm, offset_mm)
    seen_from = machine.tracker.stands_on
    at = at.seen_by(seen_from, np.zeros(len(position_mm), bool))
    seen_mm = estimate.pose.apply(at.point_mm)
    distance = float(np.linalg.norm(seen_mm, axis=1).mean())
    stated = MILLI * machine.tracker.sigma_mm(np.array([distance]))[0]
    along = MILLI * noise.along_sigma_mm
    return NoiseFound(
        distance,
        stated,
        stated * np.array(noise.white),
        stated * np.array(noise.slow),
        noise.slow_time_s,
        along if np.isfinite(along) else None,
    )
