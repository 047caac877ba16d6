"""Does the direction of approach matter? Decided by the evidence of the data.

Three models are nested: errors alone; errors and a half width each; errors and tables
of both directions. A larger one is selected only if its evidence pays for its choice of
precisions, so that a machine without backlash is not given one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from truepath.estimation.problem.confounded_prior import (
    fit_confounded,
    guess_full_prior,
)
from truepath.estimation.problem.information import Information, Posterior
from truepath.estimation.problem.normal_equations import (
    RunInformation,
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.prior import BendingPrior, compute_evidence_cost
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.kinematics.coarse_model import NestedModels
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.model import MachineModel

# A precision fitted to nothing gains a little evidence; not this much, in −2 log.
_PRICE = 2.0


@dataclass(frozen=True, slots=True)
class Fit:
    """One model fitted to the data.

    direction : `none`, `constant` (half widths) or `tables` (both directions)
    found : information of each Run on the model, and on effects that its targets do not
        determine
    runs : the same on the model alone
    known : effects in it that an earlier measurement knows
    result : of the machine's parameters
    cost : −2 log evidence, with the penalty of its precisions
    """

    direction: str
    model: MachineModel
    found: tuple[RunInformation, ...]
    runs: tuple[RunInformation, ...]
    known: PriorEffects
    prior: BendingPrior
    result: Posterior
    cost: float

    @property
    def data(self) -> Information:
        return self.known.add_to(combine_runs(self.runs), self.model)


def select_fit(
    runs: Sequence[RunInput],
    models: NestedModels,
    known: PriorEffects | None = None,
) -> Fit:
    """The fit of greatest evidence among the models of the direction of approach.

    known : effects of the models that an earlier measurement knows

    Effects that the targets do not determine play no part in the choice.
    """
    known = known or PriorEffects()
    found = _collect_runs(runs, models, models.with_half_widths)
    none = _fit("none", models.alone, found, known)
    constant = _fit("constant", models.with_half_widths, found, known)
    if none.cost <= constant.cost:
        return none
    found = _collect_runs(runs, models, models.with_half_tables)
    tables = _fit("tables", models.with_half_tables, found, known)
    return min(constant, tables, key=lambda fit: fit.cost)


def _collect_runs(
    runs: Sequence[RunInput], models: NestedModels, model: MachineModel
) -> tuple[RunInformation, ...]:
    return collect_information(runs, model.with_confounded(models.confounded))


def include_confounded(fit: Fit, effects: Sequence[Effect]) -> Fit:
    """Adds the effects that the prior alone determines."""
    model = fit.model.with_confounded(effects)
    runs = tuple(run.restrict(model.effects) for run in fit.found)
    wider = replace(fit, model=model, runs=runs)
    prior, result = fit_confounded(fit.prior, fit.result, model, wider.data)
    return replace(wider, prior=prior, result=result)


def _fit(
    direction: str,
    model: MachineModel,
    found: tuple[RunInformation, ...],
    known: PriorEffects,
) -> Fit:
    runs = tuple(run.restrict(model.effects) for run in found)
    data = known.add_to(combine_runs(runs), model)
    prior, result = guess_full_prior(model).fit(data)
    precisions = len(model.effects) - len(model.error_motions)
    cost = compute_evidence_cost(data, prior, result) + _PRICE * precisions
    return Fit(direction, model, found, runs, known, prior, result, cost)
