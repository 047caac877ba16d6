"""An effect of the catalogue as part of a machine's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue import Candidate, Family, Measured
from app.kinematics.effects.error_curve import ErrorCurve
from app.kinematics.machine import Machine


@dataclass(frozen=True)
class Catalogued(Effect):
    """An effect that knows its family, its keys and the numbers that make it again."""

    family: str
    keys: tuple[tuple[str, str], ...]
    numbers: tuple[tuple[str, float], ...]
    effect: Effect

    @property
    def name(self) -> str:
        """Family, keys and numbers in one line."""
        numbers = (f"{value:.5g}" for _, value in self.numbers)
        return " ".join([self.family, *(key for _, key in self.keys), *numbers])

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


def catalogued(
    family: Family,
    machine: Machine,
    keys: Mapping[str, str],
    numbers: Mapping[str, float],
) -> Effect | None:
    """Return the effect as part of a model; None if it ends with its Run.

    A squareness is part of every model and stays what it is. Raises KeyError as
    `Family.restored`.
    """
    effect = family.restored(machine, keys, numbers)
    if effect is None or family.name == "squareness":
        return effect
    return Catalogued(family.name, tuple(keys.items()), tuple(numbers.items()), effect)


def measured(
    family: Family,
    effect: Catalogued,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> dict[str, Measured]:
    """Return what files state of an effect in a model; its numbers as they are."""
    value = dict(effect.numbers).get(family.scanned)
    known = Candidate(
        family.name, dict(effect.keys), effect.effect, np.ones(len(theta)), value
    )
    return family.parameters(known, theta, covariance, 0.0)
