"""A machine together with everything that moves its measured point off its nominal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue_effect import CatalogueEffect
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.machine import Machine


@dataclass(frozen=True)
class MachineModel:
    """A nominal machine and effects; θ is their parameters one after another."""

    machine: Machine
    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        """Refuse effects of one name: their parameters would share a place in θ."""
        names = [effect.name for effect in self.effects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"a model has one effect of a name; twice: {twice}")

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each effect's parameters lie in θ, by the effect's name."""
        found: dict[str, slice] = {}
        begin = 0
        for effect in self.effects:
            end = begin + len(effect.parameters)
            found[effect.name] = slice(begin, end)
            begin = end
        return found

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters in the order of θ."""
        return tuple(p for effect in self.effects for p in effect.parameters)

    @property
    def size(self) -> int:
        """Length of θ."""
        return len(self.parameters)

    @cached_property
    def error_motions(self) -> tuple[ErrorMotion, ...]:
        """The error motions, in the order of θ."""
        return tuple(e for e in self.effects if isinstance(e, ErrorMotion))

    @property
    def knows_all_motions(self) -> bool:
        """Whether it has all six error motions of every axis: it holds for any tool."""
        return len(self.error_motions) == 6 * len(self.machine.axes)

    @cached_property
    def catalogue_effects(self) -> tuple[CatalogueEffect, ...]:
        """The effects of the catalogue, in the order of θ."""
        return tuple(e for e in self.effects if isinstance(e, CatalogueEffect))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return ∂(displacement in the workpiece frame, mm)/∂θ."""
        columns = np.zeros((len(at), 3, self.size))
        for effect in self.effects:
            columns[:, :, self.slices[effect.name]] = effect.jacobian(at)
        return columns

    def with_effects(self, *more: Effect) -> MachineModel:
        """Return this model with further effects at the end."""
        return replace(self, effects=(*self.effects, *more))
