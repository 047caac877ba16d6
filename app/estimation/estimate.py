"""What estimation hands on: parameters, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.direction import Fit
from app.estimation.extrapolation import Ranges
from app.estimation.noise import NoiseModel
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class Observability:
    """What the measurement could tell at all.

    parameters : shapes of all error motions and squarenesses in the gauge of the tables
    rank : how many of them the data determine
    unobservable : statements in words, one for each thing that they do not
    weak : statements in words, one for each shape that they determine only weakly
    """

    parameters: int
    rank: int
    unobservable: tuple[str, ...]
    weak: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Residuals:
    """What the model leaves of the cells.

    residual_mm : (n, 3) measured minus modelled, along beam, azimuth, elevation
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
class Estimate:
    """The machine's error motions, and everything that was solved together with them.

    model : effects of the machine proper, in the order of theta
    theta : (p,), covariance : (p, p), of those effects alone; pose and timing laws are
        integrated out
    strength : prior strength of each error motion's bending, found from the data
    direction : `none`, `constant` or `tables`: what the direction of approach does
    measured : by axis, lowest and highest position that was measured, mm or deg; what
        lies beyond is extrapolated
    fit : what it was solved from, if that was to be kept
    pose : workpiece to tracker; pose_covariance : (6, 6) shift in mm and turn in rad
    about
        `centre_mm`
    """

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    strength: dict[str, float]
    noise: NoiseModel
    pose: RigidTransform
    pose_covariance: Float64[np.ndarray, "6 6"]
    centre_mm: Float64[np.ndarray, "3"]
    observability: Observability
    direction: str
    residuals: Residuals
    perpendicular_only: bool
    cells: int
    used_samples: int
    offered_samples: int
    lines: int
    fit: Fit | None = None
    measured: Ranges = field(default_factory=dict[str, tuple[float, float]])
