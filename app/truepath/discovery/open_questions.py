"""Undecided alternatives of a discovery, as questions that further lines can decide.

Names compete where another effect explains the Runs as well; evidence is weak where one
effect more, or one less, explains about as much. Each explanation is a Gaussian over
machine and effects, the posterior of the Runs, so that both absorb what the machine
can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from truepath.discovery.discover import Discovery
from truepath.discovery.discrimination import (
    POSE,
    DiscriminationDesign,
    LineChoice,
    Question,
)
from truepath.discovery.line_blocks import PlacedLine
from truepath.discovery.term_search import LEAST_EVIDENCE, TermFit
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.files.bundle.run import Run
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.family import USUAL_MM, CandidateTerm
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN
from truepath_drivers.interfaces.records import Path

FREE_FORM = "a free form"  # that explains the Runs as well as a possible name
TRACKER = "an error of the tracker"  # beyond its specification, that imitates it
_THIN = LEAST_EVIDENCE + 3.0
_NEARLY = 0.5 * LEAST_EVIDENCE
_MOST_QUESTIONS = 3
_NEGLIGIBLE_MM = 3e-5  # root mean square displacement of a dropped shape


@dataclass(frozen=True)
class Hypothesis:
    """Machine and effects as a Gaussian: mean + root z, z standard normal.

    mean : (p,); root : (p, k)
    """

    effects: tuple[Effect, ...]
    mean: Float64[np.ndarray, " p"]
    root: Float64[np.ndarray, "p k"]


@dataclass(frozen=True)
class HypothesisPair:
    """Predicts the data of a next Run under two hypotheses.

    machine : number of its parameters; base : of machine and poses, the next one last
    """

    one: Hypothesis
    other: Hypothesis
    machine: int
    base: int

    def measure(self, lines: Sequence[PlacedLine]) -> Float64[np.ndarray, "q q"]:
        total = np.zeros((self.columns.shape[1],) * 2)
        for line, base in lines:
            at = line.design.observations.at
            effects = (*self.one.effects, *self.other.effects)
            more = [np.zeros((len(at), 3, 0)), *(e.jacobian(at) for e in effects)]
            own = line.whiten(np.concatenate(more, axis=2)).rows
            rows = np.hstack([base.rows[:, : self.base], own]) @ self.columns
            total += rows.T @ rows
        return total

    @cached_property
    def columns(self) -> Float64[np.ndarray, "t q"]:
        """Map from roots, means and pose to machine, poses, effects."""
        machine, first = self.machine, self.base
        split = first + len(self.one.mean) - machine
        size = split + len(self.other.mean) - machine
        middle = self.one.root.shape[1]
        end = middle + self.other.root.shape[1]
        columns = np.zeros((size, end + 2 + POSE))
        for hypothesis, effects, roots, mean in (
            (self.one, np.arange(first, split), slice(0, middle), end),
            (self.other, np.arange(split, size), slice(middle, end), end + 1),
        ):
            rows = np.r_[np.arange(machine), effects]
            columns[rows, roots] = hypothesis.root
            columns[rows, mean] = hypothesis.mean
        columns[first - POSE : first, end + 2 :] = np.eye(POSE)
        return columns


def design_discrimination(
    found: Discovery, *, seed: int = 0
) -> DiscriminationDesign | None:
    """Lines that would decide the open questions; None if there are none.

    The same seed gives the same lines.
    """
    gram = _weigh_displacements(found.baseline.model)
    questions = tuple(_list_questions(found, gram))[:_MOST_QUESTIONS]
    if not questions:
        return None
    run, base = found.aligned[0].run, _add_run(found)
    feed = _highest_feed_mm_min([aligned.run for aligned in found.aligned])
    rng = np.random.default_rng(seed)
    return LineChoice(run.machine, base, questions, feed, rng).choose()


def _weigh_displacements(model: MachineModel) -> Float64[np.ndarray, "m m"]:
    """G with θᵀGθ the mean square of displacements over the volume, mm².

    Errors of the tracker, of size 1 each, show at its targets alone: weighted as
    typical effects.
    """
    gram = compute_volumetric_gram(model)
    for effect in filter(is_tracker_error, model.effects):
        part = model.slices[effect.name]
        gram[part, part] += USUAL_MM**2 * np.eye(part.stop - part.start)
    return gram


def _list_questions(
    found: Discovery, gram: Float64[np.ndarray, "m m"]
) -> Iterator[Question]:
    best, fitter = found.fit, found.fitter
    named = found.tried.named
    for finding in found.possible:
        if found.tried.is_imitated(finding.term):
            doubting = fitter.widen_tracker_errors()
            fits = (
                doubting.fit(terms, refine=False)
                for terms in (named.terms, named.other_terms(finding.term))
            )
            yield _form_question(found, gram, finding.term, TRACKER, *fits)
        else:
            yield _form_question(found, gram, finding.term, FREE_FORM, named, best)
    for finding in (f for f in found.findings if f.structure is None):
        others = best.other_terms(finding.term)
        for rival in finding.rivals:
            instead = fitter.fit([*others, rival])
            label = rival.candidate.label
            yield _form_question(found, gram, finding.term, label, best, instead)
        if finding.evidence.log_bayes < _THIN:
            without = fitter.fit(others)
            yield _form_question(found, gram, finding.term, "", best, without)
    ranked = fitter.rank_catalogue(best)
    if ranked and _NEARLY < ranked[0].evidence < LEAST_EVIDENCE:
        term = ranked[0].term
        larger = fitter.fit([*best.terms, term])
        yield _form_question(found, gram, term, "", larger, best)


def _form_question(
    found: Discovery,
    gram: Float64[np.ndarray, "m m"],
    one: CandidateTerm,
    other: str,
    with_one: TermFit,
    with_other: TermFit,
) -> Question:
    base = _add_run(found)
    left, right = (form_hypothesis(fit, gram) for fit in (with_one, with_other))
    return Question(
        one.candidate.label,
        other,
        (left.root.shape[1], right.root.shape[1]),
        HypothesisPair(left, right, base.machine_model.size, base.size).measure,
    )


def _add_run(found: Discovery) -> Linearisation:
    return replace(found.fitter.run_data[0].base, runs=len(found.aligned) + 1)


def form_hypothesis(fit: TermFit, machine: Float64[np.ndarray, "m m"]) -> Hypothesis:
    """Posterior of a fit for machine and effects in any future Run.

    machine : Gram matrix of the machine: θᵀGθ is the mean square of its displacements,
        mm²

    With C = A Aᵀ, the eigenvectors of Aᵀ G A are the undetermined shapes, ordered by
    their displacements; the few that matter are kept.
    """
    size, theta = len(machine), fit.posterior.theta
    keep = np.r_[np.arange(size), np.arange(fit.base_size, len(theta))]
    covariance = fit.posterior.covariance[np.ix_(keep, keep)]
    own = np.sqrt(np.diag(covariance))
    value, vector = np.linalg.eigh(covariance / own[:, None] / own)
    half = own[:, None] * vector * np.sqrt(np.maximum(value, 0.0))
    gram = np.zeros_like(covariance)
    gram[:size, :size] = machine
    typical = np.concatenate(
        [np.zeros(0), *(t.candidate.prior_sigma for t in fit.terms)]
    )
    more = np.arange(size, len(gram))
    gram[more, more] = (USUAL_MM / typical) ** 2
    square, shape = np.linalg.eigh(half.T @ gram @ half)
    root = half @ shape[:, square > _NEGLIGIBLE_MM**2]
    return Hypothesis(tuple(t.effect for t in fit.terms), theta[keep], root)


def _highest_feed_mm_min(runs: Sequence[Run]) -> float:
    feeds = [r.commanded.feed_mm_min for r in runs if isinstance(r.commanded, Path)]
    if not feeds:
        return DEFAULT_FEED_MM_MIN
    return max(float(feed[1:].max()) for feed in feeds)
