"""Interface of a catalogued effect for the search by discovery.

A family is one physical cause. For a machine and a recording it proposes candidates:
effects that are linear in their parameters, with all else (which axis, which lead,
which time constant) fixed. A scanned value has a range and a step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from configparser import ConfigParser
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from textwrap import dedent
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, EffectOfRun, Role, name_in_run
from truepath.kinematics.effects.keys import Key
from truepath.kinematics.machine.machine import Axis, Machine
from truepath.numerics.value_equality import ValueEquality
from truepath.plugins import find_point, gather, guarding, load_point

USUAL_MM = 0.005  # typical size of an effect that matters
LANGUAGES = ("en", "de")
GROUP = "truepath.effects"  # of the entry points: our families and third-party ones


@dataclass(frozen=True, slots=True)
class Words:
    """An effect in a metrologist's words, in one language."""

    title: str
    cause: str
    looks_like: str
    remedy: str


def read_words(text: str) -> dict[str, Words]:
    """Words by language, from text with one section per language, as in INI files."""
    parser = ConfigParser(interpolation=None)
    parser.read_string(dedent(text))
    return {
        language: Words(**{what: " ".join(said.split()) for what, said in part.items()})
        for language, part in parser.items()
        if part
    }


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float

    def scale(self, factor: float) -> Quantity:
        """In another unit; the uncertainty stays positive."""
        return Quantity(factor * self.value, abs(factor) * self.uncertainty)


@dataclass(frozen=True, slots=True)
class Scan:
    """Values at which a nonlinear parameter is tried.

    values : increasing; between neighbours the columns hardly change
    """

    name: str
    values: Float64[np.ndarray, " v"]


@dataclass(frozen=True, slots=True)
class Wave:
    """Columns arm · sin and arm · cos of 2π coordinate · waves, averaged over cells.

    arm : (n, 3); coordinate, rate : (n,) with its change per second
    waves : (v,) per unit of the coordinate, one for each scanned value
    """

    arm: Float64[np.ndarray, "n 3"]
    coordinate: Float64[np.ndarray, " n"]
    rate: Float64[np.ndarray, " n"]
    waves: Float64[np.ndarray, " v"]


@dataclass(frozen=True)
class Candidate(ValueEquality):
    """One effect that may be missing from the model.

    keys : distinguish it within its family, named as in files: axis, motion, …
    prior_sigma : (p,) prior standard deviation of the effect's parameters
    value : the scanned value of the effect; None if nothing is scanned
    """

    family: str
    keys: dict[str, str]
    effect: Effect
    prior_sigma: Float64[np.ndarray, " p"]
    value: float | None = None

    @property
    def label(self) -> str:
        """Family and keys in one line."""
        return " ".join([self.family, *self.keys.values()])


@dataclass(frozen=True)
class CandidateEstimate:
    """Estimated parameters of a candidate, in inside units.

    theta : (p,), covariance : (p, p)
    value_sigma : standard uncertainty of the scanned value
    """

    candidate: Candidate
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    value_sigma: float = 0.0

    @property
    def value(self) -> Quantity:
        """The scanned value; 0 if nothing is scanned."""
        return Quantity(self.candidate.value or 0.0, self.value_sigma)

    @property
    def parameters(self) -> list[Quantity]:
        """Each with its standard uncertainty."""
        sigma = np.sqrt(np.diag(self.covariance))
        return [Quantity(*p) for p in zip(self.theta.tolist(), sigma, strict=True)]

    def root_mean_square(self, weight: Float64[np.ndarray, " p"]) -> Quantity:
        """√Σ w θ², with its uncertainty to first order."""
        rms = float(np.sqrt(np.sum(weight * self.theta**2)))
        slope = weight * self.theta / max(rms, 1e-300)
        return Quantity(rms, float(np.sqrt(slope @ self.covariance @ slope)))


class Family(ABC):
    """One physical cause and its candidates, for discovery and for files.

    words : by language; keys : by the name that files give them, in their order
    effect : its class, which has the role, and which keys and `numbers` make again
    ends_with_run : no model keeps it, as none keeps what belongs to a measurement
    makes : an effect of keys and numbers, where that is not its class
    numbers : fields of the effect that restore it together with its keys
    is_rigid_body : part of every rigid-body model, so never missing there
    is_smooth : in the scanned value; else every value is tried, since there is no slope
    happens_once : the scanned value is the moment of a permanent shift of all points
    value_name : of the scanned value, in files and as a field of the effect
    stated : factors from inside units, keyed by the parameters' names in files
    covariates : variables that structure depends on: axes, `t` the time, `v(X)` a
        speed; braces hold a key
    varies_with : `time`, `place` or `way` (side of approach, speed), where free forms
        of the same could be mistaken for it
    tracker_may_imitate : from one place the tracker could do the same, in any size
    sentence : that describes structure; braces hold a key, or a number of a file
    """

    interface_version: ClassVar[int] = 1
    name: ClassVar[str]
    words: ClassVar[Mapping[str, Words]]
    effect: ClassVar[type[Effect] | None] = None
    ends_with_run: ClassVar[bool] = False
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
    tracker_may_imitate: ClassVar[bool] = False
    sentence: ClassVar[str] = ""

    @property
    def role(self) -> Role:
        """That of its effect; an error by direction of approach is the machine's."""
        role = Role.MACHINE if self.effect is None else self.effect.role
        return Role.MACHINE if role is Role.DIRECTION else role

    @property
    def names_cause(self) -> bool:
        """False for a family that only describes structure."""
        return self.role is not Role.STRUCTURE

    @property
    def is_kept(self) -> bool:
        """Whether a model keeps it, as part of the machine's volumetric error."""
        lasts = self.role is not Role.MEASUREMENT and not self.ends_with_run
        return lasts and self._maker is not None

    @property
    def _maker(self) -> Callable[..., Effect] | None:
        return type(self).makes or self.effect

    @abstractmethod
    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Candidates under these conditions, scans at their middle."""

    def make_candidate(self, effect: Effect, prior_sigma: Iterable[float]) -> Candidate:
        """Candidate whose keys and value are fields of the effect."""
        keys = {key: getattr(effect, key) for key in self.keys}
        keys = {k: v.name if isinstance(v, Axis) else v for k, v in keys.items()}
        value = getattr(effect, self.value_name, None) if self.value_name else None
        sigma = np.array([*prior_sigma], np.float64)
        return Candidate(self.name, keys, effect, sigma, value)

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """None if nothing is scanned."""
        return None

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """The scan as a wave, to try all its values at once; None if it is none."""
        return None

    def with_value(self, candidate: Candidate, value: float) -> Candidate:
        """The candidate with another scanned value."""
        effect = replace(candidate.effect, **{self.value_name: value})
        return replace(candidate, effect=effect, value=value)

    def list_numbers(self, candidate: Candidate) -> dict[str, float]:
        """Numbers that restore the effect together with its keys."""
        return {name: float(getattr(candidate.effect, name)) for name in self.numbers}

    def restore(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect | None:
        """The effect from keys and numbers of a file; None if it ends with its Run.

        Raises KeyError naming a key, number or axis that is not there.
        """
        make = self._maker
        if make is None or not self.is_kept:
            return None
        parts = {k: key.read(machine, keys[k]) for k, key in self.keys.items()}
        return make(**parts, **{name: numbers[name] for name in self.numbers})

    def persists_between_runs(self, candidate: Candidate, machine: Machine) -> bool:
        """Whether the effect can be restored, and so is in the next Run too."""
        numbers = self.list_numbers(candidate)
        return self.restore(machine, candidate.keys, numbers) is not None

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Values and standard uncertainties in the units and names of files."""
        parts = zip(self.stated.items(), found.parameters, strict=True)
        stated = {name: one.scale(factor) for (name, factor), one in parts}
        return stated | ({self.value_name: found.value} if self.value_name else {})

    def list_covariates(self, candidate: Candidate) -> list[str]:
        """Variables that the structure depends on."""
        return [each.format(**candidate.keys) for each in self.covariates]

    def describe(self, candidate: Candidate, stated: Mapping[str, Quantity]) -> str:
        """One sentence about structure. stated : of `state`"""
        said = {name: quantity.value for name, quantity in stated.items()}
        said |= self.list_numbers(candidate)
        text = self.sentence.format(**candidate.keys, **said)
        return text or self.title(candidate.keys)

    def title(self, keys: Mapping[str, str]) -> str:
        """An effect in words: `Backlash of Y`; without keys that are not given."""
        said = [k.describe(keys[name]) for name, k in self.keys.items() if name in keys]
        return " ".join([self.words["en"].title, *filter(None, said)])


def list_families(at: Sequence[Conditions] = ()) -> tuple[Family, ...]:
    """One of each installed family, in the order of their names.

    at : third-party families that fail under these conditions are left out
    """

    def ask(_name: str, factory: type[Family]) -> Family:
        family = _make_family(factory)
        "".join([family.name, *(words.title for words in family.words.values())])
        is_ours = type(family).__module__.startswith("truepath.")
        for conditions in () if is_ours else at:
            for candidate in family.propose(conditions):
                moved = np.asarray(candidate.effect.jacobian(conditions))
                wanted = (len(conditions), 3, len(candidate.prior_sigma))
                if moved.shape != wanted:
                    told = f"its jacobian has the shape {moved.shape}, expected"
                    raise ValueError(f"{told} {wanted}")
                if not np.isfinite(moved).all():
                    raise ValueError("its effect is not finite")
        return family

    # One search for all: each reads the metadata of every installed distribution.
    return tuple(gather(GROUP, ask).values())


def describe_family(family: Family, language: str = "en") -> dict[str, Any]:
    """For lists of what discovery looks for.

    enters_analyse : a model can keep it; else it ends with its Run
    """
    return {
        "name": family.name,
        "of": family.role.value,
        **asdict(family.words[language]),
        "enters_analyse": family.is_kept,
    }


def find_family(name: str) -> Family:
    """Raises BadInput listing the installed families."""
    point = find_point(GROUP, name)
    with guarding(point, "being made"):
        return _make_family(load_point(point))


@cache
def _make_family(factory: type[Family]) -> Family:
    return factory()


@dataclass(frozen=True)
class CandidateTerm:
    """A candidate effect of a family, and the cost of searching for it.

    Two terms are equal if effect and Run are.

    run : that it ends with; None for an effect of the machine, which is in all Runs
    price : log of the number of independent values that were tried
    value_sigma : standard uncertainty of the scanned value
    covariance : of the effect's parameters with the scanned value unknown; None where
        that makes no difference
    """

    family: Family = field(compare=False)
    candidate: Candidate
    run: int | None = None
    price: float = field(default=0.0, compare=False)
    value_sigma: float = field(default=0.0, compare=False)
    covariance: Float64[np.ndarray, "p p"] | None = field(default=None, compare=False)

    @cached_property
    def effect(self) -> Effect:
        effect = self.candidate.effect
        return effect if self.run is None else EffectOfRun(effect, self.run)

    @property
    def label(self) -> str:
        """Name and keys, and the number of the Run beyond the first."""
        return name_in_run(self.candidate.label, self.run or 0)

    @property
    def size(self) -> int:
        return len(self.candidate.prior_sigma)

    @property
    def has_cause(self) -> bool:
        return self.family.names_cause

    @property
    def is_fast(self) -> bool:
        return self.candidate.effect.jacobian_in_time(np.zeros(1)) is not None

    def scan(self, at: Conditions) -> Scan | None:
        return self.family.scan(self.candidate, at)

    def wave(self, at: Conditions) -> Wave | None:
        return self.family.find_wave(self.candidate, at)

    def with_value(self, value: float) -> CandidateTerm:
        return replace(self, candidate=self.family.with_value(self.candidate, value))


def propose_terms(
    families: Sequence[Family], at: Sequence[Conditions]
) -> Iterator[CandidateTerm]:
    """Terms of the machine once; terms that end with a Run once per Run.

    at : conditions of each Run
    """
    of_machine: set[str] = set()
    for run, conditions in enumerate(at):
        for family in families:
            for candidate in family.propose(conditions):
                if not family.persists_between_runs(candidate, conditions.machine):
                    yield CandidateTerm(family, candidate, run)
                elif candidate.label not in of_machine:
                    of_machine.add(candidate.label)
                    yield CandidateTerm(family, candidate)
