"""Candidate terms: effects that may be missing from the model of one or all Runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, EffectOfRun, name_in_run
from truepath.kinematics.effects.family import Candidate, Family, Scan, Wave


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
        """The candidate's effect, in its Run."""
        effect = self.candidate.effect
        return effect if self.run is None else EffectOfRun(effect, self.run)

    @property
    def label(self) -> str:
        """Name and keys, and the number of the Run beyond the first."""
        return name_in_run(self.candidate.label, self.run or 0)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.candidate.prior_sigma)

    @property
    def has_cause(self) -> bool:
        """Whether the family is a physical cause; else it only describes structure."""
        return self.family.names_cause

    @property
    def is_fast(self) -> bool:
        """Whether the effect changes within cells."""
        return self.candidate.effect.jacobian_in_time(np.zeros(1)) is not None

    def scan(self, at: Conditions) -> Scan | None:
        """Values to scan; None if nothing is scanned."""
        return self.family.scan(self.candidate, at)

    def wave(self, at: Conditions) -> Wave | None:
        """The scan as a wave; None if it is not one."""
        return self.family.find_wave(self.candidate, at)

    def with_value(self, value: float) -> CandidateTerm:
        """The same term at another scanned value."""
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
