"""What a measurement under way tells: of the machine, and of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from truepath.estimation.live.live_gate import LiveCheck
from truepath.estimation.problem.noise import NoiseModel
from truepath.kinematics.estimated_model import EstimatedModel


@dataclass(frozen=True, slots=True)
class LiveEstimate(EstimatedModel):
    """What is known so far.

    volumetric_sigma_mm : root mean square over the axis travel of the standard
        uncertainty (k = 1) of the volumetric error vector of the first target, the
        rigid motion of the whole volume left out; `volumetric_uncertainty_um` outside
    done : finished lines or points; cells : of them; time_s : tracker's clock
    check : what it says of itself
    """

    volumetric_sigma_mm: float
    done: int
    cells: int
    time_s: float
    check: LiveCheck = field(default_factory=LiveCheck)


@dataclass(frozen=True, slots=True)
class LiveFindings:
    """What a measurement under way has shown of itself.

    rows : whose line or standstill has been recognised
    station_mm : (3,) of the tracker, in the frame that it stands on
    prior_precision : by the effect's name
    """

    rows: frozenset[int]
    station_mm: Float64[np.ndarray, "3"]
    noise: NoiseModel
    prior_precision: Mapping[str, float]
