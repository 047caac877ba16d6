"""A result against the machine's true errors, which only a simulated machine has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.compensation.remaining_error import remove_rigid_motion
from app.files.result_file import result_from_json
from app.results.prediction import predict

_POINTS = 500  # places in the volume at which errors are compared
_SEED = 7  # of the points, which the measurement does not use


@dataclass(frozen=True, slots=True)
class TruthComparison:
    """Volumetric error at points all over the travel, without rigid motion.

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
    before = remove_rigid_motion(position_mm, truth_um(position_mm))
    left = before - remove_rigid_motion(position_mm, predicted.error_um)
    return TruthComparison(
        float(np.linalg.norm(before, axis=1).mean()),
        float(np.linalg.norm(left, axis=1).mean()),
        float((np.abs(left) <= 2 * predicted.uncertainty_um).mean()),
    )
