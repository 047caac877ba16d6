"""Information of each of several Runs on one common set of parameters.

Each Run was estimated alone, with separate knots, direction of approach and noise, so
that a machine which has changed between them affects none. Here all refer to one model,
which has each effect as fine as any Run has it. The tracker's position and the seats of
targets belong to one Run and are integrated out: a rigid motion of the whole volume
between two Runs is not determined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import Information, OwnParameters
from truepath.estimation.problem.normal_equations import (
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.solve.batch import Estimate
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.model import MachineModel


@dataclass(frozen=True, slots=True)
class CommonBasis:
    """Information of Runs of one machine on the parameters of one model.

    precision : of the prior of the constant part, as the Runs have found it
    told : by each Run, its pose and seats integrated out
    """

    model: MachineModel
    precision: Float64[np.ndarray, "p p"]
    told: tuple[Information, ...]


def find_common_basis(estimates: Sequence[Estimate]) -> CommonBasis:
    """Information of single-Run estimates in a common basis.

    estimates : of one machine, each with its fit
    Raises BadInput if the Runs do not measure the same targets.
    """
    fits = [_require_fit(one) for one in estimates]
    effects = _select_finest([fit.model for fit in fits])
    names = {effect.name for effect in effects}
    if any(m.confounded != fits[0].model.confounded for m in (f.model for f in fits)):
        raise BadInput("the Runs do not measure the same targets: follow those apart")
    own = [effect for effect in effects if effect.role is Role.NUISANCE]
    machine = [effect for effect in effects if effect.role is not Role.NUISANCE]
    whole = MachineModel(
        fits[0].model.machine,
        (*machine, *own),
        fits[0].model.confounded & names,
    )
    model = replace(whole, effects=tuple(machine))
    precision = _find_precision(whole, fits)
    told = tuple(_collect(fit, whole, model.size, precision) for fit in fits)
    return CommonBasis(model, precision[: model.size, : model.size], told)


def _require_fit(estimate: Estimate) -> Fit:
    if estimate.fit is None:
        raise ValueError("an estimate that keeps what it was solved from is needed")
    return estimate.fit


def _select_finest(models: Sequence[MachineModel]) -> list[Effect]:
    """Each effect of any model once, with the most parameters that it has.

    Without confounded turns that others make up for: the model fits as well.
    """
    found: dict[str, Effect] = {}
    for model in models:
        for effect in model.effects:
            known = found.get(effect.name)
            finer = known is None or len(effect.parameters) > len(known.parameters)
            if finer and effect.name not in model.compensated_turns:
                found[effect.name] = effect
    return list(found.values())


def _find_precision(
    model: MachineModel, fits: Sequence[Fit]
) -> Float64[np.ndarray, "p p"]:
    total = np.zeros((model.size, model.size))
    for effect in model.effects:
        name, part = effect.name, model.slices[effect.name]
        having = [fit.prior for fit in fits if name in fit.prior.charges]
        same = [p for p in having if len(p.charges[name].form) == len(total[part])]
        if same:
            logs = [np.log(prior.precision[name]) for prior in having]
            total[part, part] = np.exp(np.mean(logs)) * same[0].charges[name].form
    return total


def _collect(
    fit: Fit,
    whole: MachineModel,
    kept: int,
    precision: Float64[np.ndarray, "p p"],
) -> Information:
    parts = [
        RunInput(run.observations, run.linearisation.pose, run.noise)
        for run in fit.runs
    ]
    told = combine_runs(collect_information(parts, whole))
    matrix = told.matrix.copy()
    matrix[kept:, kept:] += precision[kept:, kept:]
    return OwnParameters.of(replace(told, matrix=matrix), kept).eliminate()
