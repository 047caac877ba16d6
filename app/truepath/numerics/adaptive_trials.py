"""Propagation of distributions by as many Monte Carlo trials as the digits need.

JCGM 101:2008 (GUM Supplement 1). Clause 7.9.4: blocks of M = 10⁴ trials are added until
twice the standard deviation of the mean over blocks of each result (estimate, standard
uncertainty, both ends of the coverage interval) is within the numerical tolerance, for
every output. Clause 8: the linear law is validated where both ends of its interval are
within the tolerance δ of those of the trials; for that the trials stop at δ/5 (8.2).

A block is stored as its moments and the sorted trials of both tails: the moments and
the interval of all trials together depend on nothing else, and it takes a tenth of the
memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float32, Float64

from truepath.progress import ShareProgress, ignore_progress

BLOCK = 10_000  # trials: max(J, 10⁴), J ≥ 100/(1 − p), 7.9.4 b
COVERAGE = 0.95
NORMAL_FACTOR = 1.959964  # k_p of a normal distribution for this coverage
_VALIDATION = 5.0  # δ/5 to validate, 8.2
_FEWEST = 2  # blocks: a standard deviation needs two
# Share of a block stored of each tail, nine standard deviations of its count beyond
# the most that all trials together may need of it.
_KEPT = {"symmetric": 0.04, "shortest": 0.07}

Interval = Literal["symmetric", "shortest"]


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """Seed, required digits and limits of the trials.

    seed : of all blocks; the result depends on nothing else
    digits : significant digits of a standard uncertainty that count, 1 or 2 (7.9.2)
    interval : probabilistically symmetric, or the shortest (7.7)
    most_blocks : limit of blocks, of 10⁴ trials each
    """

    seed: int = 1
    digits: int = 1
    interval: Interval = "symmetric"
    most_blocks: int = 100


@dataclass(frozen=True, slots=True)
class TrialBlock:
    """Summary of a block of trials of o outputs.

    mean, variance : (o,); lowest, highest : (o, k) the k least and greatest, ascending
    """

    trials: int
    mean: Float64[np.ndarray, " o"]
    variance: Float64[np.ndarray, " o"]
    lowest: Float32[np.ndarray, "o k"]
    highest: Float32[np.ndarray, "o k"]


@dataclass(frozen=True, slots=True)
class Propagated:
    """Result of all trials together for o outputs.

    mean, sigma : (o,) estimate and standard uncertainty
    low, high : (o,) ends of the 95 % coverage interval
    settled : twice the standard deviation of each of the four is within tolerance
    """

    trials: int
    settled: bool
    mean: Float64[np.ndarray, " o"]
    sigma: Float64[np.ndarray, " o"]
    low: Float64[np.ndarray, " o"]
    high: Float64[np.ndarray, " o"]


Mapper = Callable[[Callable[[int], TrialBlock], Iterable[int]], Iterable[TrialBlock]]
"""Apply a function to block numbers, in any process, and yield in their order.

It may work ahead; it stops when no more is requested.
"""


def summarise(values: Float64[np.ndarray, "o t"], interval: Interval) -> TrialBlock:
    """Moments and tails of a block; tails as float32."""
    share = round(_KEPT[interval] * values.shape[1])
    ordered = np.sort(values, axis=1)
    return TrialBlock(
        values.shape[1],
        values.mean(axis=1),
        values.var(axis=1, ddof=1),
        ordered[:, :share].astype(np.float32),
        ordered[:, -share:].astype(np.float32),
    )


def propagate(
    draw: Callable[[int], TrialBlock],
    plan: TrialPlan,
    run: Mapper = map,
    on_progress: ShareProgress = ignore_progress,
) -> Propagated:
    """Add blocks in their order until they settle, or `plan.most_blocks` are done.

    draw : the block of a number, always the same
    on_progress : receives the share done, of the trials expected
    """
    blocks: list[TrialBlock] = []
    results: list[Float64[np.ndarray, "4 o"]] = []
    share = 0.0
    for made in run(draw, range(plan.most_blocks)):
        blocks.append(made)
        results.append(_results([made], plan.interval))
        missing = _missing(blocks, results, plan)
        foreseen = min(len(blocks) * max(missing, 1.0) ** 2, plan.most_blocks)
        share = max(share, len(blocks) / max(foreseen, _FEWEST + 1))
        on_progress(share)
        if missing <= 1.0:
            break
    mean, sigma, low, high = _results(blocks, plan.interval)
    trials = sum(made.trials for made in blocks)
    settled = _missing(blocks, results, plan) <= 1.0
    return Propagated(trials, settled, mean, sigma, low, high)


def numerical_tolerance(
    sigma: Float64[np.ndarray, " o"], digits: int
) -> Float64[np.ndarray, " o"]:
    """δ: half a unit of the last significant digit (7.9.2).

    An output without uncertainty, fixed by convention, gets a millionth of the largest.
    """
    sigma = np.maximum(sigma, max(1e-6 * float(sigma.max(initial=0.0)), 1e-300))
    return 0.5 * 10.0 ** (np.floor(np.log10(sigma)) - (digits - 1))


def agrees(
    propagated: Propagated,
    estimate: Float64[np.ndarray, " o"],
    sigma: Float64[np.ndarray, " o"],
    digits: int,
) -> Bool[np.ndarray, " o"]:
    """Outputs whose linear law, estimate ± U, is validated by the trials (8.1)."""
    tolerance = numerical_tolerance(sigma, digits)
    half = NORMAL_FACTOR * sigma
    low = np.abs(estimate - half - propagated.low)
    high = np.abs(estimate + half - propagated.high)
    return (low <= tolerance) & (high <= tolerance)


def _missing(
    blocks: Sequence[TrialBlock],
    results: Sequence[Float64[np.ndarray, "4 o"]],
    plan: TrialPlan,
) -> float:
    """Largest 2 s relative to the tolerance (7.9.4 g to k)."""
    h = len(results)
    if h < _FEWEST:
        return np.inf
    unsure = 2.0 * np.std(results, axis=0, ddof=1) / np.sqrt(h)
    sigma = np.sqrt(_moments(blocks)[1])
    tolerance = numerical_tolerance(sigma, plan.digits) / _VALIDATION
    return float((unsure / tolerance).max())


def _results(
    blocks: Sequence[TrialBlock], interval: Interval
) -> Float64[np.ndarray, "4 o"]:
    """Mean, standard deviation and both ends of the interval (7.6, 7.7)."""
    mean, variance = _moments(blocks)
    trials = sum(made.trials for made in blocks)
    outside = trials - int(COVERAGE * trials + 0.5)  # M − q
    lowest = np.sort(np.hstack([made.lowest for made in blocks]), axis=1)
    highest = np.sort(np.hstack([made.highest for made in blocks]), axis=1)
    if interval == "symmetric":
        r = (outside + 1) // 2
        low, high = lowest[:, r - 1], highest[:, r - 1 - outside]
    else:
        starts, ends = lowest[:, :outside], highest[:, -outside:]
        r = np.argmin(ends - starts, axis=1)[:, None]
        low = np.take_along_axis(starts, r, axis=1)[:, 0]
        high = np.take_along_axis(ends, r, axis=1)[:, 0]
    return np.stack([mean, np.sqrt(variance), low, high]).astype(np.float64)


def _moments(
    blocks: Sequence[TrialBlock],
) -> tuple[Float64[np.ndarray, " o"], Float64[np.ndarray, " o"]]:
    count = np.array([made.trials for made in blocks], float)
    means = np.array([made.mean for made in blocks])
    variances = np.array([made.variance for made in blocks])
    mean = count @ means / count.sum()
    square = (count - 1.0) @ variances + count @ (means - mean) ** 2
    return mean, square / (count.sum() - 1.0)
