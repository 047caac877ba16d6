"""Sharpen what is not linear by its own column: Gauss–Newton on lead, moment, decay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from app.discovery.evidence import prior_precision, rest
from app.discovery.moments import at_its_moment
from app.discovery.scan import Offer
from app.discovery.spread import spread
from app.discovery.sums import Lines
from app.estimation.information import Posterior, posterior
from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter

_ROUNDS = 4
_SETTLED = 0.05  # of the value's own uncertainty
_GRID, _GRIDS = 25, 2  # values tried at once, and how often
_AS_GOOD = 0.05  # log Bayes factors closer than this are of one value
_FREE = 4.0  # spacings: what limits a step must not pass for knowledge
_STEP = 0.02  # of a scan's spacing, for the derivative


@dataclass(frozen=True)
class ByValue(Effect):
    """How a scanned effect changes with its value, at its present size."""

    before: Effect
    after: Effect
    step: float
    theta: tuple[float, ...]

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"{self.before.name}-by-value"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The change of the value."""
        return (Parameter(self.name, "1"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the central difference of the displacement."""
        change = self.after.jacobian(at) - self.before.jacobian(at)
        return (change @ np.array(self.theta))[:, :, None] / self.step

    def in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 1"] | None:
        """Return the same at single moments."""
        before, after = self.before.in_time(time_s), self.after.in_time(time_s)
        if before is None or after is None:
            return None
        return ((after - before) @ np.array(self.theta))[:, :, None] / self.step


def refined(
    lines: Lines,
    at: Sequence[Conditions],
    precision: Float64[np.ndarray, "b b"],
    offers: Sequence[Offer],
) -> tuple[Offer, ...]:
    """Return the offers with their scanned values at the best, and how well known.

    at : conditions of each Run; precision : prior of machine and poses
    """
    found = _tried(lines, at, precision, tuple(offers))
    values = [k for k, o in enumerate(found) if _is_scanned(o) and o.family.is_smooth]
    if not values:
        return found
    fit = _fit(lines, found, [], precision, np.empty(0))
    for _ in range(_ROUNDS):
        spacing = np.array([_spacing(found[k], _its(at, found[k])) for k in values])
        theta = np.split(fit.theta[len(precision) :], _ends(found))
        slopes = [
            _by_value(found[k], _its(at, found[k]), theta[k], _STEP * h)
            for k, h in zip(values, spacing, strict=True)
        ]
        fit = _fit(lines, found, slopes, precision, spacing)
        first = len(fit.theta) - len(values)
        sigma = np.sqrt(np.diag(fit.covariance)[first:])
        step = np.clip(fit.theta[first:], -spacing, spacing)
        changed, bounds = list(found), np.append(0, _ends(found))
        for k, d, s in zip(values, step, sigma, strict=True):
            part = slice(*(len(precision) + bounds[k : k + 2]))
            moved = _at(found[k], _its(at, found[k]), float(d), float(s))
            changed[k] = replace(moved, covariance=fit.covariance[part, part])
        found = tuple(changed)
        if float(np.max(np.abs(step) / sigma)) < _SETTLED:
            break
    for k in values:
        if found[k].family.wave(found[k].candidate, _its(at, found[k])) is None:
            others = [o for o in found if o is not found[k]]
            offer = spread(lines, _its(at, found[k]), precision, others, found[k])
            found = (*found[:k], offer, *found[k + 1 :])
    return found


def _its(at: Sequence[Conditions], offer: Offer) -> Conditions:
    """Return the conditions of the Run that an offer is scanned in."""
    return at[offer.run or 0]


def _is_scanned(offer: Offer) -> bool:
    return offer.candidate.value is not None


def _tried(
    lines: Lines,
    at: Sequence[Conditions],
    precision: Float64[np.ndarray, "b b"],
    offers: tuple[Offer, ...],
) -> tuple[Offer, ...]:
    """Return the offers, those that no slope leads at the best of many values."""
    found = list(offers)
    for k, offer in enumerate(offers):
        if not _is_scanned(offer) or offer.family.is_smooth:
            continue
        here = _its(at, offer)
        others = tuple(o for j, o in enumerate(found) if j != k)
        if offer.family.happens_once:
            found[k] = at_its_moment(lines, here, precision, others, offer)
            continue
        reach = 2.0 * max(_spacing(offer, here), _mean_spacing(offer, here))
        for _ in range(_GRIDS):
            offer = _best_of_grid(lines, here, precision, others, offer, reach)
            # As far as values are as good: a step may lie anywhere between two cells.
            reach = max(4.0 / _GRID * reach, 3.0 * offer.value_sigma)
        found[k] = offer
    return tuple(found)


def _best_of_grid(
    lines: Lines,
    at: Conditions,
    precision: Float64[np.ndarray, "b b"],
    others: tuple[Offer, ...],
    offer: Offer,
    reach: float,
) -> Offer:
    """Return the offer at the best of values about its own, and their spread."""
    scan = offer.family.scan(offer.candidate, at)
    middle = offer.candidate.value or 0.0
    values = np.linspace(middle - reach, middle + reach, _GRID)
    if scan is not None:
        values = np.clip(values, scan.values[0], scan.values[-1])
    tries = [offer.at_value(at, float(v)) for v in values]
    chosen = tuple(o.candidate for o in others)
    tried = [offer.effect_of(c) for c in tries]
    offered = lines.offered([o.effect for o in others], tried)
    left = rest(offered, prior_precision(precision, chosen))
    gains = np.array([left.log_bayes(j, c.usual) for j, c in enumerate(tries)])
    weight = np.exp(gains - gains.max())
    weight /= weight.sum()
    mean = float(weight @ values)
    spread = float(np.sqrt(weight @ (values - mean) ** 2))
    # Between neighbours of the grid nothing is known: that is the least spread.
    least = float(values[1] - values[0]) / np.sqrt(12.0)
    best = tries[_middle(values, gains, mean)]
    return replace(offer, candidate=best, value_sigma=max(spread, float(least)))


def _middle(
    values: Float64[np.ndarray, " v"], gains: Float64[np.ndarray, " v"], mean: float
) -> int:
    """Return the number of the best value; of as good ones that nearest to the mean."""
    off = np.where(gains > gains.max() - _AS_GOOD, np.abs(values - mean), np.inf)
    return int(np.argmin(off))


def _ends(offers: Sequence[Offer]) -> Int64[np.ndarray, " o"]:
    return np.cumsum([len(o.candidate.usual) for o in offers])


def _fit(
    lines: Lines,
    offers: Sequence[Offer],
    slopes: Sequence[Effect],
    precision: Float64[np.ndarray, "b b"],
    spacing: Float64[np.ndarray, " v"],
) -> Posterior:
    sums = lines.sums([*(o.effect for o in offers), *slopes])
    known = prior_precision(precision, [o.candidate for o in offers])
    size = len(known)
    total = np.zeros((size + len(spacing), size + len(spacing)))
    total[:size, :size] = known
    own = range(size, len(total))
    total[own, own] = (_FREE * spacing) ** -2
    return posterior(sums.information(np.arange(len(total))), total)


def _at(offer: Offer, at: Conditions, change: float, sigma: float) -> Offer:
    scan = offer.family.scan(offer.candidate, at)
    value = (offer.candidate.value or 0.0) + change
    if scan is not None:
        value = float(np.clip(value, scan.values[0], scan.values[-1]))
    return replace(offer, candidate=offer.at_value(at, value), value_sigma=sigma)


def _spacing(offer: Offer, at: Conditions) -> float:
    """Return the distance of neighbours of the scan at the present value."""
    scan, value = offer.family.scan(offer.candidate, at), offer.candidate.value
    if scan is None or value is None or len(scan.values) < 2:
        return 1.0
    place = int(np.clip(np.searchsorted(scan.values, value), 1, len(scan.values) - 1))
    return float(scan.values[place] - scan.values[place - 1])


def _mean_spacing(offer: Offer, at: Conditions) -> float:
    """Return the distance of neighbours of the scan on average."""
    scan = offer.family.scan(offer.candidate, at)
    return 0.0 if scan is None else float(np.ptp(scan.values)) / len(scan.values)


def _by_value(
    offer: Offer, at: Conditions, theta: Float64[np.ndarray, " p"], step: float
) -> ByValue:
    value = offer.candidate.value or 0.0
    before, after = (
        offer.effect_of(offer.at_value(at, value + side * 0.5 * step))
        for side in (-1.0, 1.0)
    )
    return ByValue(before, after, step, tuple(float(t) for t in theta))
