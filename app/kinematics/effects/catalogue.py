"""What a catalogued effect tells of itself, so that discovery can look for it.

A family is one physical cause. For a machine and what was recorded it proposes
candidates: effects that are linear in their parameters, with all else (which axis,
which lead, which time constant) fixed. What is scanned has a range and a step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect
from app.kinematics.machine import Machine
from app.numerics.value_equality import ValueEquality

USUAL_MM = 0.005  # an effect that is worth its name, and surprises nobody


@dataclass(frozen=True, slots=True)
class Signature:
    """An effect in a metrologist's words."""

    cause: str
    looks_like: str
    remedy: str


@dataclass(frozen=True, slots=True)
class Measured:
    """One number and its standard uncertainty."""

    value: float
    uncertainty: float

    @classmethod
    def only(
        cls,
        theta: Float64[np.ndarray, "1"],
        covariance: Float64[np.ndarray, "1 1"],
        scale: float,
    ) -> Measured:
        """Return the one parameter of an effect, in the unit of files."""
        sigma = float(np.sqrt(covariance[0, 0]))
        return cls(scale * float(theta[0]), abs(scale) * sigma)


@dataclass(frozen=True, slots=True)
class Scan:
    """A parameter that is not linear: where it is looked for, and how finely.

    values : increasing; between neighbours the columns hardly change
    """

    name: str
    values: Float64[np.ndarray, " v"]


@dataclass(frozen=True, slots=True)
class Wave:
    """Columns arm · sin and arm · cos of 2π coordinate · waves, averaged over cells.

    arm : (n, 3); coordinate, rate : (n,) with its change in a second
    waves : (v,) per unit of the coordinate, one for each scanned value
    """

    arm: Float64[np.ndarray, "n 3"]
    coordinate: Float64[np.ndarray, " n"]
    rate: Float64[np.ndarray, " n"]
    waves: Float64[np.ndarray, " v"]


@dataclass(frozen=True)
class Candidate(ValueEquality):
    """One effect that may be missing.

    keys : what tells it from others of its family, as files name it: axis, motion, …
    usual : (p,) prior standard deviation of the effect's parameters
    value : of what is scanned, at which the effect is taken
    """

    family: str
    keys: dict[str, str]
    effect: Effect
    usual: Float64[np.ndarray, " p"]
    value: float | None = None

    @property
    def label(self) -> str:
        """Return name and keys in one line."""
        return " ".join([self.family, *self.keys.values()])


class Family(ABC):
    """One physical cause and its candidates.

    in_machine : part of the machine, and so of its volumetric error; else of the
        measurement
    is_smooth : in what is scanned; else every value is tried, for want of a slope
    happens_once : what is scanned is the moment; all shifts by it, then and for good
    scanned : name of what is scanned, as files state it and the effect has it
    """

    name: str
    signature: Signature
    in_machine: bool = True
    is_smooth: bool = True
    happens_once: bool = False
    scanned: str = ""

    @abstractmethod
    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return what may be looked for in these conditions, scans at their middle."""

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return what is to be scanned, or None."""
        del candidate, at
        return None

    def wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave, if it is one: all its values are tried at once."""
        del candidate, at
        return None

    def at_value(self, candidate: Candidate, at: Conditions, value: float) -> Candidate:
        """Return the candidate with what is scanned at another value."""
        del at
        effect = replace(candidate.effect, **{self.scanned: value})
        return replace(candidate, effect=effect, value=value)

    def kept(self, candidate: Candidate) -> dict[str, float]:
        """Return the numbers that make the effect again, beside its keys."""
        return {} if candidate.value is None else {self.scanned: candidate.value}

    def restored(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect | None:
        """Return the effect as a model file states it; None if it ends with its Run.

        Raises KeyError naming a key or axis that is not there.
        """
        del machine, keys, numbers
        return None

    def outlasts(self, candidate: Candidate, machine: Machine) -> bool:
        """Tell whether the effect is in the next Run too, as in the machine's model."""
        numbers = self.kept(candidate)
        stays = self.restored(machine, candidate.keys, numbers) is not None
        return self.in_machine and stays

    @abstractmethod
    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, " p"],
        covariance: Float64[np.ndarray, "p p"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return what files state: names with units, values, standard uncertainties.

        value_sigma : standard uncertainty of what was scanned
        """


class Described(Family):
    """Structure that is told by what it depends on; it names no cause."""

    @abstractmethod
    def depends_on(self, candidate: Candidate) -> list[str]:
        """Return what it depends on: axes, `t` the time, `v(X)` the speed of X."""

    @abstractmethod
    def told(self, candidate: Candidate, found: Mapping[str, Measured]) -> str:
        """Return it in one sentence.

        found : of `parameters`
        """


def rate_of(at: Conditions, axis: str) -> Float64[np.ndarray, " n"]:
    """Return how fast an axis moves in each cell."""
    if at.recorded is None:
        return np.zeros(len(at))
    return np.abs(at.recorded.rate[:, at.machine.axis_names.index(axis)])


def averaged(
    angular_rate: Float64[np.ndarray, " n"], span_s: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Return what is left of a wave after averaging it over each span."""
    return np.sinc(angular_rate * span_s / (2.0 * np.pi))
