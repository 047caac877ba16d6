"""Effects from a model in an analysis: as known before it, and with it.

The Run is tested against the prior: where it moves an effect further than chance would,
the machine is no longer as the model has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truepath.estimation.problem.prior_model import PriorEffects, PriorModel
from truepath.kinematics.effects.family import Quantity
from truepath.kinematics.model import CatalogueEffect, EstimatedModel
from truepath.planning.forecast import Forecast

_DOUBTFUL = 1e-3  # chance below which a Run contradicts what was known


@dataclass(frozen=True, slots=True)
class UpdatedEffect:
    """One effect of the machine.

    before, after : its numbers in the model, and with the Run
    chance : of so large a difference if nothing has changed; None where the Run does
        not determine it
    """

    effect: CatalogueEffect
    before: dict[str, Quantity]
    after: dict[str, Quantity]
    chance: float | None

    @property
    def title(self) -> str:
        """English title of the catalogue."""
        return self.effect.title

    @property
    def agrees(self) -> bool | None:
        """None where the Run does not determine the effect."""
        return None if self.chance is None else self.chance >= _DOUBTFUL


def list_updated_effects(
    known: PriorEffects, estimated: EstimatedModel, chances: Sequence[float | None]
) -> tuple[UpdatedEffect, ...]:
    """Prior effects, with the parameters of the present model.

    chances : of each effect, as `UpdatedEffect.chance`
    """
    found: list[UpdatedEffect] = []
    begin = 0
    for effect, chance in zip(known.effects, chances, strict=True):
        own = slice(begin, begin + len(effect.parameters))
        begin = own.stop
        before = effect.state(known.theta[own], known.covariance[own, own])
        after = effect.state(*estimated.part(effect.name))
        found.append(UpdatedEffect(effect, before, after, chance))
    return tuple(found)


def state_updated_effects(
    effects: tuple[UpdatedEffect, ...], *, repeats_model: bool
) -> list[dict[str, Any]]:
    """Content of the key `effects` of `result.json`."""
    if repeats_model:  # nothing was known before
        return [_effect_json(one, None) | {"agrees": None} for one in effects]
    return [
        _effect_json(one, parameters_json(one.before)) | {"agrees": one.agrees}
        for one in effects
    ]


def parameters_json(found: Mapping[str, Quantity]) -> dict[str, Any]:
    """Values and uncertainties; `name[x]`, `name[y]` … make a list."""
    stated: dict[str, Any] = {}
    for name, m in found.items():
        whole, vector, _ = name.partition("[")
        if not vector:
            stated[name] = {"value": m.value, "uncertainty": m.uncertainty}
            continue
        parts = stated.setdefault(whole, {"value": [], "uncertainty": []})
        parts["value"].append(m.value)
        parts["uncertainty"].append(m.uncertainty)
    return stated


def state_predicted_effects(found: Forecast) -> list[dict[str, Any]]:
    """Effects of a plan: as known, and as predicted after its measurement."""
    known, model = found.known, found.model
    theta = np.zeros(model.size)
    theta[known.locate(model)] = known.theta
    after = EstimatedModel(model, theta, found.covariance)
    effects = list_updated_effects(known, after, [None] * len(known.effects))
    return [_effect_json(one, parameters_json(one.before)) for one in effects]


def _effect_json(one: UpdatedEffect, before: dict[str, Any] | None) -> dict[str, Any]:
    return {
        "name": one.effect.family,
        **dict(one.effect.keys),
        "parameters": parameters_json(one.after),
        "known_before": before,
    }


def prior_model_json(model: PriorModel) -> dict[str, Any]:
    """The model that a result or a plan was made with."""
    return {"source": model.source, "version": model.version, "sha256": model.sha256}


def describe_use(model: PriorModel, *, repeats_model: bool) -> str:
    """Sentence on what an analysis has taken from a model, and what not."""
    if repeats_model:
        taken = (
            "the effects of the machine; their numbers are estimated from this "
            "measurement alone, for the model was made from it; so are the error "
            "motions"
        )
    else:
        taken = (
            "the effects of the machine, their numbers with their covariance as prior "
            "knowledge; the error motions are measured anew"
        )
    ended = model.result.ended
    if not ended:
        return taken
    return (
        f"{taken}. Left out: {', '.join(ended)}, which ended with the measurement that "
        "showed it; what the tracker may be off by is estimated anew"
    )
