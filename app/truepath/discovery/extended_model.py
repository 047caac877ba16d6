"""The model extended by the findings, with joint covariance.

Effects of the machine become part of it. Effects of the measurement (drift, a step, the
tracker's own errors) were removed from the numbers and stay with their Run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.discovery.discover import Discovery, Finding
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import EstimatedModel, MachineModel, restore_effect


@dataclass(frozen=True)
class ExtendedModel(EstimatedModel):
    """A model of the machine with its parameters and their covariance.

    added : the findings that are part of it, with their effects
    """

    added: tuple[tuple[Finding, Effect], ...]

    def holds(self, finding: Finding) -> bool:
        """True if the finding is part of the model; compared by identity."""
        return any(finding is one for one, _ in self.added)


def extend_model(found: Discovery) -> ExtendedModel:
    """Includes the findings that persist with the machine."""
    base, fit = found.baseline.model, found.fit
    covariance = fit.posterior.covariance.copy()
    added: list[tuple[Finding, Effect]] = []
    columns = _list_columns(base)
    for number, term in enumerate(fit.terms):
        finding = next(f for f in found.findings if f.term is term)
        part = fit.part(number)
        covariance[part, part] += _spread_beyond(
            finding.covariance, covariance[part, part]
        )
        effect = _make_effect(finding, base)
        if effect is not None:
            added.append((finding, effect))
            columns.append((effect, part))
    model = _join([effect for effect, _ in columns], base)
    select = np.zeros((model.size, len(covariance)))
    for effect, part in columns:
        rows = np.arange(model.size)[model.slices[effect.name]]
        select[rows, np.arange(part.start, part.stop)] += 1.0
    theta = fit.posterior.theta.copy()
    theta[: base.size] += found.baseline.theta
    return ExtendedModel(
        model, select @ theta, select @ covariance @ select.T, tuple(added)
    )


def baseline_model(found: Discovery) -> ExtendedModel:
    """As estimated without the findings."""
    base, fit = found.baseline.model, found.baseline_fit.posterior
    columns = _list_columns(base)
    keep = np.concatenate([np.r_[part] for _, part in columns])
    model = replace(base, effects=tuple(effect for effect, _ in columns))
    theta = found.baseline.theta[keep] + fit.theta[keep]
    return ExtendedModel(model, theta, fit.covariance[np.ix_(keep, keep)], ())


def _list_columns(base: MachineModel) -> list[tuple[Effect, slice]]:
    of_machine = [e for e in base.effects if not is_tracker_error(e)]
    return [(effect, base.slices[effect.name]) for effect in of_machine]


def _make_effect(finding: Finding, model: MachineModel) -> Effect | None:
    """None if the effect ends with its Run."""
    family, candidate = finding.family, finding.candidate
    numbers = family.list_numbers(candidate)
    return restore_effect(family, model.machine, candidate.keys, numbers)


def _join(effects: list[Effect], base: MachineModel) -> MachineModel:
    once = {effect.name: effect for effect in reversed(effects)}
    names = dict.fromkeys(effect.name for effect in effects)
    return replace(base, effects=tuple(once[name] for name in names))


def _spread_beyond(
    stated: Float64[np.ndarray, "k k"], fitted: Float64[np.ndarray, "k k"]
) -> Float64[np.ndarray, "k k"]:
    """Addition to a covariance by scanned values; never negative."""
    value, vector = np.linalg.eigh(stated - fitted)
    return (vector * np.maximum(value, 0.0)) @ vector.T
