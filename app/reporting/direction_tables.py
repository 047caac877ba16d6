"""What the direction of approach adds to the error tables.

Going up an axis errs by its table plus the half difference, coming down by the table
less it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.effects.approach import Backlash
from app.kinematics.model import MachineModel
from app.kinematics.symbols import is_turn
from app.reporting.error_tables import MICRO, MILLI, table_positions_mm


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


def half_differences(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[HalfDifference, ...]:
    """Return the half differences; none where direction plays no part."""
    parts = [e for e in model.effects if isinstance(e, Backlash)]
    return tuple(
        _half_difference(
            [p for p in parts if p.symbol == width.symbol], model, theta, covariance
        )
        for width in parts
        if not width.varies
    )


def directional(model: MachineModel) -> tuple[str, ...]:
    """Return the names of the effects that the direction of approach decides."""
    return tuple(e.name for e in model.effects if isinstance(e, Backlash))


def _half_difference(
    parts: list[Backlash],
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> HalfDifference:
    at_mm = table_positions_mm(parts[0].axis)
    rows = np.zeros((len(at_mm), model.size))
    for part in parts:
        rows[:, model.slices[part.name]] = part.rows(at_mm)
    turn = is_turn(parts[0].symbol)
    scale = MICRO if turn else MILLI
    variance = np.einsum("np,np->n", rows @ covariance, rows)
    return HalfDifference(
        parts[0].symbol,
        "urad" if turn else "um",
        at_mm,
        scale * (rows @ theta),
        scale * np.sqrt(np.maximum(variance, 0.0)),
    )
