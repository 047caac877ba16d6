"""The uncertainty budget as `result.json` states it: standard uncertainties in µm."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.estimation.budget import SOURCES, UncertaintyBudget
from truepath.app.files.units import UM_PER_MM

_ON = (
    "root mean square of the volumetric error over the travel, without the rigid "
    "motion of the whole volume, k = 1; squares add up to that of the total"
)


def budget_json(budget: UncertaintyBudget) -> dict[str, Any]:
    """Return the contribution of each source by direction, and the total."""
    variance = budget.variance_mm2
    return {
        "sources_um": {
            source: _state_um(row)
            for source, row in zip(SOURCES, variance, strict=True)
        },
        "total_um": _state_um(variance.sum(axis=0)),
        "on": _ON,
    }


def _state_um(variance_mm2: Float64[np.ndarray, "3"]) -> dict[str, float]:
    # The remainder of a difference may be below 0 by rounding.
    every = np.maximum([*variance_mm2, variance_mm2.sum()], 0.0)
    return dict(
        zip(
            ("x", "y", "z", "volume"),
            (UM_PER_MM * np.sqrt(every)).tolist(),
            strict=True,
        )
    )
