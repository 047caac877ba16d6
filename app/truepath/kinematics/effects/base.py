"""Interface of an effect under given conditions; in one Run, or in all."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.machine.machine import Axis, LinearAxis, RotaryAxis
from truepath.kinematics.machine.symbols import DIRECTION, is_turn
from truepath.kinematics.splines import CubicSpline
from truepath.numerics.value_equality import ValueEquality


class Role(Enum):
    """Part of the measurement to which an effect belongs.

    MACHINE : the machine, and so its volumetric error
    DIRECTION : the machine, by the direction of approach; the map is the mean of both
    MEASUREMENT : tracker or set-up; it is looked for where data show a gap
    NUISANCE : pose, timing, seat of the target; part of every estimate
    STRUCTURE : the machine, or all points in time; described without a known cause
    """

    MACHINE = "machine"
    DIRECTION = "direction"
    MEASUREMENT = "measurement"
    NUISANCE = "nuisance"
    STRUCTURE = "structure"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect. unit : inside unit (mm, rad, s, 1)."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True)
class QuadraticPrior:
    """A quadratic form θᵀKθ penalised by a prior.

    form : (p, p) K; rank : shapes that it penalises; the others are free
    typical : θᵀKθ of an effect of typical size
    kind : effects of a kind have similar precision; empty for one on its own
    is_known : the form is the precision itself; nothing of it is found from the data
    counted : shapes, those penalised least, that determine how well the precision is
        known; 0 for all
    """

    form: Float64[np.ndarray, "p p"]
    rank: int
    typical: float
    kind: str = ""
    is_known: bool = False
    counted: int = 0


@dataclass(frozen=True)
class Effect(ValueEquality, ABC):
    """One physical cause that moves the measured point off its nominal, linear in θ.

    A dataclass: its fields are what is fixed, θ is what is estimated. Kind, units and
    Jacobian make an effect; the other methods have a default.

    kind : with the axes, words and numbers it forms the name
    units : inside unit of each parameter, keyed by the suffix to the effect's label
    role : MACHINE by default
    """

    kind: ClassVar[str] = ""
    units: ClassVar[Mapping[str, str]] = {}
    role: ClassVar[Role] = Role.MACHINE

    @property
    def name(self) -> str:
        """Unique in a model: its numbers are not rounded."""
        return self.compose_name("")

    @property
    def label(self) -> str:
        """Name with its numbers rounded to 5 digits, for texts."""
        return self.compose_name(".5g")

    def compose_name(self, digits: str) -> str:
        """ISO symbol, or kind, axes, words and numbers joined by hyphens.

        digits : format of a number
        """
        parts = [self.kind, *_format_fields(self, digits)]
        return self.iso_symbol or "-".join(filter(None, parts))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The p parameters, in the order of the Jacobian's columns."""
        label = self.label
        return tuple(
            Parameter(f"{label}-{part}" if part else label, unit)
            for part, unit in self.units.items()
        )

    @abstractmethod
    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """∂(displacement in the observer's frame, mm)/∂θ."""

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Displacement of the measured point, in the observer's frame."""
        return self.jacobian(at) @ theta

    def prior(self) -> QuadraticPrior | None:
        """What its shape is likely to be; the data weigh it. None for no prior."""
        return None

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 p"] | None:
        """Columns at single moments if it is a fast function of time alone, else None.

        Such an effect varies between the samples of a cell.
        """
        return None

    def coarsen(self, intervals: int) -> Effect:
        """The effect with fewer knots if it is a spline along an axis; else itself."""
        return self

    @property
    def iso_symbol(self) -> str:
        """ISO 230-1 symbol of its table or number; empty if it has none."""
        return ""

    @property
    def motion(self) -> ErrorCurve | None:
        """The error motion that it is, as tabulated; None if it is none."""
        return None

    @property
    def half_difference(self) -> ErrorCurve | None:
        """Half the difference between both directions of approach, if it is one."""
        return None

    @property
    def lag_axis(self) -> str:
        """The axis whose lag behind its command, in s, it is; empty if it is none."""
        return ""

    @property
    def axis_pair(self) -> tuple[str, str] | None:
        """The two axes whose positions it depends on at once, the guide first."""
        return None

    @property
    def own_run(self) -> int | None:
        """The one Run of an estimate that it acts in; None if it acts in all."""
        return None


def _format_fields(effect: Effect, digits: str) -> Iterator[str]:
    for field in fields(effect):
        value = getattr(effect, field.name)
        if isinstance(value, LinearAxis | RotaryAxis):
            yield value.name
        elif isinstance(value, str):
            yield value
        elif isinstance(value, float):
            yield format(value, digits)


class SplineEffect(Effect):
    """A spline of one coordinate; θ are the control values in a gauge.

    gauge : (K, p), control values per parameter
    """

    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    @property
    def unit(self) -> str:
        """Inside unit of the spline's values."""
        return "mm"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """One per degree of freedom left by the gauge."""
        name, count = self.name, self.gauge.shape[1]
        return tuple(Parameter(f"{name}[{i}]", self.unit) for i in range(count))

    def mean_square_prior(self, typical: float, kind: str = "") -> QuadraticPrior:
        """Mean square over all knots as a prior. typical : size of the values"""
        length = float(self.spline.knots[-1] - self.spline.knots[0])
        form = self.gauge.T @ self.spline.gram() @ self.gauge / length
        rank = self.gauge.shape[1]
        return QuadraticPrior(form, rank, rank * typical**2, kind)


@dataclass(frozen=True)
class ErrorCurve(SplineEffect):
    """An error over the travel of an axis, as a table holds it.

    symbol : ISO 230-1 symbol of the error motion
    """

    symbol: str
    axis: Axis
    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    @property
    def unit(self) -> str:
        """`rad` for a turn, else `mm`."""
        return "rad" if is_turn(self.symbol) else "mm"

    def rows(self, position: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n p"]:
        """Value per parameter at positions of the axis, mm or deg."""
        return self.spline.basis(position) @ self.gauge


@dataclass(frozen=True)
class EffectOfRun(Effect):
    """An effect in one Run; 0 in all others."""

    role = Role.MEASUREMENT
    effect: Effect
    run: int

    def compose_name(self, digits: str) -> str:
        """Name of the effect, with the number of its Run beyond the first."""
        return name_in_run(self.effect.compose_name(digits), self.run)

    @property
    def own_run(self) -> int:
        return self.run

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.effect.parameters

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        if at.run != self.run:
            return np.zeros((len(at), 3, len(self.parameters)))
        return self.effect.jacobian(at)

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 p"] | None:
        return self.effect.jacobian_in_time(time_s)

    def prior(self) -> QuadraticPrior | None:
        return self.effect.prior()


def columns_along(
    direction: str | Float64[np.ndarray, "n 3"], size: Float64[np.ndarray, "n ..."]
) -> Float64[np.ndarray, "n 3 p"]:
    """Columns of displacements along X, Y or Z, or along arms.

    size : of each column; (n,) for one column
    """
    arm = np.eye(3)[DIRECTION[direction]] if isinstance(direction, str) else direction
    columns = size if size.ndim > 1 else size[:, None]
    return arm.reshape(-1, 3, 1) * columns[:, None, :]


def name_in_run(name: str, run: int) -> str:
    """`name-2` for the second Run; the first Run adds no number."""
    return name if run == 0 else f"{name}-{run + 1}"
