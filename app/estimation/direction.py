"""Does the direction of approach matter? Decided by the evidence of the data.

Three models are nested: errors alone; errors and a half width each; errors and tables
of both directions. A larger one is taken only if its evidence pays for its choice of
strengths, so that a machine without backlash is not given one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.estimation.information import Posterior
from app.estimation.prior import BendingPrior, evidence_cost, first_guess, fitted
from app.estimation.runs import (
    Measured,
    Share,
    shares_of,
    together,
    with_effects_only,
)
from app.kinematics.effects.approach import half_shape, half_width
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.model import MachineModel

# A strength fitted to nothing gains a little evidence; not this much, in −2 log.
_PRICE = 2.0


@dataclass(frozen=True, slots=True)
class Fit:
    """One model and what it makes of the data.

    direction : `none`, `constant` (half widths) or `tables` (both directions)
    shares : what each Run tells of the model
    result : of the machine's parameters
    cost : −2 log evidence, with the price of its strengths
    """

    direction: str
    model: MachineModel
    shares: tuple[Share, ...]
    prior: BendingPrior
    result: Posterior
    cost: float


def with_half_widths(model: MachineModel) -> MachineModel:
    """Return the model with a half width for each of its error motions."""
    return model.with_effects(*(half_width(m.symbol, m.axis) for m in _motions(model)))


def best_fit(runs: Sequence[Measured], model: MachineModel) -> Fit:
    """Return the fit of greatest evidence, the direction of approach left to it."""
    halves = with_half_widths(model)
    shares = shares_of(runs, halves)
    fewer = tuple(with_effects_only(share, model.effects) for share in shares)
    none = _fit("none", model, fewer)
    constant = _fit("constant", halves, shares)
    if none.cost <= constant.cost:
        return none
    shapes = [half_shape(m.symbol, m.axis) for m in _motions(model)]
    both = halves.with_effects(*shapes)
    tables = _fit("tables", both, shares_of(runs, both))
    return min(constant, tables, key=lambda fit: fit.cost)


def _fit(direction: str, model: MachineModel, shares: tuple[Share, ...]) -> Fit:
    data = together(shares)
    prior, result = fitted(data, first_guess(model))
    strengths = sum(not isinstance(e, ErrorMotion) for e in model.effects)
    cost = evidence_cost(data, prior, result) + _PRICE * strengths
    return Fit(direction, model, shares, prior, result, cost)


def _motions(model: MachineModel) -> list[ErrorMotion]:
    return [e for e in model.effects if isinstance(e, ErrorMotion)]
