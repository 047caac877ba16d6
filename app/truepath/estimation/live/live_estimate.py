"""Results of a measurement in progress: the machine, and the state of the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from truepath.estimation.live.innovation_gate import LiveCheck
from truepath.estimation.problem.noise import NoiseModel
from truepath.kinematics.model import EstimatedModel


@dataclass(frozen=True, slots=True)
class LiveEstimate(EstimatedModel):
    """The estimate from the lines so far.

    volumetric_sigma_mm : root mean square over the axis travel of the standard
        uncertainty (k = 1) of the volumetric error vector of the first target, without
        the rigid motion of the whole volume; `volumetric_uncertainty_um` outside
    done : finished lines or points; cells : of them; time_s : tracker's clock
    check : exclusions, steps and residuals
    """

    volumetric_sigma_mm: float
    done: int
    cells: int
    time_s: float
    check: LiveCheck = field(default_factory=LiveCheck)


@dataclass(frozen=True, slots=True)
class LiveFindings:
    """What the plan of further rows needs from a measurement in progress.

    rows : whose line or standstill has been recognised
    station_mm : (3,) of the tracker, in the frame that it is mounted on
    prior_precision : by the effect's name
    """

    rows: frozenset[int]
    station_mm: Float64[np.ndarray, "3"]
    noise: NoiseModel
    prior_precision: Mapping[str, float]
