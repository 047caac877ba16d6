"""An effect of the catalogue as part of a machine's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, ErrorCurve, Parameter
from app.kinematics.effects.catalogue import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    find_family,
)
from app.kinematics.machine import Machine


@dataclass(frozen=True)
class CatalogueEffect(Effect):
    """An effect that knows its family, its keys and the numbers that make it again."""

    family: str
    keys: tuple[tuple[str, str], ...]
    numbers: tuple[tuple[str, float], ...]
    effect: Effect

    def spell(self, digits: str) -> str:
        """Return family, keys and numbers in one line."""
        numbers = (format(value, digits) for _, value in self.numbers)
        return " ".join([self.family, *(key for _, key in self.keys), *numbers])

    @property
    def title(self) -> str:
        """The effect in words: `Backlash of Y`."""
        return find_family(self.family).title(dict(self.keys))

    def state(
        self,
        theta: Float64[np.ndarray, " p"],
        covariance: Float64[np.ndarray, "p p"],
    ) -> dict[str, Quantity]:
        """Return what files state of it; the numbers that make it as they are."""
        family, usual = find_family(self.family), np.ones(len(theta))
        value = dict(self.numbers).get(family.value_name)
        known = Candidate(self.family, dict(self.keys), self.effect, usual, value)
        return family.state(CandidateEstimate(known, theta, covariance))

    @property
    def half_difference(self) -> ErrorCurve | None:
        """That of the effect."""
        return self.effect.half_difference

    @property
    def lag_axis(self) -> str:
        """That of the effect."""
        return self.effect.lag_axis

    @property
    def axis_pair(self) -> tuple[str, str] | None:
        """That of the effect."""
        return self.effect.axis_pair

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the effect."""
        return self.effect.parameters

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return that of the effect."""
        return self.effect.jacobian(at)


def restore_effect(
    family: Family,
    machine: Machine,
    keys: Mapping[str, str],
    numbers: Mapping[str, float],
) -> Effect | None:
    """Return the effect as part of a model; None if it ends with its Run.

    What has an ISO symbol is part of every model and stays what it is. Raises KeyError
    as `Family.restore`.
    """
    effect = family.restore(machine, keys, numbers)
    if effect is None or effect.iso_symbol:
        return effect
    fixed = tuple(keys.items()), tuple(numbers.items())
    return CatalogueEffect(family.name, *fixed, effect)
