"""A model with its estimated parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_factor, cho_solve

from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.error_motion import (
    ErrorMotion,
    reference_position_mm,
)
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.machine.symbols import is_positioning
from truepath.kinematics.model import MachineModel


@dataclass(frozen=True)
class EstimatedModel:
    """A model with its parameters and their covariance, in inside units."""

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]

    def part(
        self, name: str
    ) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, "k k"]]:
        """Parameters and covariance of one effect."""
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
    """Positioning of the linear axes."""
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
