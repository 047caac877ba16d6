"""The time of an event, such as an unintended shift of the set-up, to one cell.

Two times within one line differ on that line alone, so all other lines are summed once.
The exact time within a line exceeds its neighbours only within some hundredths of a
second, and a pause next to the line is the best of all times farther away: no slope
leads to the exact time. So every cell around the best time is tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.discovery.evidence import TermData
from truepath.kinematics.effects.family import CandidateTerm

_ROUNDS = 4  # the best time moves into a line, to its end, and beyond


@dataclass(frozen=True)
class _Trials:
    time_s: Float64[np.ndarray, " v"]
    width_s: Float64[np.ndarray, " v"]
    log_bayes: Float64[np.ndarray, " v"]

    @staticmethod
    def join(parts: Sequence[_Trials]) -> _Trials:
        return _Trials(
            np.concatenate([p.time_s for p in parts]),
            np.concatenate([p.width_s for p in parts]),
            np.concatenate([p.log_bayes for p in parts]),
        )

    @property
    def best_s(self) -> float:
        return float(self.time_s[np.argmax(self.log_bayes)])

    def sigma_s(self) -> float:
        weight = np.exp(self.log_bayes - self.log_bayes.max()) * self.width_s
        square = (self.time_s - self.best_s) ** 2 + self.width_s**2 / 12.0
        return float(np.sqrt(weight @ square / weight.sum()))


def locate_event(
    data: TermData, beside: Sequence[CandidateTerm], term: CandidateTerm
) -> CandidateTerm:
    """A one-time term at its best time, with its uncertainty.

    beside : terms that are fitted with it
    """
    at = data.conditions_of(term)
    trials: dict[int, _Trials] = {}
    for _ in range(_ROUNDS):
        time_s = term.candidate.value or 0.0
        near = [
            n
            for n in data.equations.lines.about(term.run or 0, time_s)
            if n not in trials
        ]
        if not near:
            break
        trials |= {n: _try_line(data, beside, term, n) for n in near}
        joined = _Trials.join(list(trials.values()))
        if not len(joined.time_s):
            break
        best = term.with_value(joined.best_s)
        term = replace(best, value_sigma=joined.sigma_s())
    # Each cell of the Run was a candidate, and neighbours hardly differ.
    return replace(term, price=float(np.log(max(len(at) / 4.0, 1.0))))


def _try_line(
    data: TermData, beside: Sequence[CandidateTerm], term: CandidateTerm, line: int
) -> _Trials:
    edges_s = data.equations.lines.edges_s(line)
    time_s, width_s = 0.5 * (edges_s[1:] + edges_s[:-1]), np.diff(edges_s)
    if not len(time_s):
        return _Trials(time_s, width_s, width_s)
    remainder = data.compare_moments(beside, term, time_s)
    return _Trials(time_s, width_s, remainder.log_bayes())
