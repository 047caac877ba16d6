"""Trials that know nothing of the algebra confirm its uncertainty."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from app.alignment.align import align
from app.estimation.direction import best_fit
from app.estimation.identifiable import identifiable_model
from app.estimation.monte_carlo import block, drawn, prepared
from app.estimation.noise import NoiseModel
from app.numerics.adaptive_trials import TrialPlan, agrees, propagate

NOISE = NoiseModel((1.0, 1.0), (0.25, 0.25), 0.8, 1e-4)
FEW = TrialPlan(most_blocks=2)


@pytest.fixture(scope="module")
def fit(record):
    seen = align(record(33, rows=16)[0])
    model, _ = identifiable_model(
        seen.at.machine, seen.at.offset_mm, knot_spacing_mm=100.0
    )
    return best_fit(seen, model, seen.pose, NOISE)


def squareness(fit):
    """The three squarenesses as outputs, and their standard deviations."""
    model = fit.problem.machine_model
    outputs = np.array(
        [np.eye(model.size)[model.slices[s].start] for s in ("C0Y", "B0Z", "A0Z")]
    )
    covariance = fit.result.covariance[: model.size, : model.size]
    return outputs, np.sqrt(np.einsum("om,mn,on->o", outputs, covariance, outputs))


def test_trials_confirm_the_linear_uncertainty(fit):
    outputs, linear = squareness(fit)
    told = propagate(partial(block, prepared(fit, NOISE, outputs, FEW)), FEW)
    assert np.abs(told.mean) == pytest.approx(np.zeros(3), abs=0.03 * linear.max())
    assert told.sigma / linear == pytest.approx(1.0, abs=0.03)
    assert (told.high - told.low) / (2 * 1.96 * linear) == pytest.approx(1.0, abs=0.04)
    assert agrees(told, np.zeros(3), linear, FEW.digits).all()


def test_more_noise_than_was_weighed_shows_in_the_trials(fit):
    outputs, linear = squareness(fit)
    loud = NoiseModel((2.0, 2.0), (0.5, 0.5), 0.8, 1e-4)
    mismatched = replace(prepared(fit, NOISE, outputs, FEW), noise=loud)
    told = propagate(partial(block, mismatched), FEW)
    assert (told.sigma > 1.3 * linear).all()
    assert not agrees(told, np.zeros(3), linear, FEW.digits).any()


def test_slow_noise_remembers_for_as_long_as_it_is_said_to(fit):
    outputs, linear = squareness(fit)
    forgetful = NoiseModel((1.0, 1.0), (0.25, 0.25), 1e-3, 1e-4)
    quick = replace(prepared(fit, NOISE, outputs, FEW), noise=forgetful)
    remembered = drawn(prepared(fit, NOISE, outputs, FEW), 0, 4000).std(axis=1)
    assert (drawn(quick, 0, 4000).std(axis=1) < 0.985 * remembered).all()
    assert remembered == pytest.approx(linear, rel=0.05)


def test_who_shares_the_work_does_not_change_the_answer(fit):
    outputs, _ = squareness(fit)
    trials = prepared(fit, NOISE, outputs, TrialPlan(seed=7))
    alone = propagate(partial(block, trials), FEW)
    with ThreadPoolExecutor(3) as pool:
        shared = propagate(partial(block, trials), FEW, pool.map)
    np.testing.assert_array_equal(alone.sigma, shared.sigma)
    np.testing.assert_array_equal(alone.low, shared.low)
    assert alone.trials == shared.trials


def test_another_seed_or_block_is_another_draw(fit):
    outputs, _ = squareness(fit)
    one, other = (prepared(fit, NOISE, outputs, TrialPlan(seed=s)) for s in (1, 2))
    assert not np.allclose(drawn(one, 0, 10), drawn(other, 0, 10))
    assert not np.allclose(drawn(one, 0, 10), drawn(one, 1, 10))
    np.testing.assert_array_equal(drawn(one, 0, 10), drawn(one, 0, 600)[:, :10])
