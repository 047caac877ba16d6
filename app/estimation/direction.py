"""Does the direction of approach matter? Decided by the evidence of the data.

Three models are nested: errors alone; errors and a half width each; errors and tables
of both directions. A larger one is taken only if its evidence pays for its choice of
precisions, so that a machine without backlash is not given one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from app.estimation.confounded_prior import add_confounded
from app.estimation.information import Information, Posterior, compute_posterior
from app.estimation.known_effects import KnownEffects
from app.estimation.prior import (
    BendingPrior,
    compute_evidence_cost,
    guess_prior,
)
from app.estimation.runs import (
    RunInformation,
    RunInput,
    collect_information,
    combine_runs,
)
from app.kinematics.coarse_model import NestedModels
from app.kinematics.effects.base import Effect
from app.kinematics.model import MachineModel

# A precision fitted to nothing gains a little evidence; not this much, in −2 log.
_PRICE = 2.0


@dataclass(frozen=True, slots=True)
class Fit:
    """One model and what it makes of the data.

    direction : `none`, `constant` (half widths) or `tables` (both directions)
    runs : information of each Run on the model
    known : effects in it that an earlier measurement knows
    result : of the machine's parameters
    cost : −2 log evidence, with the price of its precisions
    """

    direction: str
    model: MachineModel
    runs: tuple[RunInformation, ...]
    known: KnownEffects
    prior: BendingPrior
    result: Posterior
    cost: float

    @property
    def data(self) -> Information:
        """What all Runs, and what was known before them, tell of the machine."""
        return self.known.add_to(combine_runs(self.runs), self.model)


def select_fit(
    runs: Sequence[RunInput],
    models: NestedModels,
    known: KnownEffects | None = None,
) -> Fit:
    """Return the fit of greatest evidence, the direction of approach left to it.

    known : effects of the models that an earlier measurement knows

    Effects that the targets do not tell play no part in the choice; under their prior
    they are in the fit that is returned.
    """
    known = known or KnownEffects()
    found = _collect(runs, models, models.constant)
    none = _fit("none", models.alone, found, known)
    constant = _fit("constant", models.constant, found, known)
    if none.cost <= constant.cost:
        return _add_confounded(none, models.confounded, found)
    tables = _collect(runs, models, models.tables)
    larger = _fit("tables", models.tables, tables, known)
    if constant.cost <= larger.cost:
        return _add_confounded(constant, models.confounded, found)
    return _add_confounded(larger, models.confounded, tables)


def _collect(
    runs: Sequence[RunInput], models: NestedModels, model: MachineModel
) -> tuple[RunInformation, ...]:
    return collect_information(runs, model.with_confounded(models.confounded))


def _add_confounded(
    fit: Fit, confounded: Sequence[Effect], found: tuple[RunInformation, ...]
) -> Fit:
    """Return the fit with effects of which a prior alone says what they are.

    found : information on the fit's model and on them
    """
    if not confounded:
        return fit
    model = fit.model.with_confounded(confounded)
    prior = add_confounded(fit.prior, fit.result, model)
    narrow = tuple(run.restrict(model.effects) for run in found)
    added = replace(fit, model=model, prior=prior, runs=narrow)
    precision = prior.precision_matrix(model.size)
    return replace(added, result=compute_posterior(added.data, precision))


def _fit(
    direction: str,
    model: MachineModel,
    found: tuple[RunInformation, ...],
    known: KnownEffects,
) -> Fit:
    runs = tuple(run.restrict(model.effects) for run in found)
    data = known.add_to(combine_runs(runs), model)
    prior, result = guess_prior(model).fit(data)
    precisions = len(model.effects) - len(model.error_motions)
    cost = compute_evidence_cost(data, prior, result) + _PRICE * precisions
    return Fit(direction, model, runs, known, prior, result, cost)
