"""What estimation hands on: parameters, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.direction import Fit
from app.estimation.extrapolation import Ranges
from app.estimation.known_effects import KnownEffects
from app.estimation.noise import NoiseModel
from app.kinematics.machine import TrackerNoise
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform


@dataclass(frozen=True, slots=True)
class Observability:
    """What the measurement could tell at all.

    parameters : shapes of all error motions and squarenesses in the gauge of the tables
    rank : how many of them the data determine
    unobservable : statements in words, one for each thing that they do not
    poorly_observable : statements in words, one for each shape hardly determined
    """

    parameters: int
    rank: int
    unobservable: tuple[str, ...]
    poorly_observable: tuple[str, ...] = ()


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
class RunEstimate:
    """What belongs to one Run of an estimate.

    pose : workpiece to tracker; pose_covariance : (6, 6) shift in mm and turn in rad
        about `centre_mm`
    tracker : as the Run's own machine file states it
    distance_mm : mean distance of the measured points from the tracker
    lines : rows of the path or points that it has data of
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
    lines: int


@dataclass(frozen=True, slots=True)
class Estimate:
    """The machine's error motions, and everything that was solved together with them.

    model : effects of the machine proper, in the order of theta
    theta : (p,), covariance : (p, p), of those effects alone; poses and timing laws are
        integrated out
    prior_precision : of each error motion's bending, found from the data
    direction : `none`, `constant` or `tables`: what the direction of approach does
    runs : the Runs that it was made from, in the order given
    measured : by axis, lowest and highest position that was measured, mm or deg; what
        lies beyond is extrapolated
    known : effects that an earlier measurement has told, which are in the model
    chances : of each, that it moves so far with the Runs if nothing has changed; None
        where they do not tell
    fit : what it was solved from, if that was to be kept
    """

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
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
