"""Trials that know nothing of the algebra confirm its uncertainty."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.estimation.problem import normal_equations, prior
from truepath.estimation.problem.direction import select_fit
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.solve.monte_carlo import (
    prepare_trials,
    run_block,
    sample_outputs,
)
from truepath.kinematics.coarse_model import NestedModels
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.numerics.adaptive_trials import TrialPlan, agrees, propagate

NOISE = NoiseModel((1.0, 1.0), (0.25, 0.25, 0.25), 0.8, 1e-4)
FEW = TrialPlan(most_blocks=2)


@pytest.fixture(scope="module")
def fit(record_small):
    seen = align(record_small(33, rows=16)[0])
    model, _ = build_identifiable_model(seen.at.machine, seen.at.offset_mm, intervals=3)
    return select_fit(
        [normal_equations.RunInput(seen, seen.pose, NOISE)], NestedModels(model)
    )


@pytest.fixture(scope="module")
def trials(fit):
    return prepare_trials(fit, squareness(fit)[0], FEW)


def under(trials, noise):
    return replace(trials, runs=tuple(replace(r, noise=noise) for r in trials.runs))


def squareness(fit):
    model = fit.model
    rows = [model.slices[symbol].start for symbol in ("C0Y", "B0Z", "A0Z")]
    outputs = np.eye(model.size)[rows]
    covariance = prior.widen_by_unknown_precision(fit.prior, fit.result).covariance
    return outputs, np.sqrt(np.einsum("om,mn,on->o", outputs, covariance, outputs))


def spread_of(trials, noise, count):
    silent = tuple(replace(x, root=0.0 * x.root, log_sigma=0.0) for x in trials.prior)
    alone = replace(under(trials, noise), prior=silent)
    return sample_outputs(alone, 0, count).std(axis=1)


def test_trials_confirm_linear_uncertainty_with_precisions_known_or_not(fit, trials):
    outputs, linear = squareness(fit)
    told = propagate(partial(run_block, trials), FEW)
    assert (np.abs(told.mean) < 0.2 * linear).all()
    assert told.sigma / linear == pytest.approx(1.0, abs=0.05)
    assert (told.high - told.low) / (2 * 1.96 * linear) == pytest.approx(1.0, abs=0.08)
    # Where they are known, the covariance of the solve is left.
    known = tuple(replace(one, log_sigma=0.0) for one in trials.prior)
    covariance = fit.result.covariance
    linear = np.sqrt(np.einsum("om,mn,on->o", outputs, covariance, outputs))
    told = propagate(partial(run_block, replace(trials, prior=known)), FEW)
    assert told.sigma / linear == pytest.approx(1.0, abs=0.02)
    assert agrees(told, np.zeros(3), linear, FEW.digits).all()


def test_more_noise_than_was_weighed_shows_in_the_trials(fit, trials):
    _, linear = squareness(fit)
    loud = NoiseModel((2.0, 2.0), (0.5, 0.5, 0.5), 0.8, 2e-4)
    quiet, louder = (spread_of(trials, noise, 500) for noise in (NOISE, loud))
    assert louder / quiet == pytest.approx(2.0, rel=1e-3)
    told = propagate(partial(run_block, under(trials, loud)), FEW)
    assert (told.sigma > 1.2 * linear).all()


def test_slow_noise_remembers_for_as_long_as_it_is_said_to(trials):
    ou = NoiseModel((1e-6, 1e-6), (0.25, 0.25, 0.25), 0.8, 1e-9)
    forgetful = replace(ou, ou_time_s=1e-3)
    remembered, quick = (spread_of(trials, noise, 4000) for noise in (ou, forgetful))
    assert (quick < 0.96 * remembered).all()


def test_each_block_is_a_draw_of_its_own_whoever_computes_it(trials, fit):
    def draw(number):
        return sample_outputs(trials, number, 500)

    with ThreadPoolExecutor(3) as pool:
        shared = list(pool.map(draw, range(3)))
    np.testing.assert_array_equal([draw(number) for number in range(3)], shared)
    other = prepare_trials(fit, squareness(fit)[0], TrialPlan(seed=2))
    drawn = sample_outputs(trials, 0, 10)
    assert not np.allclose(drawn, sample_outputs(other, 0, 10))
    assert not np.allclose(drawn, sample_outputs(trials, 1, 10))
    np.testing.assert_array_equal(drawn, sample_outputs(trials, 0, 600)[:, :10])
