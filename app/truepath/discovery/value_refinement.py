"""Refine scanned values (leads, decays, event times) together with all parameters.

Where a term changes smoothly with its value, Gauss–Newton steps take the derivative as
one more column. Elsewhere the best of many values is taken.

The slope at the best value understates the uncertainty where the likelihood is not
symmetric: a time constant longer than the Run hardly differs from a longer one, and the
final growth depends on it. Values around the best one are then weighted by their
evidence, all values of the scan having equal prior probability.

The time of an event, such as an unintended shift of the set-up, is refined to one cell.
Two times within one line differ on that line alone, so all other lines are summed once.
The exact time within a line exceeds its neighbours only within some hundredths of a
second, and a pause next to the line is the best of all times farther away: no slope
leads to the exact time. So every cell around the best time is tried.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.discovery.evidence import TermData, prior_precision
from truepath.estimation.problem.information import Posterior, compute_posterior
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Parameter
from truepath.kinematics.effects.family import CandidateTerm

_ROUNDS = 4
_SETTLED = 0.05  # of the value's own uncertainty
_GRID, _GRIDS = 25, 2  # values tried at once, and how often
_EQUAL = 0.05  # log Bayes factors closer than this are of one value
_FREE = 4.0  # spacings: prior of a step, too wide to pass for knowledge
_STEP = 0.02  # of a scan's spacing, for the derivative

_Terms = tuple[CandidateTerm, ...]


@dataclass(frozen=True)
class ValueDerivative(Effect):
    """Derivative of a scanned effect by its value, at its present size."""

    before: Effect
    after: Effect
    step: float
    theta: tuple[float, ...]

    @property
    def name(self) -> str:
        return f"{self.before.name}-by-value"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(self.name, "1"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        return self._difference(self.before.jacobian(at), self.after.jacobian(at))

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 1"] | None:
        """The same at single moments; None if the effect is not fast."""
        before, after = (
            self.before.jacobian_in_time(time_s),
            self.after.jacobian_in_time(time_s),
        )
        if before is None or after is None:
            return None
        return self._difference(before, after)

    def _difference(
        self, before: Float64[np.ndarray, "n 3 p"], after: Float64[np.ndarray, "n 3 p"]
    ) -> Float64[np.ndarray, "n 3 1"]:
        return ((after - before) @ np.array(self.theta))[:, :, None] / self.step


def refine_values(data: TermData, terms: Sequence[CandidateTerm]) -> _Terms:
    """The terms at their best scanned values, with their uncertainties."""
    refined = _search_values(data, terms)
    smooth = [
        k
        for k, term in enumerate(refined)
        if term.candidate.value is not None and term.family.is_smooth
    ]
    if not smooth:
        return refined
    refined = _follow_slopes(data, refined, smooth)
    for k in smooth:
        term = refined[k]
        if term.wave(data.conditions_of(term)) is None:
            given = (*refined[:k], *refined[k + 1 :])
            term = _average_value(data, given, term)
            refined = (*refined[:k], term, *refined[k + 1 :])
    return refined


_BELOW, _ABOVE = -4, 10  # standard uncertainties by the slope, in whole steps
_FEWEST = 3  # values, for any to lie between others


def _average_value(
    data: TermData, given: Sequence[CandidateTerm], term: CandidateTerm
) -> CandidateTerm:
    """The term at the mean of its scanned value, with the spread of all values.

    given : terms that are fitted with it
    term : at its best value, its uncertainty by the slope
    """
    at = data.conditions_of(term)
    scan, best = term.scan(at), term.candidate.value
    if scan is None or best is None:
        return term
    steps = best + term.value_sigma * np.arange(_BELOW, _ABOVE + 1)
    values = np.unique(np.clip(steps, scan.values[0], scan.values[-1]))
    if len(values) < _FEWEST:
        return term
    trials = data.try_values(given, term, values)
    # Where values of the scan lie farther apart, fewer of them are equally likely.
    density = 1.0 / np.interp(values, scan.values, np.gradient(scan.values))
    weight = np.exp(trials.log_bayes - trials.log_bayes.max())
    weight *= density * np.gradient(values)
    weight /= weight.sum()
    mean = float(weight @ values)
    off = trials.theta - weight @ trials.theta
    return replace(
        term.with_value(mean),
        value_sigma=float(np.sqrt(weight @ (values - mean) ** 2)),
        covariance=np.tensordot(weight, trials.covariance, 1) + (off.T * weight) @ off,
    )


def _search_values(data: TermData, terms: Sequence[CandidateTerm]) -> _Terms:
    found = list(terms)
    for k, term in enumerate(terms):
        if term.candidate.value is None or term.family.is_smooth:
            continue
        given = found[:k] + found[k + 1 :]
        search = locate_event if term.family.happens_once else _search_grid
        found[k] = search(data, given, term)
    return tuple(found)


def _search_grid(
    data: TermData, given: Sequence[CandidateTerm], term: CandidateTerm
) -> CandidateTerm:
    at = data.conditions_of(term)
    reach = 2.0 * max(_spacing(term, at), _mean_spacing(term, at))
    for _ in range(_GRIDS):
        term = _take_best_of_grid(data, given, term, reach)
        # As far as values are equal: a step may lie anywhere between two cells.
        reach = max(4.0 / _GRID * reach, 3.0 * term.value_sigma)
    return term


def _take_best_of_grid(
    data: TermData,
    given: Sequence[CandidateTerm],
    term: CandidateTerm,
    reach: float,
) -> CandidateTerm:
    at = data.conditions_of(term)
    middle = term.candidate.value or 0.0
    values = np.linspace(middle - reach, middle + reach, _GRID)
    values = _clip(values, term, at)
    log_bayes = data.try_values(given, term, values).log_bayes
    weight = np.exp(log_bayes - log_bayes.max())
    weight /= weight.sum()
    mean = float(weight @ values)
    sigma = float(np.sqrt(weight @ (values - mean) ** 2))
    # Between neighbours of the grid nothing is known: that is the least spread.
    least = float(values[1] - values[0]) / np.sqrt(12.0)
    equal = log_bayes > log_bayes.max() - _EQUAL
    best = int(np.argmin(np.where(equal, np.abs(values - mean), np.inf)))
    best_term = term.with_value(float(values[best]))
    return replace(best_term, value_sigma=max(sigma, float(least)))


def _follow_slopes(data: TermData, terms: _Terms, smooth: Sequence[int]) -> _Terms:
    fit = _fit(data, terms, [], np.empty(0))
    for _ in range(_ROUNDS):
        spacing = np.array(
            [_spacing(terms[k], data.conditions_of(terms[k])) for k in smooth]
        )
        slopes: list[Effect] = []
        for k, width in zip(smooth, spacing, strict=True):
            value, step = terms[k].candidate.value or 0.0, _STEP * width
            before, after = (
                terms[k].with_value(value + side * step).effect for side in (-0.5, 0.5)
            )
            theta = tuple(fit.theta[_columns(data, terms, k)].tolist())
            slopes.append(ValueDerivative(before, after, step, theta))
        fit = _fit(data, terms, slopes, spacing)
        first = len(fit.theta) - len(smooth)
        sigma = np.sqrt(np.diag(fit.covariance)[first:])
        step = np.clip(fit.theta[first:], -spacing, spacing)
        terms = _move_values(data, terms, fit, dict(zip(smooth, step, strict=True)))
        if float(np.max(np.abs(step) / sigma)) < _SETTLED:
            break
    return terms


def _move_values(
    data: TermData, terms: _Terms, fit: Posterior, steps: Mapping[int, float]
) -> _Terms:
    """Clipped to the range of their scans; `fit` has the changes last."""
    moved = list(terms)
    sigma = np.sqrt(np.diag(fit.covariance)[-len(steps) :])
    for (k, step), value_sigma in zip(steps.items(), sigma.tolist(), strict=True):
        at, part = data.conditions_of(terms[k]), _columns(data, terms, k)
        value = (terms[k].candidate.value or 0.0) + float(step)
        value = float(_clip(np.array([value]), terms[k], at)[0])
        moved[k] = replace(
            terms[k].with_value(value),
            value_sigma=value_sigma,
            covariance=fit.covariance[part, part],
        )
    return tuple(moved)


def _columns(data: TermData, terms: _Terms, number: int) -> slice:
    begin = len(data.precision) + sum(t.size for t in terms[:number])
    return slice(begin, begin + terms[number].size)


def _fit(
    data: TermData,
    terms: _Terms,
    slopes: Sequence[Effect],
    spacing: Float64[np.ndarray, " v"],
) -> Posterior:
    sums = data.equations.sums([*(t.effect for t in terms), *slopes])
    known = prior_precision(data.precision, terms)
    size = len(known)
    total = np.zeros((size + len(spacing), size + len(spacing)))
    total[:size, :size] = known
    own = range(size, len(total))
    total[own, own] = (_FREE * spacing) ** -2
    return compute_posterior(sums.information(np.arange(len(total))), total)


def _clip(
    values: Float64[np.ndarray, " v"], term: CandidateTerm, at: Conditions
) -> Float64[np.ndarray, " v"]:
    scan = term.scan(at)
    return values if scan is None else np.clip(values, scan.values[0], scan.values[-1])


def _spacing(term: CandidateTerm, at: Conditions) -> float:
    scan, value = term.scan(at), term.candidate.value
    if scan is None or value is None or len(scan.values) < 2:
        return 1.0
    place = int(np.clip(np.searchsorted(scan.values, value), 1, len(scan.values) - 1))
    return float(scan.values[place] - scan.values[place - 1])


def _mean_spacing(term: CandidateTerm, at: Conditions) -> float:
    scan = term.scan(at)
    return 0.0 if scan is None else float(np.ptp(scan.values)) / len(scan.values)


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
    data: TermData, given: Sequence[CandidateTerm], term: CandidateTerm
) -> CandidateTerm:
    """A one-time term at its best time, with its uncertainty.

    given : terms that are fitted with it
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
        trials |= {n: _try_line(data, given, term, n) for n in near}
        joined = _Trials.join(list(trials.values()))
        if not len(joined.time_s):
            break
        best = term.with_value(joined.best_s)
        term = replace(best, value_sigma=joined.sigma_s())
    # Each cell of the Run was a candidate, and neighbours hardly differ.
    return replace(term, price=float(np.log(max(len(at) / 4.0, 1.0))))


def _try_line(
    data: TermData, given: Sequence[CandidateTerm], term: CandidateTerm, line: int
) -> _Trials:
    edges_s = data.equations.lines.edges_s(line)
    time_s, width_s = 0.5 * (edges_s[1:] + edges_s[:-1]), np.diff(edges_s)
    if not len(time_s):
        return _Trials(time_s, width_s, width_s)
    remainder = data.compare_moments(given, term, time_s)
    return _Trials(time_s, width_s, remainder.log_bayes())
