"""What a whole result says of itself: whether it may be used, and why not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

State = Literal["usable", "doubtful", "not-usable"]
STATES: tuple[State, ...] = ("usable", "doubtful", "not-usable")  # from best to worst


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a result may be used.

    reasons : plain sentences that name line and time; a usable result has some as well,
        where data were left out
    """

    state: State = "usable"
    reasons: tuple[str, ...] = ()

    @staticmethod
    def worst(verdicts: Iterable[Verdict]) -> Verdict:
        """Return the worst state among verdicts, with the reasons of all."""
        every = tuple(verdicts)
        worst = max((STATES.index(verdict.state) for verdict in every), default=0)
        reasons = (reason for verdict in every for reason in verdict.reasons)
        return Verdict(STATES[worst], tuple(reasons))
