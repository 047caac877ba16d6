"""How much of each effect of a model the files correct, and how much remains.

The files are written and read back once more without the effect: the difference is the
correction of that effect. It needs no knowledge of what a format does with sag, with a
screw's wave between its rows, or with lost motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.compensation.axis_tables import CompensationTables
from app.compensation.error_map import ErrorMap
from app.compensation.format import CompensationFormat, Correction
from app.compensation.sample_positions import (
    remove_rigid_motion,
    sample_positions,
)
from app.files.units import UM_PER_MM
from app.kinematics.effects.catalogue_effect import CatalogueEffect
from app.kinematics.symbols import is_positioning

_NOTHING_MM = 1e-9
_SIDES = (1.0, -1.0)  # + and − direction


@dataclass(frozen=True, slots=True)
class EffectResidual:
    """One effect: its root mean square in the map, before and after the correction.

    before_um : over both directions, without rigid motion; 0 where the effect depends
        on speed, temperature or the distance since a reversal
    """

    effect: CatalogueEffect
    before_um: float
    after_um: float

    def to_json(self) -> dict[str, Any]:
        """Return the effect as the account states it."""
        beyond = self.before_um == 0.0
        return {
            "name": self.effect.family,
            **dict(self.effect.keys),
            "rms_um": {"before": self.before_um, "after": self.after_um},
            "note": "depends on more than place and direction: no table has it"
            if beyond
            else "",
        }


def evaluate_effects(
    errors: ErrorMap,
    kind: CompensationFormat,
    tabulate: Callable[[ErrorMap], CompensationTables],
    correction: Correction,
) -> Iterator[EffectResidual]:
    """Yield each effect of the model with what remains of it.

    tabulate : makes the tables that the format writes; correction : of its files
    """
    position = sample_positions(errors)
    for effect in errors.result.model.catalogue_effects:
        other = _remove_effect(errors, effect)
        reread = kind.read(kind.write(tabulate(other)), errors.machine)
        own = [
            errors.error_mm(position, s) - other.error_mm(position, s) for s in _SIDES
        ]
        done = [correction(position, s) - reread(position, s) for s in _SIDES]
        left = [error + added for error, added in zip(own, done, strict=True)]
        before, after = _compute_rms(position, own), _compute_rms(position, left)
        if before < _NOTHING_MM:
            before = after = 0.0
        yield EffectResidual(effect, UM_PER_MM * before, UM_PER_MM * after)


def _compute_rms(
    position: Float64[np.ndarray, "n a"], error_mm: Sequence[Float64[np.ndarray, "n 3"]]
) -> float:
    """Return the root mean square over both directions, without rigid motion."""
    every = remove_rigid_motion(np.vstack([position, position]), np.vstack(error_mm))
    return float(np.sqrt(3.0 * np.mean(every**2)))


def _remove_effect(errors: ErrorMap, effect: CatalogueEffect) -> ErrorMap:
    """Return the error map of the model without the effect."""
    theta = errors.result.theta.copy()
    theta[errors.result.model.slices[effect.name]] = 0.0
    half_tables = dict(errors.half_tables)
    lost = effect.half_difference
    if lost and is_positioning(lost.symbol):
        half_tables.pop(lost.axis.name, None)
    return replace(
        errors, result=replace(errors.result, theta=theta), half_tables=half_tables
    )
