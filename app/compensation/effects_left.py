"""What the files of a format leave of each effect of a model.

The files are written and read back once more without the effect: the difference is its
correction. That needs no knowledge of what a format does with sag, with a screw's wave
between its rows, or with lost motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.error_map import ErrorMap
from truepath.app.compensation.format import Correction
from truepath.app.compensation.remaining_error import (
    SIDES,
    remove_from_both,
    sample_travel,
)
from truepath.app.compensation.tabulation import Tabulation
from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.model import CatalogueEffect
from truepath.app.kinematics.symbols import is_positioning
from truepath.app.results.lost_motion_across import remove_across

_NOTHING_MM = 1e-9


def evaluate_effects(
    errors: ErrorMap, made: Tabulation, correction: Correction
) -> Iterator[dict[str, Any]]:
    """Yield what remains of each effect of the model, as the account states it.

    made : the tables that the format writes; correction : of its files

    The root mean square is that over both directions without rigid motion; it is 0
    where the effect depends on speed, temperature or the distance since a reversal.
    """
    position, weight = sample_travel(errors)
    for effect in errors.result.model.catalogue_effects:
        other = _remove_effect(errors, effect)
        reread = made.read_back(other)
        own = [
            errors.error_mm(position, s) - other.error_mm(position, s) for s in SIDES
        ]
        done = [correction(position, s) - reread(position, s) for s in SIDES]
        remains = [error + added for error, added in zip(own, done, strict=True)]
        before = _compute_rms(position, own, weight)
        after = _compute_rms(position, remains, weight)
        beyond = before < _NOTHING_MM
        if beyond:
            before = after = 0.0
        yield {
            "name": effect.family,
            **dict(effect.keys),
            "rms_um": {"before": UM_PER_MM * before, "after": UM_PER_MM * after},
            "note": _explain_nothing(effect) if beyond else "",
        }


def _explain_nothing(effect: CatalogueEffect) -> str:
    if effect.half_difference:
        return "lost motion of a rotary axis: in the account of that axis"
    return "depends on more than place and direction: no table has it"


def _compute_rms(
    position: Float64[np.ndarray, "n a"],
    error_mm: Sequence[Float64[np.ndarray, "n 3"]],
    weight: Float64[np.ndarray, " n"],
) -> float:
    """Return the root mean square over both directions, without rigid motion."""
    every = remove_from_both(position, error_mm, weight)
    return float(np.sqrt(weight @ (every**2).sum(axis=2).mean(axis=0)))


def _remove_effect(errors: ErrorMap, effect: CatalogueEffect) -> ErrorMap:
    theta = errors.result.theta.copy()
    theta[errors.result.model.slices[effect.name]] = 0.0
    half_um = dict(errors.result.half_difference_um)
    lost = effect.half_difference
    if lost and is_positioning(lost.symbol):
        half_um.pop(lost.axis.name, None)
    result = replace(errors.result, theta=theta, half_difference_um=half_um)
    if lost:
        result = remove_across(result, lost.symbol)
    return replace(errors, result=result)
