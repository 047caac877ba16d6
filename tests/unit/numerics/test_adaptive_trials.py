"""The adaptive procedure against the examples of JCGM 101:2008, clause 9."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.stats import norm

from truepath.numerics.adaptive_trials import (
    BLOCK,
    NORMAL_FACTOR,
    TrialPlan,
    agrees,
    numerical_tolerance,
    propagate,
    summarise,
)


def blocks(draw, seed=1, interval="symmetric"):
    def made(number):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
        return summarise(np.atleast_2d(draw(rng)), interval)

    return made


def normal_sum(rng):
    return rng.standard_normal((4, BLOCK)).sum(axis=0)


def rectangles(widths):
    half = np.sqrt(3.0) * np.array(widths)[:, None]
    return lambda rng: (half * rng.uniform(-1.0, 1.0, (len(half), BLOCK))).sum(axis=0)


def exponential(rng):
    return rng.exponential(1.0, BLOCK)


@pytest.mark.parametrize(
    ("draw", "sigma", "digits", "end", "within", "is_validated"),
    [
        (normal_sum, 2.0, 1, 3.92, 0.1, True),  # 9.2.2
        (rectangles([1.0] * 4), 2.0, 1, 3.88, 0.1, True),  # 9.2.3
        (rectangles([1.0, 1.0, 1.0, 10.0]), 10.1, 2, 17.0, 0.2, False),  # 9.2.4
    ],
    ids=["normal", "equal rectangles", "a dominant rectangle"],
)
def test_the_examples_of_9_2_have_their_intervals_and_verdicts(
    draw, sigma, digits, end, within, is_validated
):
    plan = TrialPlan(digits=digits)
    told = propagate(blocks(draw, plan.seed, plan.interval), plan)
    assert told.settled
    assert told.sigma[0] == pytest.approx(sigma, abs=within / 2.0)
    assert (told.low[0], told.high[0]) == pytest.approx((-end, end), abs=within)
    fits = agrees(told, np.zeros(1), np.array([sigma]), plan.digits)
    assert bool(fits[0]) == is_validated


def test_the_shortest_interval_of_a_skewed_output_begins_at_its_mode():
    plan = TrialPlan(interval="shortest")
    shortest = propagate(blocks(exponential, interval="shortest"), plan)
    symmetric = propagate(blocks(exponential), TrialPlan())
    assert shortest.low[0] == pytest.approx(0.0, abs=0.01)
    assert shortest.high[0] == pytest.approx(-np.log(0.05), abs=0.1)
    assert symmetric.low[0] == pytest.approx(-np.log(0.975), abs=0.01)
    assert symmetric.high[0] == pytest.approx(-np.log(0.025), abs=0.1)


@pytest.mark.parametrize("interval", ["symmetric", "shortest"])
def test_what_is_kept_of_the_blocks_gives_the_interval_of_all_trials(interval):
    drawn = [exponential(np.random.default_rng(i)) for i in range(7)]
    plan = TrialPlan(interval=interval, digits=2, most_blocks=7)
    told = propagate(lambda number: summarise(drawn[number][None], interval), plan)
    every = np.sort(np.concatenate(drawn))
    q = int(0.95 * len(every) + 0.5)
    spans = every[q:] - every[: len(every) - q]
    r = (len(every) - q + 1) // 2 - 1 if interval == "symmetric" else spans.argmin()
    assert told.trials == len(every)
    assert told.low[0] == pytest.approx(every[r], rel=1e-6)
    assert told.high[0] == pytest.approx(every[r + q], rel=1e-6)
    assert told.mean[0] == pytest.approx(every.mean(), rel=1e-12)
    assert told.sigma[0] == pytest.approx(every.std(ddof=1), rel=1e-12)


def test_it_stops_where_each_result_is_certain_to_a_fifth_of_the_tolerance():
    results = []

    def counted(rng):
        x = normal_sum(rng)
        results.append((x.mean(), x.std(ddof=1), *np.quantile(x, [0.025, 0.975])))
        return x

    told = propagate(blocks(counted), TrialPlan(digits=1))

    def unsure(h):
        return 2.0 * np.std(results[:h], axis=0, ddof=1).max() / np.sqrt(h)

    limit = 0.5 / 5.0  # u = 2 has its one digit in the ones
    assert told.trials == len(results) * BLOCK
    assert unsure(len(results)) <= limit
    assert all(unsure(h) > limit for h in range(2, len(results)))


def test_one_more_digit_takes_many_more_trials_and_those_that_do_not_settle_say_so():
    drawn, shares = blocks(rectangles([9.0])), []
    coarse = propagate(drawn, TrialPlan(digits=1), on_progress=shares.append)
    assert shares == sorted(shares), "the share done only grows"
    assert shares[-1] == pytest.approx(1.0)
    fine = propagate(drawn, TrialPlan(digits=2, most_blocks=40))
    assert fine.trials >= 4 * coarse.trials
    told = propagate(blocks(normal_sum), TrialPlan(digits=2, most_blocks=3))
    assert told.trials == 3 * BLOCK
    assert not told.settled


def test_who_shares_the_work_and_works_ahead_does_not_change_the_answer():
    plan = TrialPlan(seed=4, digits=2, most_blocks=6)
    alone = propagate(blocks(normal_sum, 4), plan)
    with ThreadPoolExecutor(3) as pool:
        shared = propagate(blocks(normal_sum, 4), plan, pool.map)
    for what in ("mean", "sigma", "low", "high"):
        np.testing.assert_array_equal(getattr(alone, what), getattr(shared, what))


def test_the_tolerance_is_half_a_unit_of_the_last_digit_and_the_factor_the_normal_one():
    u = np.array([0.00035, 2.0, 9.9, 10.1])
    np.testing.assert_allclose(numerical_tolerance(u, 2), [0.5e-5, 0.05, 0.05, 0.5])
    np.testing.assert_allclose(numerical_tolerance(u, 1), [0.5e-4, 0.5, 0.5, 5.0])
    assert pytest.approx(norm.ppf(0.975), abs=1e-6) == NORMAL_FACTOR


def test_what_is_fixed_by_convention_agrees_whatever_rounding_leaves_of_it():
    def one_is_fixed(rng):
        return np.stack([normal_sum(rng), 1e-15 * rng.standard_normal(BLOCK)])

    told = propagate(blocks(one_is_fixed), TrialPlan())
    fits = agrees(told, np.zeros(2), np.array([2.0, 1e-9]), 1)
    assert told.settled
    assert fits.all()
