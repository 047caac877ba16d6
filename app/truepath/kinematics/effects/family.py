"""What a catalogued effect tells of itself, so that discovery can look for it.

A family is one physical cause. For a machine and what was recorded it proposes
candidates: effects that are linear in their parameters, with all else (which axis,
which lead, which time constant) fixed. What is scanned has a range and a step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from configparser import ConfigParser
from dataclasses import dataclass, replace
from functools import cache
from textwrap import dedent
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.keys import Key
from truepath.kinematics.machine.machine import Axis, Machine
from truepath.numerics.value_equality import ValueEquality
from truepath.plugins import find_point, gather, guarding, load_point

USUAL_MM = 0.005  # an effect that is worth its name, and surprises nobody
LANGUAGES = ("en", "de")
GROUP = "truepath.effects"  # of the entry points: our families, and those of others


@dataclass(frozen=True, slots=True)
class Words:
    """An effect in a metrologist's words, in one language."""

    title: str
    cause: str
    looks_like: str
    remedy: str


def read_words(text: str) -> dict[str, Words]:
    """Return words by language from text with a section a language, as in INI files."""
    parser = ConfigParser(interpolation=None)
    parser.read_string(dedent(text))
    return {
        language: Words(**{what: " ".join(said.split()) for what, said in part.items()})
        for language, part in parser.items()
        if part
    }


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number and its standard uncertainty."""

    value: float
    uncertainty: float

    def scale(self, factor: float) -> Quantity:
        """Return it in another unit."""
        return Quantity(factor * self.value, abs(factor) * self.uncertainty)


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


@dataclass(frozen=True)
class CandidateEstimate:
    """Estimated parameters of a candidate, in inside units.

    theta : (p,), covariance : (p, p)
    value_sigma : standard uncertainty of what was scanned
    """

    candidate: Candidate
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    value_sigma: float = 0.0

    @property
    def value(self) -> Quantity:
        """What was scanned."""
        return Quantity(self.candidate.value or 0.0, self.value_sigma)

    @property
    def parameters(self) -> list[Quantity]:
        """Each parameter."""
        sigma = np.sqrt(np.diag(self.covariance))
        return [Quantity(*p) for p in zip(self.theta.tolist(), sigma, strict=True)]

    def root_mean_square(self, weight: Float64[np.ndarray, " p"]) -> Quantity:
        """Return √Σ w θ²."""
        rms = float(np.sqrt(np.sum(weight * self.theta**2)))
        slope = weight * self.theta / max(rms, 1e-300)
        return Quantity(rms, float(np.sqrt(slope @ self.covariance @ slope)))


class Family(ABC):
    """One physical cause and its candidates: what discovery looks for, and files name.

    words : by language; keys : by the name that files give them, in their order
    makes : an effect of keys and `numbers`, by name; None where it ends with its Run
    numbers : fields of the effect that make it again, beside its keys
    is_rigid_body : every model has it; where that is the base, it is not missing
    is_smooth : in what is scanned; else every value is tried, for want of a slope
    happens_once : what is scanned is the moment; all shifts by it, then and for good
    value_name : of what is scanned, as files state it and the effect has it
    stated : factors from inside units, by the names that files give the parameters
    covariates : what structure depends on: axes, `t` the time, `v(X)` a speed; braces
        hold a key
    varies_with : `time`, `place` or `way` (side of approach, speed), where free forms
        of the same could be taken for it
    sentence : that describes structure; braces hold a key, or a number of a file
    """

    interface_version: ClassVar[int] = 1
    name: ClassVar[str]
    words: ClassVar[Mapping[str, Words]]
    role: ClassVar[Role] = Role.MACHINE
    keys: ClassVar[Mapping[str, Key]] = {}
    makes: ClassVar[Callable[..., Effect] | None] = None
    numbers: ClassVar[tuple[str, ...]] = ()
    is_rigid_body: ClassVar[bool] = False
    is_smooth: ClassVar[bool] = True
    happens_once: ClassVar[bool] = False
    value_name: ClassVar[str] = ""
    stated: ClassVar[Mapping[str, float]] = {}
    covariates: ClassVar[tuple[str, ...]] = ()
    varies_with: ClassVar[str] = ""
    sentence: ClassVar[str] = ""

    @property
    def names_cause(self) -> bool:
        """Whether it names a cause; else it describes structure."""
        return self.role is not Role.STRUCTURE

    @property
    def in_machine(self) -> bool:
        """Whether it is part of the machine, and so of its volumetric error."""
        return self.role is not Role.MEASUREMENT and self.makes is not None

    @abstractmethod
    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return what may be looked for in these conditions, scans at their middle."""

    def offer(self, effect: Effect, usual: Iterable[float]) -> Candidate:
        """Return a candidate whose keys and value are fields of the effect."""
        keys = {key: getattr(effect, key) for key in self.keys}
        keys = {k: v.name if isinstance(v, Axis) else v for k, v in keys.items()}
        value = getattr(effect, self.value_name, None) if self.value_name else None
        sigma = np.array([*usual], np.float64)
        return Candidate(self.name, keys, effect, sigma, value)

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return what is to be scanned, or None."""
        del candidate, at
        return None

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave, if it is one: all its values are tried at once."""
        del candidate, at
        return None

    def with_value(self, candidate: Candidate, value: float) -> Candidate:
        """Return the candidate with what is scanned at another value."""
        effect = replace(candidate.effect, **{self.value_name: value})
        return replace(candidate, effect=effect, value=value)

    def list_numbers(self, candidate: Candidate) -> dict[str, float]:
        """Return the numbers that make the effect again, beside its keys."""
        return {name: float(getattr(candidate.effect, name)) for name in self.numbers}

    def restore(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect | None:
        """Return the effect as a model file states it; None if it ends with its Run.

        Raises KeyError naming a key, number or axis that is not there.
        """
        make = type(self).makes
        if make is None:
            return None
        parts = {k: key.read(machine, keys[k]) for k, key in self.keys.items()}
        return make(**parts, **{name: numbers[name] for name in self.numbers})

    def outlasts(self, candidate: Candidate, machine: Machine) -> bool:
        """Tell whether the effect is in the next Run too, as in the machine's model."""
        numbers = self.list_numbers(candidate)
        return self.restore(machine, candidate.keys, numbers) is not None

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return what files state: names with units, values, standard uncertainties."""
        parts = zip(self.stated.items(), found.parameters, strict=True)
        stated = {name: one.scale(factor) for (name, factor), one in parts}
        return stated | ({self.value_name: found.value} if self.value_name else {})

    def list_covariates(self, candidate: Candidate) -> list[str]:
        """Return what structure depends on."""
        return [each.format(**candidate.keys) for each in self.covariates]

    def describe(self, candidate: Candidate, stated: Mapping[str, Quantity]) -> str:
        """Return structure in one sentence. stated : of `state`."""
        said = {name: quantity.value for name, quantity in stated.items()}
        said |= self.list_numbers(candidate)
        text = self.sentence.format(**candidate.keys, **said)
        return text or self.title(candidate.keys)

    def title(self, keys: Mapping[str, str]) -> str:
        """Return an effect in words: `Backlash of Y`."""
        said = [key.describe(keys[name]) for name, key in self.keys.items()]
        return " ".join([self.words["en"].title, *filter(None, said)])


def list_families(at: Sequence[Conditions] = ()) -> tuple[Family, ...]:
    """Return one of each installed family, in the order of their names.

    at : those of somebody else that fail in these conditions are left out
    """

    def ask(_name: str, factory: type[Family]) -> Family:
        family = _make_family(factory)
        "".join([family.name, *(words.title for words in family.words.values())])
        is_ours = type(family).__module__.startswith("truepath.")
        for conditions in () if is_ours else at:
            for candidate in family.propose(conditions):
                moved = candidate.effect.jacobian(conditions)
                if moved.shape[1:] != (3, len(candidate.usual)):
                    raise ValueError(f"its effect has the shape {moved.shape}")
                if not np.isfinite(moved).all():
                    raise ValueError("its effect is not finite")
        return family

    # One search for all: each reads the metadata of every installed distribution.
    return tuple(gather(GROUP, ask).values())


def find_family(name: str) -> Family:
    """Return the family of a name. Raises BadInput, telling what is installed."""
    point = find_point(GROUP, name)
    with guarding(point, "being made"):
        return _make_family(load_point(point))


@cache
def _make_family(factory: type[Family]) -> Family:
    return factory()
