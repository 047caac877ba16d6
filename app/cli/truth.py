"""A result against the machine's true errors, which only a simulated machine has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.files.result_file import result_from_json
from app.numerics.rigid import cross_matrix
from app.results.prediction import predict

_POINTS = 500  # places in the volume at which errors are compared
_SEED = 7  # of the points, which the measurement does not use


@dataclass(frozen=True, slots=True)
class TruthComparison:
    """Volumetric error at points all over the travel, rigid motion removed.

    before_um, after_um : mean length of the true error, and of what the result leaves
    covered : share of all components that lie within two standard uncertainties
    """

    before_um: float
    after_um: float
    covered: float

    @property
    def left(self) -> float:
        """Share of the error that calibration leaves."""
        return self.after_um / self.before_um


def compare_with_truth(
    result: Mapping[str, Any], truth_um: Callable[[np.ndarray], np.ndarray]
) -> TruthComparison:
    """Compare a result with the truth.

    truth_um : axis positions (n, 3) in mm to true volumetric errors (n, 3) in µm
    """
    loaded = result_from_json(result)
    low = np.array([axis.min_mm for axis in loaded.machine.linear_axes])
    high = np.array([axis.max_mm for axis in loaded.machine.linear_axes])
    share = np.random.default_rng(_SEED).random((_POINTS, 3))
    position_mm = low + share * (high - low)
    predicted = predict(loaded, position_mm)
    before = _without_rigid_motion(position_mm, truth_um(position_mm))
    left = before - _without_rigid_motion(position_mm, predicted.error_um)
    return TruthComparison(
        float(np.linalg.norm(before, axis=1).mean()),
        float(np.linalg.norm(left, axis=1).mean()),
        float((np.abs(left) <= 2 * predicted.uncertainty_um).mean()),
    )


def _without_rigid_motion(
    position_mm: Float64[np.ndarray, "n 3"], error_um: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Remove the rigid motion that fits best: where a tracker stands is no error."""
    rigid = np.zeros((len(position_mm), 3, 6))
    rigid[:, :, :3] = np.eye(3)
    rigid[:, :, 3:] = cross_matrix(position_mm - position_mm.mean(axis=0))
    columns = rigid.reshape(-1, 6)
    motion, *_ = np.linalg.lstsq(columns, error_um.ravel(), rcond=None)
    return error_um - (columns @ motion).reshape(-1, 3)
