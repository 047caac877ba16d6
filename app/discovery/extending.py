"""The model with what was found: base and effects as one, with joint covariance.

What belongs to the machine becomes part of it. What belongs to the measurement (drift,
a step, the tracker's own errors) was taken out of the numbers and stays with its Run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.discovery.discover import Discovery, Finding
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogued import catalogued
from app.kinematics.model import MachineModel


@dataclass(frozen=True)
class Extended:
    """A model of the machine with its parameters and their covariance.

    added : the findings that are part of it, with their effects
    """

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    added: tuple[tuple[Finding, Effect], ...]

    def holds(self, finding: Finding) -> bool:
        """Tell whether a finding is part of the model."""
        return any(finding is one for one, _ in self.added)


def extended(found: Discovery) -> Extended:
    """Return the base of a discovery with the findings that the machine keeps."""
    base, fit = found.ground.base, found.explanation.fit
    ends = base.size + np.cumsum([len(f.theta) for f in _in_order(found)])
    covariance = fit.covariance.copy()
    kept: list[tuple[Finding, Effect]] = []
    columns = [(e, base.model.slices[e.name]) for e in base.model.effects]
    for finding, end in zip(_in_order(found), ends.tolist(), strict=True):
        part = slice(end - len(finding.theta), end)
        covariance[part, part] += _beyond(finding.covariance, covariance[part, part])
        effect = _of_machine(finding, base.model)
        if effect is not None:
            kept.append((finding, effect))
            columns.append((effect, part))
    model = _joined([effect for effect, _ in columns], base.model)
    select = np.zeros((model.size, len(fit.theta)))
    for effect, part in columns:
        rows = np.arange(model.size)[model.slices[effect.name]]
        select[rows, np.arange(part.start, part.stop)] += 1.0
    absolute = fit.theta.copy()
    absolute[: base.model.size] += base.theta
    return Extended(
        model, select @ absolute, select @ covariance @ select.T, tuple(kept)
    )


def plain(found: Discovery) -> Extended:
    """Return the base alone, as it is estimated without the findings."""
    base, fit = found.ground.base, found.plain.fit
    part = slice(0, base.model.size)
    theta = base.theta + fit.theta[part]
    return Extended(base.model, theta, fit.covariance[part, part], ())


def _in_order(found: Discovery) -> list[Finding]:
    """Return the findings in the order of the columns of the fit."""
    chosen = found.explanation.chosen
    return [next(f for f in found.findings if f.offer is offer) for offer in chosen]


def _of_machine(finding: Finding, model: MachineModel) -> Effect | None:
    family = finding.family
    if not family.in_machine:
        return None
    numbers = family.kept(finding.candidate)
    return catalogued(family, model.machine, finding.candidate.keys, numbers)


def _joined(effects: list[Effect], base: MachineModel) -> MachineModel:
    """Return a model in which an effect found again is not there twice."""
    once = {effect.name: effect for effect in reversed(effects)}
    names = dict.fromkeys(effect.name for effect in effects)
    return MachineModel(base.machine, tuple(once[name] for name in names))


def _beyond(
    stated: Float64[np.ndarray, "k k"], fitted: Float64[np.ndarray, "k k"]
) -> Float64[np.ndarray, "k k"]:
    """Return what scanned values add to a covariance; never less than nothing."""
    value, vector = np.linalg.eigh(stated - fitted)
    return (vector * np.maximum(value, 0.0)) @ vector.T
