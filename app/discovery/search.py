"""Find the effects: one by one on evidence, tried again for exchange and removal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.discovery.explaining import Explainer, Explanation
from app.discovery.scan import Offer
from app.kinematics.effects.catalogue import Described

LEAST_EVIDENCE = 5.0  # log Bayes factor, price paid: a false alarm in a hundred Runs
_MOST_EFFECTS = 6
_TRIED = 2  # offers that held-out lines may refuse before the search ends
_EQUIVALENT = 3.0  # log Bayes factors closer than this decide nothing

_Offers = Sequence[Offer] | None


class Search:
    """The way to the effects that Runs have evidence for."""

    def __init__(self, explainer: Explainer) -> None:
        self._of = explainer

    def found(self, chosen: Sequence[Offer] = ()) -> Explanation:
        """Return the effects that the Run has evidence for, starting from some."""
        return self._pruned(self._named(self.grown(chosen)))

    def grown(self, chosen: Sequence[Offer] = ()) -> Explanation:
        """Return what `found` begins with: shapes may still stand for causes."""
        return self._grown(self._pruned(self._of.explained(chosen)))

    def _grown(
        self,
        best: Explanation,
        among: _Offers = None,
        most: int = _MOST_EFFECTS,
    ) -> Explanation:
        """Return the explanation with all that evidence asks for besides.

        among : what may be asked for; the whole catalogue if not given
        """
        while len(best.chosen) < most:
            larger = self._larger(best, among)
            if larger is None:
                break
            best = self._tried_again(larger, among)
        return best

    def _named(self, best: Explanation) -> Explanation:
        """Let causes explain what structure without a name has taken, if they can.

        One after another, shapes that fit anything may take together what as many
        causes explain, or fewer.
        """
        kept = [o for o in best.chosen if not isinstance(o.family, Described)]
        if len(kept) == len(best.chosen):
            return best
        start = self._pruned(self._of.explained(kept))
        other = self._grown(start, self._of.causes, len(best.chosen))
        if {o.label for o in other.chosen} == {o.label for o in kept}:
            return best
        other = self._grown(other)
        gain = self._evidence(other) - self._evidence(best)
        return other if gain > -_EQUIVALENT else best

    def _evidence(self, explanation: Explanation) -> float:
        """Return the log Bayes factor of all chosen effects, price of search paid."""
        chosen, total = explanation.chosen, 0.0
        for k, offer in enumerate(chosen):
            total += self._of.ranked(self._of.explained(chosen[:k]), [offer])[
                0
            ].evidence
        return total

    def _larger(
        self, best: Explanation, among: Sequence[Offer] | None
    ) -> Explanation | None:
        """Return the explanation with one effect more, if evidence asks for it."""
        for offer in self._of.promising(best, among)[:_TRIED]:
            if offer.evidence < LEAST_EVIDENCE:
                return None
            larger = self._of.explained((*best.chosen, offer.offer))
            if larger.foretold.square.sum() < best.foretold.square.sum():
                return larger
        return None

    def _pruned(self, best: Explanation) -> Explanation:
        """Remove what has no evidence given the others, the least first.

        A better judged noise leaves no room for what an earlier one let in.
        """
        while best.chosen:
            others = [[o for o in best.chosen if o is not k] for k in best.chosen]
            without = [self._of.explained(left) for left in others]
            evidence = [
                self._of.ranked(one, [offer])[0].evidence
                for one, offer in zip(without, best.chosen, strict=True)
            ]
            least = int(np.argmin(evidence))
            if evidence[least] >= LEAST_EVIDENCE:
                break
            best = without[least]
        return best

    def _tried_again(
        self, best: Explanation, among: Sequence[Offer] | None
    ) -> Explanation:
        """Exchange or remove what later effects have made worse or needless."""
        for offer in best.chosen[:-1]:
            others = [o for o in best.chosen if o is not offer]
            without = self._of.explained(others)
            other = self._of.promising(without, among)[0]
            own = self._of.ranked(without, [offer])[0]
            if max(other.evidence, own.evidence) < LEAST_EVIDENCE:
                return without
            if other.evidence > own.evidence + _EQUIVALENT:
                return self._of.explained((*without.chosen, other.offer))
        return best
