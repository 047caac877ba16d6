"""The shortest extra lines that tell competing explanations apart.

Names compete where another effect explains as much; evidence is thin where one more
effect, or one less, explains about as much. Lines are chosen one after another, each
beginning where the last one ended, by the log Bayes factor that they are expected to
bring a second: away and back, along axes and across, at the feeds that the Runs used
and slower ones. They end when every question is expected to be decided.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.discovery.discover import Discovery
from app.discovery.explaining import Explanation
from app.discovery.extra_lines import DECIDED, ExtraLines, highest_feed_mm_min
from app.discovery.scan import Offer
from app.discovery.search import LEAST_EVIDENCE
from app.discovery.telling_apart import Question, belief_of
from app.estimation.volumetric_map import volumetric_gram
from app.motion.paths import travel_time_s
from drivers.interfaces.records import Path

_THIN = LEAST_EVIDENCE + 3.0
_WORTH_ASKING = 0.5 * LEAST_EVIDENCE
_MOST_QUESTIONS = 3


@dataclass(frozen=True)
class Ask:
    """Lines to drive, and which questions they are to decide.

    expected : log Bayes factor that the lines bring to each question
    """

    questions: tuple[Question, ...]
    path: Path
    expected: tuple[float, ...]

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.path) - 1

    @property
    def duration_s(self) -> float:
        """Time that they take."""
        return travel_time_s(self.path)

    @property
    def decides(self) -> bool:
        """Whether every question is expected to be decided."""
        return min(self.expected) >= DECIDED


def ask(found: Discovery, *, seed: int = 0) -> Ask | None:
    """Return the lines that would decide what the Runs leave open; None if nothing.

    The same seed gives the same lines.
    """
    questions = tuple(_questions(found))[:_MOST_QUESTIONS]
    if not questions:
        return None
    feed = highest_feed_mm_min([scene.run for scene in found.scenes])
    rng = np.random.default_rng(seed)
    lines = ExtraLines(found.scene, found.ground.base, questions, feed, rng)
    return Ask(questions, *lines.chosen())


def _questions(found: Discovery) -> Iterator[Question]:
    best, explainer = found.explanation, found.explainer
    gram = volumetric_gram(found.ground.base.model)
    for finding in (f for f in found.findings if f.structure is None):
        others = [o for o in best.chosen if o is not finding.offer]
        for rival in finding.rivals:
            instead = explainer.explained([*others, rival])
            yield _question(found, gram, finding.offer, rival, best, instead)
        if finding.evidence.log_bayes < _THIN:
            without = explainer.explained(others)
            yield _question(found, gram, finding.offer, None, best, without)
    yield from _more(found, gram)


def _more(found: Discovery, gram: Float64[np.ndarray, "m m"]) -> Iterator[Question]:
    """Yield the effect that the evidence was not quite enough for."""
    ranked = found.explainer.promising(found.explanation)
    chosen = found.explanation.chosen
    near = ranked[0] if ranked else None
    if near is not None and _WORTH_ASKING < near.evidence < LEAST_EVIDENCE:
        offer = near.offer
        larger = found.explainer.explained([*chosen, offer])
        yield _question(found, gram, offer, None, larger, found.explanation)


def _question(
    found: Discovery,
    gram: Float64[np.ndarray, "m m"],
    one: Offer,
    other: Offer | None,
    with_one: Explanation,
    with_other: Explanation,
) -> Question:
    base, runs = found.ground.base, len(found.scenes)
    return Question(
        one.candidate.label,
        "" if other is None else other.candidate.label,
        belief_of(with_one, gram),
        belief_of(with_other, gram),
        replace(base, runs=runs + 1),
    )
