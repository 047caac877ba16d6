"""The prior of effects that the measured targets do not tell from others.

The data fix what such effects do at the measured targets together with others: of a
turn and a displacement that it is confounded with, the sum E + L ω. How the sum is
split, and so what another target or another tool does, is for the prior to say; its
width is in the covariance, and there it cancels wherever the sum alone counts.

So this prior has to be proper, and of the size that errors of this machine have. The
bending precision is that of motions of its kind which are told: guides of one machine
are alike. Straight shapes, squarenesses and locations, which bending leaves free, are
drawn from those of their kind, told to better than usual, about 0 with

    σ² = (w σ₀² + Σ sᵢ²) / (w + n):

σ₀ is a usual size and counts as much as w of them. Where nothing of a kind is told, it
is all there is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.estimation.information import Posterior
from app.estimation.prior import USUAL_PRECISION, BendingPrior, find_kind_precisions
from app.kinematics.effects.base import Effect, QuadraticPrior
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.model import MachineModel

_WEIGHT = 2.0  # w: a usual size counts as much as two that are told
# σ₀ of what a motion changes by from end to end, and of a number: a location, an angle.
_USUAL_CHANGE = {"mm": 0.02, "rad": 4e-5}
_USUAL_NUMBER = {"mm": 0.05, "rad": 5e-5}
_FREE = 1e-9  # of the largest bending: none


def add_confounded(
    prior: BendingPrior, result: Posterior, model: MachineModel
) -> BendingPrior:
    """Return the prior with that of the model's confounded effects.

    prior, result : of the effects that are told; they come first in the model
    """
    sizes = _pool_sizes(prior.model, result)
    usual = find_kind_precisions(prior)
    charges, precision = dict(prior.charges), dict(prior.precision)
    for effect in model.effects:
        if effect.name not in model.confounded:
            continue
        straight = straight_precision(effect, sizes)
        bent, scale = effect.prior(), 1.0
        if bent:
            scale = usual.get(bent.kind, USUAL_PRECISION) / bent.usual
            straight = straight / scale + bent.form
        charges[effect.name] = QuadraticPrior(straight, len(straight), 1.0)
        precision[effect.name] = scale
    return replace(prior, model=model, charges=charges, precision=precision)


def straight_precision(
    effect: Effect, sizes: Mapping[str, float] | None = None
) -> Float64[np.ndarray, "p p"]:
    """Return the precision of what bending leaves free.

    sizes : σ by kind; usual ones where left out
    """
    kind, usual, rows = _find_free(effect)
    return np.diag((rows / (sizes or {}).get(kind, usual)) ** 2)


def _pool_sizes(model: MachineModel, result: Posterior) -> dict[str, float]:
    """Return σ of each kind that something is told of."""
    told: dict[str, list[float]] = {}
    usual_size: dict[str, float] = {}
    for kind, usual, value in _list_told(model, result):
        usual_size[kind] = usual
        told.setdefault(kind, []).append(value)
    return {
        kind: float(
            np.sqrt(
                (_WEIGHT * usual_size[kind] ** 2 + np.sum(np.square(values)))
                / (_WEIGHT + len(values))
            )
        )
        for kind, values in told.items()
    }


def _list_told(
    model: MachineModel, result: Posterior
) -> Iterator[tuple[str, float, float]]:
    """Yield kind, usual size and value of all that is told to better than usual."""
    for effect in model.effects:
        if not effect.iso_symbol:
            continue
        part = model.slices[effect.name]
        kind, usual, rows = _find_free(effect)
        variance = float(rows @ result.covariance[part, part] @ rows)
        if rows.any() and variance < usual**2:
            yield kind, usual, float(rows @ result.theta[part])


def _find_free(effect: Effect) -> tuple[str, float, Float64[np.ndarray, " p"]]:
    """Return kind, usual size and rows of what bending leaves free of an effect."""
    unit = effect.parameters[0].unit
    if not isinstance(effect, ErrorMotion):
        return f"number in {unit}", _USUAL_NUMBER[unit], np.ones(1)
    charge, axis = effect.prior(), effect.axis
    low, high = effect.rows(np.array([axis.low, axis.high]))
    bending = np.diag(charge.form)
    free = bending < _FREE * bending.max()
    return charge.kind, _USUAL_CHANGE[unit], np.where(free, high - low, 0.0)
