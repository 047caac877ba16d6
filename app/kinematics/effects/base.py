"""What an effect answers, and under which conditions it is asked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from app.kinematics.chain import nominal_point_mm
from app.kinematics.machine import Machine


@dataclass(frozen=True)
class Conditions:
    """The state of the machine at n moments.

    position_mm : (n, axes) nominal axis positions, in the machine's column order
    offset_mm : (n, 3) offset of the measured target
    time_s : (n,) the tracker's clock
    line : (n,) row of the path that the machine moves towards, -1 at a standstill
    line_time_s : (n,) time from the middle of that line
    velocity_mm_s : (n, 3) commanded velocity, 0 at a standstill
    approach : (n, axes) sign of each axis' last motion, 0 where it has not moved yet
    """

    machine: Machine
    position_mm: Float64[np.ndarray, "n a"]
    offset_mm: Float64[np.ndarray, "n 3"]
    time_s: Float64[np.ndarray, " n"]
    line: Int64[np.ndarray, " n"]
    line_time_s: Float64[np.ndarray, " n"]
    velocity_mm_s: Float64[np.ndarray, "n 3"]
    approach: Float64[np.ndarray, "n a"]

    def __len__(self) -> int:
        return len(self.position_mm)

    @cached_property
    def point_mm(self) -> Float64[np.ndarray, "n 3"]:
        """Nominal target point in the workpiece frame, (n, 3)."""
        return nominal_point_mm(self.machine, self.position_mm, self.offset_mm)

    def taken(self, rows: Int64[np.ndarray, " m"]) -> Conditions:
        """Return the conditions at some of the moments."""
        return Conditions(
            self.machine,
            self.position_mm[rows],
            self.offset_mm[rows],
            self.time_s[rows],
            self.line[rows],
            self.line_time_s[rows],
            self.velocity_mm_s[rows],
            self.approach[rows],
        )

    def axis_mm(self, axis: str) -> Float64[np.ndarray, " n"]:
        """Return the positions of one axis."""
        return self.position_mm[:, self.machine.axis_names.index(axis)]


def standstill(
    machine: Machine,
    position_mm: Float64[np.ndarray, "n a"],
    offset_mm: Float64[np.ndarray, "n 3"] | None = None,
) -> Conditions:
    """Return conditions of a machine that stands at the given positions."""
    n, a = len(position_mm), len(machine.axes)
    if offset_mm is None:
        offset_mm = np.tile(np.array(machine.target().offset_mm), (n, 1))
    return Conditions(
        machine,
        position_mm,
        offset_mm,
        np.zeros(n),
        np.full(n, -1),
        np.zeros(n),
        np.zeros((n, 3)),
        np.zeros((n, a)),
    )


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    unit : inside unit (mm, rad, s, 1)
    nuisance : belongs to the measurement (pose, timing), not to the machine
    """

    name: str
    unit: str
    nuisance: bool = False


@dataclass(frozen=True, slots=True)
class Charge:
    """A quadratic form θᵀKθ that a prior charges for.

    form : (p, p) K; rank : shapes that it charges; the others are free
    usual : θᵀKθ of an effect of usual size
    """

    form: Float64[np.ndarray, "p p"]
    rank: int
    usual: float


class Effect(ABC):
    """One physical cause that moves the measured point off its nominal, linear in θ."""

    @property
    @abstractmethod
    def name(self) -> str:
        """The catalogue's name, or the ISO 230-1 symbol."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The p parameters, in the order of the Jacobian's columns."""

    @abstractmethod
    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return ∂(displacement in the workpiece frame, mm)/∂θ."""

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Return how far θ moves the measured point."""
        return self.jacobian(at) @ theta

    def charge(self) -> Charge | None:
        """Return what the prior charges for, or None for no prior."""
        return None
