"""When something happened once: tried at every cell about a moment.

Two moments of one line differ on that line alone, so its other lines are summed once.
The exact moment within a line stands out by its neighbours' few hundredths of a second,
and a pause beside that line is the best of all that lie further: no slope leads there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.discovery.evidence import prior_precision, rest
from app.discovery.scan import Offer
from app.discovery.sums import Lines
from app.kinematics.conditions import Conditions

_ROUNDS = 4  # the best moment moves into a line, and to its end, and beyond


@dataclass(frozen=True)
class _Tried:
    """Moments of one stretch of time, how far apart, and their log Bayes factors."""

    time_s: Float64[np.ndarray, " v"]
    width_s: Float64[np.ndarray, " v"]
    gain: Float64[np.ndarray, " v"]

    @staticmethod
    def joined(parts: Sequence[_Tried]) -> _Tried:
        return _Tried(
            np.concatenate([p.time_s for p in parts]),
            np.concatenate([p.width_s for p in parts]),
            np.concatenate([p.gain for p in parts]),
        )

    @property
    def best_s(self) -> float:
        """The moment that explains most."""
        return float(self.time_s[np.argmax(self.gain)])

    def sigma_s(self) -> float:
        """Return the standard uncertainty of the best: all may be it, as they gain."""
        weight = np.exp(self.gain - self.gain.max()) * self.width_s
        off = (self.time_s - self.best_s) ** 2 + self.width_s**2 / 12.0
        return float(np.sqrt(weight @ off / weight.sum()))


def at_its_moment(
    lines: Lines,
    at: Conditions,
    precision: Float64[np.ndarray, "b b"],
    others: Sequence[Offer],
    offer: Offer,
) -> Offer:
    """Return an offer that happens once at its best moment, and how well it is known.

    at : conditions of its Run; precision : prior of base, poses; others : known effects
    """
    tried: dict[int, _Tried] = {}
    for _ in range(_ROUNDS):
        moment = offer.candidate.value or 0.0
        near = [n for n in lines.about(offer.run or 0, moment) if n not in tried]
        if not near:
            break
        tried |= {n: _along(lines, at, precision, others, offer, n) for n in near}
        found = _Tried.joined(list(tried.values()))
        if not len(found.gain):
            break
        best = offer.at_value(at, found.best_s)
        offer = replace(offer, candidate=best, value_sigma=found.sigma_s())
    # Each cell of the Run may have been it, and neighbours tell nearly the same.
    return replace(offer, price=float(np.log(max(len(at) / 4.0, 1.0))))


def _along(
    lines: Lines,
    at: Conditions,
    precision: Float64[np.ndarray, "b b"],
    others: Sequence[Offer],
    offer: Offer,
    number: int,
) -> _Tried:
    """Return the moments between the cells of a line, and in the pause before it."""
    edges = lines.edges_s(number)
    time_s, width_s = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    if not len(time_s):
        return _Tried(time_s, width_s, width_s)
    tries = [offer.at_value(at, float(t)) for t in time_s]
    offered = lines.offered_along(
        [o.effect for o in others], [offer.effect_of(c) for c in tries], number
    )
    chosen = [o.candidate for o in others]
    left = rest(offered, prior_precision(precision, chosen))
    gain = [left.log_bayes(k, c.usual) for k, c in enumerate(tries)]
    return _Tried(time_s, width_s, np.array(gain))
