"""What the files of a format leave of the error, as their controller reads them.

It is computed on a grid and between the rows of the tables. For an effect the files are
written and read back once more without it: the difference is its correction. That needs
no knowledge of what a format does with sag, with a screw's wave between its rows, or
with lost motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.compensation.error_map import ErrorMap
from app.compensation.format import CompensationFormat, CompensationTables, Correction
from app.files.units import UM_PER_MM
from app.kinematics.model import CatalogueEffect
from app.kinematics.symbols import is_positioning
from app.numerics.rigid import cross_matrix

GRID, RANDOM = 5, 400  # positions an axis of the grid; random positions
_NOTHING_MM = 1e-9
_SIDES = (1.0, -1.0)  # + and − direction


def _sample_positions(errors: ErrorMap) -> Float64[np.ndarray, "n a"]:
    """Return a grid over the travel, and random positions between rows."""
    low = np.array([axis.low for axis in errors.axes])
    high = np.array([axis.high for axis in errors.axes])
    places = np.meshgrid(*[np.linspace(0.0, 1.0, GRID)] * len(low), indexing="ij")
    unit = np.stack(places, -1).reshape(-1, len(low))
    random = np.random.default_rng(0).random((RANDOM, len(low)))
    position = np.tile(errors.middle_mm, (len(unit) + RANDOM, 1))
    position[:, : len(low)] = low + np.vstack([unit, random]) * (high - low)
    return position


def remove_rigid_motion(
    position_mm: Float64[np.ndarray, "n a"], error_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Remove the best-fit rigid motion, which is not an error of the machine."""
    point = position_mm[:, :3] - position_mm[:, :3].mean(axis=0)
    shifts = np.broadcast_to(np.eye(3), (len(point), 3, 3))
    flat = np.concatenate([shifts, cross_matrix(point)], axis=2).reshape(-1, 6)
    fit, *_ = np.linalg.lstsq(flat, error_mm.reshape(-1), rcond=None)
    return error_mm - (flat @ fit).reshape(-1, 3)


def measure_lengths(
    errors: ErrorMap, correction: Correction | None = None
) -> dict[str, float]:
    """Return mean and largest length, µm, of δ plus correction in both directions."""
    position = _sample_positions(errors)
    lengths: list[Float64[np.ndarray, " n"]] = []
    for side in _SIDES:
        error = errors.error_mm(position, side)
        if correction is not None:
            error = error + correction(position, side)
        lengths.append(np.linalg.norm(remove_rigid_motion(position, error), axis=1))
    every = UM_PER_MM * np.concatenate(lengths)
    return {"mean": float(every.mean()), "largest": float(every.max())}


def evaluate_effects(
    errors: ErrorMap,
    kind: CompensationFormat,
    tabulate: Callable[[ErrorMap], CompensationTables],
    correction: Correction,
) -> Iterator[dict[str, Any]]:
    """Yield what remains of each effect of the model, as the account states it.

    tabulate : makes the tables that the format writes; correction : of its files

    The root mean square is that over both directions without rigid motion; it is 0
    where the effect depends on speed, temperature or the distance since a reversal.
    """
    position = _sample_positions(errors)
    for effect in errors.result.model.catalogue_effects:
        other = _remove_effect(errors, effect)
        reread = kind.read(kind.write(tabulate(other)), errors.machine)
        own = [
            errors.error_mm(position, s) - other.error_mm(position, s) for s in _SIDES
        ]
        done = [correction(position, s) - reread(position, s) for s in _SIDES]
        remains = [error + added for error, added in zip(own, done, strict=True)]
        before, after = _compute_rms(position, own), _compute_rms(position, remains)
        beyond = before < _NOTHING_MM
        if beyond:
            before = after = 0.0
        yield {
            "name": effect.family,
            **dict(effect.keys),
            "rms_um": {"before": UM_PER_MM * before, "after": UM_PER_MM * after},
            "note": "depends on more than place and direction: no table has it"
            if beyond
            else "",
        }


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
    half_um = dict(errors.result.half_difference_um)
    lost = effect.half_difference
    if lost and is_positioning(lost.symbol):
        half_um.pop(lost.axis.name, None)
    result = replace(errors.result, theta=theta, half_difference_um=half_um)
    return replace(errors, result=result)
