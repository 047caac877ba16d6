"""A machine together with all effects that move its measured point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_factor, cho_solve

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, ErrorCurve, Parameter, Role
from truepath.kinematics.effects.error_motion import (
    ErrorMotion,
    reference_position_mm,
)
from truepath.kinematics.effects.family import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    find_family,
)
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.machine.symbols import is_positioning


@dataclass(frozen=True)
class CatalogueEffect(Effect):
    """An effect with its family, and the keys and numbers that restore it."""

    family: str
    keys: tuple[tuple[str, str], ...]
    numbers: tuple[tuple[str, float], ...]
    effect: Effect

    def compose_name(self, digits: str) -> str:
        """Family, keys and numbers in one line."""
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
        """Values for files; the numbers that restore it are exact."""
        family, typical = find_family(self.family), np.ones(len(theta))
        value = dict(self.numbers).get(family.value_name)
        known = Candidate(self.family, dict(self.keys), self.effect, typical, value)
        return family.state(CandidateEstimate(known, theta, covariance))

    @property
    def half_difference(self) -> ErrorCurve | None:
        return self.effect.half_difference

    @property
    def lag_axis(self) -> str:
        return self.effect.lag_axis

    @property
    def axis_pair(self) -> tuple[str, str] | None:
        return self.effect.axis_pair

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.effect.parameters

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        return self.effect.jacobian(at)


@dataclass(frozen=True)
class MachineModel:
    """A nominal machine and effects; θ is their parameters one after another.

    confounded : names of effects that the measured targets do not distinguish from
        others; they are known from a prior alone
    """

    machine: Machine
    effects: tuple[Effect, ...]
    confounded: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Raises ValueError for two effects of one name: they would share θ."""
        names = [effect.name for effect in self.effects]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"a model has one effect of a name; twice: {twice}")

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Places of each effect's parameters in θ, by the effect's name."""
        found: dict[str, slice] = {}
        begin = 0
        for effect in self.effects:
            end = begin + len(effect.parameters)
            found[effect.name] = slice(begin, end)
            begin = end
        return found

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(p for effect in self.effects for p in effect.parameters)

    @property
    def size(self) -> int:
        """Length of θ."""
        return len(self.parameters)

    @cached_property
    def error_motions(self) -> tuple[ErrorMotion, ...]:
        return tuple(e for e in self.effects if isinstance(e, ErrorMotion))

    @property
    def knows_all_motions(self) -> bool:
        """Whether all six motions of all axes are determined: it holds for any tool."""
        return len(self.identifiable_motions) == 6 * len(self.machine.axes)

    @cached_property
    def identifiable_motions(self) -> tuple[ErrorMotion, ...]:
        """Error motions that the measured targets determine."""
        return tuple(m for m in self.error_motions if m.name not in self.confounded)

    @cached_property
    def compensated_turns(self) -> frozenset[str]:
        """Names of the confounded motions that others make up for at the targets.

        A turn of a linear axis that is confounded has a constant arm at the measured
        targets: a displacement of the axis makes up for it. What is confounded of a
        rotary axis is not among them: no one displacement makes up for it.
        """
        return frozenset(
            m.name
            for m in self.error_motions
            if m.name in self.confounded and isinstance(m.axis, LinearAxis)
        )

    @cached_property
    def catalogue_effects(self) -> tuple[CatalogueEffect, ...]:
        return tuple(e for e in self.effects if isinstance(e, CatalogueEffect))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """∂(displacement in the observer's frame, mm)/∂θ."""
        columns = np.zeros((len(at), 3, self.size))
        for effect in self.effects:
            columns[:, :, self.slices[effect.name]] = effect.jacobian(at)
        return columns

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        moved = np.zeros((len(at), 3))
        for effect in self.effects:
            moved += effect.displacement_mm(at, theta[self.slices[effect.name]])
        return moved

    def with_effects(self, *more: Effect) -> MachineModel:
        """The effects come last in θ."""
        return replace(self, effects=(*self.effects, *more))

    def with_confounded(self, effects: Sequence[Effect]) -> MachineModel:
        """With effects, last in θ, that the targets do not determine."""
        names = self.confounded.union(effect.name for effect in effects)
        return replace(self.with_effects(*effects), confounded=names)


def restore_effect(
    family: Family,
    machine: Machine,
    keys: Mapping[str, str],
    numbers: Mapping[str, float],
) -> Effect | None:
    """The effect as part of a model; None if it ends with its Run.

    An effect with an ISO symbol is part of every model and is not wrapped. Raises
    KeyError as `Family.restore`.
    """
    effect = family.restore(machine, keys, numbers)
    if effect is None or effect.iso_symbol:
        return effect
    fixed = tuple(keys.items()), tuple(numbers.items())
    return CatalogueEffect(family.name, *fixed, effect)


@dataclass(frozen=True)
class EstimatedModel:
    """A model with its parameters and their covariance, in inside units."""

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]

    def part(
        self, name: str
    ) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, "k k"]]:
        part = self.model.slices[name]
        return self.theta[part], self.covariance[part, part]

    @cached_property
    def reduce_to_targets(self) -> EstimatedModel:
        """The model at the measured targets, for tables that hold for these.

        Confounded turns that a displacement makes up for are set to 0, and all other
        parameters are conditional on that.
        """
        rows = self.target_rows
        kept = tuple(
            e for e in self.model.effects if e.name not in self.model.compensated_turns
        )
        covariance = rows @ self.covariance @ rows.T
        model = replace(self.model, effects=kept)
        return EstimatedModel(model, rows @ self.theta, covariance)

    def widen_by_scale(self, scale: float) -> Self:
        """With a scale uncertainty common to all lengths.

        scale : its standard uncertainty, relative
        """
        stretch = scale * compute_scale_parameters(self.model)
        return replace(self, covariance=self.covariance + np.outer(stretch, stretch))

    @cached_property
    def target_rows(self) -> Float64[np.ndarray, "k p"]:
        """Map to the parameters of `reduce_to_targets` from these: a regression."""
        own = np.zeros(self.model.size, bool)
        for name in self.model.compensated_turns:
            own[self.model.slices[name]] = True
        rows = np.eye(self.model.size)[~own]
        if own.any():
            scale = np.sqrt(np.diag(self.covariance)[own])
            among = self.covariance[np.ix_(own, own)] / scale / scale[:, None]
            across = self.covariance[np.ix_(own, ~own)] / scale[:, None]
            rows[:, own] = -(cho_solve(cho_factor(among), across).T / scale)
        return rows

    def effects(self) -> dict[str, Effect]:
        """Effects of the machine itself, by name."""
        return {
            e.name: e
            for e in self.model.effects
            if e.role in (Role.MACHINE, Role.DIRECTION)
        }


def list_lengths(model: MachineModel) -> list[ErrorMotion]:
    return [
        motion
        for motion in model.error_motions
        if is_positioning(motion.symbol) and isinstance(motion.axis, LinearAxis)
    ]


def compute_scale_parameters(model: MachineModel) -> Float64[np.ndarray, " p"]:
    """Parameters of a machine on which every length is too long by the same factor.

    An error of the tracker's scale looks the same: no residual shows it.
    """
    stretch = np.zeros(model.size)
    for motion in list_lengths(model):
        axis, part = motion.axis, model.slices[motion.name]
        at_mm = np.linspace(axis.low, axis.high, 2 * motion.spline.size)
        away_mm = at_mm - reference_position_mm(axis)
        stretch[part] = np.linalg.lstsq(motion.rows(at_mm), away_mm, rcond=None)[0]
    return stretch
