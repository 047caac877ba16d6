"""Explain Runs by base and effects; tell what each further effect would gain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.discovery.base import BasePrior
from app.discovery.evidence import HeldOut, held_out, prior_precision, rest
from app.discovery.moments import at_its_moment
from app.discovery.refining import refined
from app.discovery.scan import Offer, Residual, scanned, weighted_residual
from app.discovery.sums import Lines
from app.discovery.view import View
from app.estimation.information import Posterior
from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import Candidate, Described, Family

FOLDS = 8
_SHARPENED = 4  # offers whose scans are tried exactly
# Of a tracker's place, about where alignment found it: a millimetre, a milliradian. So
# it stays told where a few lines are all of a Run, and one of them is held out.
_POSE = np.repeat([1.0, 1e6], 3)


_Key = tuple[Candidate, int | None]  # an effect, and the Run that it is looked for in


@dataclass(frozen=True, eq=False)
class Explanation:
    """The Runs explained by base and chosen effects."""

    chosen: tuple[Offer, ...]
    base_size: int
    prior: BasePrior
    fit: Posterior
    foretold: HeldOut

    def effect(
        self, number: int
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "p p"]]:
        """Return parameters and covariance of one chosen effect."""
        sizes = [len(o.candidate.usual) for o in self.chosen]
        begin = self.base_size + sum(sizes[:number])
        part = slice(begin, begin + sizes[number])
        return self.fit.theta[part], self.fit.covariance[part, part]


@dataclass(frozen=True)
class Ranked:
    """What an offer would gain beyond the chosen ones.

    evidence : log Bayes factor less the price of the search
    """

    offer: Offer
    evidence: float


class Explainer:
    """Runs of one machine, each held against its base, and a catalogue."""

    def __init__(
        self, views: Sequence[View], prior: BasePrior, families: Sequence[Family]
    ) -> None:
        self._views = tuple(views)
        self._at = tuple(view.seen.at for view in views)
        base = views[0].base
        self._size = base.size
        self._poses = np.diag(np.r_[np.zeros(base.model.size), *[_POSE] * base.runs])
        self._prior = prior
        self._lines = Lines(views, FOLDS)
        self._offers = tuple(_offered(families, self._at))
        # What was tried once is not computed again.
        self._explained: dict[tuple[_Key, ...], Explanation] = {}
        self._looked_in: dict[Explanation, dict[str, Offer]] = {}
        self._sharp: dict[tuple[Explanation, _Key], Offer] = {}
        self._listed = float(np.log(len(self._offers)))

    @property
    def causes(self) -> tuple[Offer, ...]:
        """All effects that are looked for but structure without a name."""
        return tuple(o for o in self._offers if not isinstance(o.family, Described))

    @property
    def compared(self) -> int:
        """How many effects are looked for."""
        return len(self._offers)

    def explained(self, chosen: Sequence[Offer]) -> Explanation:
        """Return the Run explained by base and given effects, their values refined."""
        key = tuple(_key(o) for o in chosen)
        if key not in self._explained:
            self._explained[key] = self._explain(chosen)
        return self._explained[key]

    def _explain(self, chosen: Sequence[Offer]) -> Explanation:
        size = self._size
        known = self._prior.precision_matrix(size) + self._poses
        chosen = refined(self._lines, self._at, known, chosen)
        columns = np.arange(size + sum(len(o.candidate.usual) for o in chosen))
        sums = self._lines.sums(_effects(chosen))
        data = sums.information(columns)
        more = prior_precision(self._poses, _candidates(chosen))
        data = replace(data, matrix=data.matrix + more)
        prior, fit = self._prior.fitted(data)
        self._prior = prior
        precision = self._precision(prior, chosen)
        return Explanation(chosen, size, prior, fit, held_out(sums, columns, precision))

    def ranked(self, explanation: Explanation, offers: Sequence[Offer]) -> list[Ranked]:
        """Return what offers would gain beyond an explanation, best first.

        offers : with their values, as they are
        """
        chosen = explanation.chosen
        offered = self._lines.offered(_effects(chosen), _effects(offers))
        left = rest(offered, self._precision(explanation.prior, chosen))
        found = [
            Ranked(o, left.log_bayes(k, o.candidate.usual) - o.price - self._listed)
            for k, o in enumerate(offers)
        ]
        return sorted(found, key=_by_evidence)

    def promising(
        self, explanation: Explanation, among: Sequence[Offer] | None = None
    ) -> list[Ranked]:
        """Return what effects would gain, best first, scanned anew.

        among : the whole catalogue if not given
        The quick gain of a scan leaves the base aside: values of the best are tried
        again with it.
        """
        among = self._offers if among is None else among
        found = self.ranked(explanation, self._scanned(explanation, among))
        best = [self._sharpened(explanation, r.offer) for r in found[:_SHARPENED]]
        again = self.ranked(explanation, best) if best else []
        return sorted([*again, *found[_SHARPENED:]], key=_by_evidence)

    def _sharpened(self, explanation: Explanation, offer: Offer) -> Offer:
        """Return the offer at the best value of its scan, the base integrated out."""
        key = explanation, _key(offer)
        if key not in self._sharp:
            best = self._sharpen(explanation, offer)
            self._sharp |= {key: best, (explanation, _key(best)): best}
        return self._sharp[key]

    def _sharpen(self, explanation: Explanation, offer: Offer) -> Offer:
        at = self._at[offer.run or 0]
        scan = offer.family.scan(offer.candidate, at)
        if scan is None or offer.family.wave(offer.candidate, at) is not None:
            return offer
        values = [offer.at_value(at, float(value)) for value in scan.values]
        tries = [replace(offer, candidate=candidate) for candidate in values]
        best = self.ranked(explanation, [offer, *tries])[0].offer
        if not offer.family.happens_once:
            return best
        known = explanation.prior.precision_matrix(self._size) + self._poses
        return at_its_moment(self._lines, at, known, explanation.chosen, best)

    def _scanned(self, explanation: Explanation, among: Sequence[Offer]) -> list[Offer]:
        """Return offers, but the chosen ones, at their best values."""
        known = self._looked_in.setdefault(explanation, {})
        taken = {o.label for o in explanation.chosen}
        wanted = [o for o in among if o.label not in taken]
        if any(o.label not in known for o in wanted):
            left = self.residuals(explanation)
            new = [o for o in wanted if o.label not in known]
            known |= {o.label: scanned(o, left) for o in new}
        return [known[o.label] for o in wanted]

    def residuals(self, explanation: Explanation) -> list[Residual]:
        """Return what an explanation leaves in every cell of each Run."""
        effects = _effects(explanation.chosen)
        theta = explanation.fit.theta
        return [
            weighted_residual(view, self._lines.of(run), effects, theta)
            for run, view in enumerate(self._views)
        ]

    def _precision(
        self, prior: BasePrior, chosen: Sequence[Offer]
    ) -> Float64[np.ndarray, "p p"]:
        known = prior.precision_matrix(self._size) + self._poses
        return prior_precision(known, _candidates(chosen))


def _key(offer: Offer) -> _Key:
    return offer.candidate, offer.run


def _by_evidence(ranked: Ranked) -> float:
    return -ranked.evidence


def _effects(offers: Sequence[Offer]) -> list[Effect]:
    return [o.effect for o in offers]


def _offered(families: Sequence[Family], at: Sequence[Conditions]) -> Iterator[Offer]:
    """Yield what may be missing: of the machine once, of each Run what ends with it."""
    of_machine: set[str] = set()
    for run, here in enumerate(at):
        for family in families:
            for candidate in family.candidates(here):
                if not family.outlasts(candidate, here.machine):
                    yield Offer(family, candidate, run)
                elif candidate.label not in of_machine:
                    of_machine.add(candidate.label)
                    yield Offer(family, candidate)


def _candidates(offers: Sequence[Offer]) -> tuple[Candidate, ...]:
    return tuple(o.candidate for o in offers)
