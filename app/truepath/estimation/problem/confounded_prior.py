"""The prior of effects that the measured targets do not distinguish from others.

The data determine only the joint effect at the measured targets: for a turn and a
displacement that it is confounded with, the sum E + L ω. The split of the sum, and so
the error at another target or tool, follows from the prior; its width is in the
covariance, and there it cancels wherever the sum alone counts.

So this prior has to be proper, and of the size of this machine's errors. The bending
precision is that of determined motions of the same kind, as guides of one machine are
alike: of their smoothest shapes, for these are the large ones. The evidence counts all
that the data show, and where errors have no fine shapes it takes the smoothest for
smaller than they are. Turns of a rotary axis that share in a split have one precision:
the evidence would take one of them for large and the others for small, which nothing
supports. Straight shapes, squarenesses and locations, which bending leaves free, are
distributed as those of their kind that are determined to better than typical size,
about 0 with

    σ² = (w σ₀² + Σ sᵢ²) / (w + n):

σ₀ is a typical size and has the weight of w of them. Where nothing of a kind is
determined, σ₀ stands alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.estimation.problem.information import (
    Information,
    Posterior,
    compute_posterior,
)
from truepath.estimation.problem.prior import USUAL_PRECISION, BendingPrior, guess_prior
from truepath.kinematics.effects.base import Effect, QuadraticPrior
from truepath.kinematics.effects.error_motion import AxisLocation, ErrorMotion
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.symbols import is_turn
from truepath.kinematics.model import MachineModel

_WEIGHT = 2.0  # w: a typical size counts as much as two determined ones
# σ₀ of a motion's change from end to end, and of a number: a location, an angle.
_USUAL_CHANGE = {"mm": 0.02, "rad": 4e-5}
_USUAL_NUMBER = {"mm": 0.05, "rad": 5e-5}
_FREE = 1e-9  # of the largest bending: none
_ROUNDS = 4  # in which precisions of the smoothest shapes settle
_COUNTED = 1  # shape that gives the size of a motion: the smoothest is the largest
_SMOOTH = 4  # shapes of a motion: two waves around, or two over the travel


def guess_full_prior(model: MachineModel) -> BendingPrior:
    """Prior of typical size, proper for confounded effects."""
    confounded = _list_confounded(model)
    return guess_prior(model, {e.name: straight_precision(e) for e in confounded})


def _list_confounded(model: MachineModel) -> Iterator[Effect]:
    """Confounded effects, and the axis locations of such motions: the mean of a motion
    across an axis is location, and as undetermined as the motion.
    """
    axes = {m.axis for m in model.error_motions if m.name in model.confounded}
    for effect in model.effects:
        is_place = isinstance(effect, AxisLocation) and effect.axis in axes
        if is_place or effect.name in model.confounded:
            yield effect


@dataclass(frozen=True)
class FullPrior:
    """Prior of all effects, with precisions from the determined ones.

    determined : of the effects that the fit needs; they come first in the model
    full : of all effects, including those that the targets do not determine
    """

    determined: BendingPrior
    full: BendingPrior

    @staticmethod
    def guess(determined: MachineModel, others: Sequence[Effect]) -> FullPrior:
        prior = guess_full_prior(determined)
        full = add_confounded(prior, None, determined.with_confounded(others))
        return FullPrior(prior, full)

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        return self.full.precision_matrix(size)

    def fit(self, data: Information) -> tuple[FullPrior, Posterior]:
        size, first = len(data.vector), self.determined.model.size
        others = np.s_[first : self.full.model.size]
        determined, result = self.determined.fit(
            data.select(np.delete(np.arange(size), others))
        )
        full, result = fit_confounded(determined, result, self.full.model, data)
        return FullPrior(determined, full), result

    def widen_tracker(self, times: float) -> FullPrior:
        return FullPrior(
            self.determined.widen_tracker(times), self.full.widen_tracker(times)
        )

    def measure_departure(self, theta: Float64[np.ndarray, " p"]) -> float:
        """Always 0: there is no reference."""
        del theta
        return 0.0


def fit_confounded(
    prior: BendingPrior, result: Posterior, model: MachineModel, data: Information
) -> tuple[BendingPrior, Posterior]:
    """Prior and posterior of a model with all confounded effects.

    prior, result : of the determined effects; they come first in the model
    """
    turns = any(isinstance(m.axis, RotaryAxis) for m in _list_coupled(model))
    for _ in range(_ROUNDS if turns else len(model.confounded) > 0):
        prior = add_confounded(prior, result, model)
        result = compute_posterior(data, prior.precision_matrix(len(data.vector)))
    return replace(prior, model=model), result


def add_confounded(
    prior: BendingPrior, result: Posterior | None, model: MachineModel
) -> BendingPrior:
    """Extends the prior to the model's confounded effects.

    prior, result : of the determined effects, which come first in the model; without a
        result, typical sizes
    """
    sizes = _pool_sizes(prior.model, result) if result else {}
    found = _pool_precisions(prior.model, result) if result else {}
    penalties, precision = dict(prior.penalties), dict(prior.precision)
    for motion in _list_coupled(model):
        bent = motion.prior()
        kind = found.get(bent.kind, USUAL_PRECISION)
        own = found.get(f"{bent.kind} {motion.axis.name}", kind)
        usual = 2.0 / (1.0 / kind + 1.0 / own) / bent.typical
        if not is_turn(motion.symbol):
            usual = min(usual, precision.get(motion.name, usual))
        precision[motion.name] = usual
        penalties[motion.name] = replace(bent, counted=_COUNTED)
    for effect in _list_confounded(model):
        form = straight_precision(effect, sizes)
        bent = penalties.get(effect.name) if effect.motion else None
        if bent:
            form = form / precision[effect.name] + bent.form
        counted = bent.counted if bent else 0
        penalties[effect.name] = QuadraticPrior(form, len(form), 1.0, counted=counted)
        precision.setdefault(effect.name, 1.0)
    return replace(prior, model=model, penalties=penalties, precision=precision)


def _list_coupled(model: MachineModel) -> Iterator[ErrorMotion]:
    """Confounded motions, and of a rotary axis all that share in their split."""
    axes = {m.axis for m in model.error_motions if m.name in model.confounded}
    for motion in model.error_motions:
        shares = isinstance(motion.axis, RotaryAxis) and motion.axis in axes
        if shares or motion.name in model.confounded:
            yield motion


def _pool_precisions(model: MachineModel, result: Posterior) -> dict[str, float]:
    """Precisions by smooth shapes at typical size 1: by kind, and by kind and axis."""
    energies: dict[str, list[float]] = {}
    for motion in model.error_motions:
        part, penalty = model.slices[motion.name], motion.prior()
        form = np.diag(penalty.form)
        smooth = np.flatnonzero(form > _FREE * form.max())[:_SMOOTH]
        square = result.theta[part] ** 2 + np.diag(result.covariance[part, part])
        energy = float(np.mean(form[smooth] * square[smooth])) / penalty.typical
        on_axis = f"{penalty.kind} {motion.axis.name}"
        energies.setdefault(on_axis, [1.0 / USUAL_PRECISION]).append(energy)
        if motion.name not in model.confounded:
            every = energies.setdefault(penalty.kind, [1.0 / USUAL_PRECISION] * 2)
            every.append(energy)
    return {name: 1.0 / float(np.mean(each)) for name, each in energies.items()}


def straight_precision(
    effect: Effect, sizes: Mapping[str, float] | None = None
) -> Float64[np.ndarray, "p p"]:
    """Precision of the shapes that bending leaves free.

    sizes : σ by kind; typical ones for kinds that it lacks
    """
    kind, usual, rows = _describe_free_shapes(effect)
    return np.diag((rows / (sizes or {}).get(kind, usual)) ** 2)


def _pool_sizes(model: MachineModel, result: Posterior) -> dict[str, float]:
    values_of: dict[str, list[float]] = {}
    typical_of: dict[str, float] = {}
    for kind, usual, value in _list_determined(model, result):
        typical_of[kind] = usual
        values_of.setdefault(kind, []).append(value)
    return {
        kind: float(
            np.sqrt(
                (_WEIGHT * typical_of[kind] ** 2 + np.sum(np.square(values)))
                / (_WEIGHT + len(values))
            )
        )
        for kind, values in values_of.items()
    }


def _list_determined(
    model: MachineModel, result: Posterior
) -> Iterator[tuple[str, float, float]]:
    """Kind, typical size and value of all effects determined to better."""
    for effect in model.effects:
        if not effect.iso_symbol or effect.name in model.confounded:
            continue
        part = model.slices[effect.name]
        kind, usual, rows = _describe_free_shapes(effect)
        variance = float(rows @ result.covariance[part, part] @ rows)
        if rows.any() and variance < usual**2:
            yield kind, usual, float(rows @ result.theta[part])


def _describe_free_shapes(
    effect: Effect,
) -> tuple[str, float, Float64[np.ndarray, " p"]]:
    """Kind, typical size and rows of the shapes that bending leaves free."""
    unit = effect.parameters[0].unit
    if not isinstance(effect, ErrorMotion):
        return f"number in {unit}", _USUAL_NUMBER[unit], np.ones(1)
    penalty, axis = effect.prior(), effect.axis
    low, high = effect.rows(np.array([axis.low, axis.high]))
    bending = np.diag(penalty.form)
    free = bending < _FREE * bending.max()
    return penalty.kind, _USUAL_CHANGE[unit], np.where(free, high - low, 0.0)
