"""Does the direction of approach matter? Decided by the evidence of the data.

Three models are nested: errors alone; errors and a half width each; errors and tables
of both directions. A larger one is taken only if its evidence pays for its choice of
strengths, so that a machine without backlash is not given one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.alignment.observations import Observations
from app.estimation.information import Information, Posterior, information
from app.estimation.noise import NoiseModel
from app.estimation.prior import BendingPrior, evidence_cost, first_guess, fitted
from app.estimation.problem import Problem, pose_problem, with_machine_effects
from app.kinematics.effects.approach import half_shape, half_width
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform

# A strength fitted to nothing gains a little evidence; not this much, in −2 log.
_PRICE = 2.0


@dataclass(frozen=True, slots=True)
class Fit:
    """One model and what it makes of the data.

    direction : `none`, `constant` (half widths) or `tables` (both directions)
    cost : −2 log evidence, with the price of its strengths
    """

    direction: str
    problem: Problem
    prior: BendingPrior
    result: Posterior
    cost: float


def with_half_widths(model: MachineModel) -> MachineModel:
    """Return the model with a half width for each of its error motions."""
    return model.with_effects(*(half_width(m.symbol, m.axis) for m in _motions(model)))


def best_fit(
    seen: Observations, model: MachineModel, pose: RigidTransform, noise: NoiseModel
) -> Fit:
    """Return the fit of greatest evidence, the direction of approach left to it."""
    halves = with_half_widths(model)
    problem = pose_problem(seen, halves, pose)
    data = information(problem, noise)
    none = _fit("none", with_machine_effects(problem, model.effects), data, halves)
    constant = _fit("constant", problem, data, halves)
    if none.cost <= constant.cost:
        return none
    shapes = [half_shape(m.symbol, m.axis) for m in _motions(model)]
    both = halves.with_effects(*shapes)
    problem = pose_problem(seen, both, pose)
    tables = _fit("tables", problem, information(problem, noise), both)
    return min(constant, tables, key=lambda fit: fit.cost)


def _fit(
    direction: str, problem: Problem, data: Information, columns: MachineModel
) -> Fit:
    """Fit the problem from data that may have columns of a larger model."""
    names = {e.name for e in problem.model.effects}
    keep = np.ones(len(data.vector), bool)
    for effect in columns.effects:
        keep[columns.slices[effect.name]] = effect.name in names
    part = Information(
        data.matrix[np.ix_(keep, keep)],
        data.vector[keep],
        data.square,
        data.log_determinant,
    )
    machine = problem.machine_model
    prior, result = fitted(part, first_guess(machine))
    strengths = sum(not isinstance(e, ErrorMotion) for e in machine.effects)
    cost = evidence_cost(part, prior, result) + _PRICE * strengths
    return Fit(direction, problem, prior, result, cost)


def _motions(model: MachineModel) -> list[ErrorMotion]:
    return [e for e in model.effects if isinstance(e, ErrorMotion)]
