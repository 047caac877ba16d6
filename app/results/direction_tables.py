"""What the direction of approach adds to the error tables.

Going up an axis errs by its table plus the half difference, coming down by the table
less it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.files.units import scale_of
from app.kinematics.effects.base import ErrorCurve
from app.kinematics.model import MachineModel
from app.kinematics.symbols import find_unit
from app.results.error_tables import choose_table_positions


@dataclass(frozen=True, slots=True)
class HalfDifference:
    """Half the difference of both directions of one error motion.

    unit : "um" or "urad", of `value` and `uncertainty` (k = 1)
    """

    symbol: str
    unit: str
    position_mm: Float64[np.ndarray, " n"]
    value: Float64[np.ndarray, " n"]
    uncertainty: Float64[np.ndarray, " n"]

    @property
    def shows(self) -> bool:
        """Tell whether it stands out of its expanded uncertainty anywhere."""
        return bool(np.any(np.abs(self.value) > 2.0 * self.uncertainty))


def compute_half_differences(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[HalfDifference, ...]:
    """Return the half differences; none where direction plays no part."""
    parts = [
        (effect.name, lost)
        for effect in model.effects
        if (lost := effect.half_difference)
    ]
    return tuple(
        _half_difference(
            [p for p in parts if p[1].symbol == symbol], model, theta, covariance
        )
        for symbol in dict.fromkeys(lost.symbol for _, lost in parts)
    )


def _half_difference(
    parts: list[tuple[str, ErrorCurve]],
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> HalfDifference:
    width = parts[0][1]
    at_mm = choose_table_positions(width.axis)
    rows = np.zeros((len(at_mm), model.size))
    for name, part in parts:
        rows[:, model.slices[name]] = part.rows(at_mm)
    scale = scale_of(find_unit(width.symbol))
    variance = np.einsum("np,np->n", rows @ covariance, rows)
    return HalfDifference(
        width.symbol,
        find_unit(width.symbol),
        at_mm,
        scale * (rows @ theta),
        scale * np.sqrt(np.maximum(variance, 0.0)),
    )
