"""Trials that know nothing of the algebra confirm its uncertainty."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from app.alignment.align import align
from app.estimation.direction import best_fit
from app.estimation.identifiable import identifiable_model
from app.estimation.monte_carlo import block, prepared, propagate, volume_by_trials
from app.estimation.noise import NoiseModel

NOISE = NoiseModel((1.0, 1.0), (0.25, 0.25), 0.8, 1e-4)


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
    told = propagate(prepared(fit, NOISE, outputs, 1), np.zeros((1, 3)), linear)
    assert told.settled
    assert told.disagreement < 0.05
    assert (told.high - told.low) / (2 * 1.96 * linear) == pytest.approx(1.0, abs=0.07)


def test_more_noise_than_was_weighed_shows_in_the_trials(fit):
    outputs, linear = squareness(fit)
    loud = NoiseModel((2.0, 2.0), (0.5, 0.5), 0.8, 1e-4)
    trials = prepared(fit, NOISE, outputs, 1)
    louder = prepared(fit, loud, outputs, 1)
    mismatched = type(trials)(**{**vars(trials), "noise": loud})
    louder_by = block(mismatched, 0).std(axis=1) / linear
    assert (louder_by > 1.25).all()  # shapes that only the prior knows are no louder
    assert (louder_by < 2.1).all()
    assert louder.weighted.shape == trials.weighted.shape


def test_who_shares_the_work_does_not_change_the_answer(fit):
    outputs, linear = squareness(fit)
    trials = prepared(fit, NOISE, outputs, 7)
    alone = propagate(trials, np.zeros((1, 3)), linear)
    with ThreadPoolExecutor(3) as pool:
        shared = propagate(trials, np.zeros((1, 3)), linear, pool.map)
    assert (alone.sigma == shared.sigma).all()
    assert alone.trials == shared.trials


def test_another_seed_is_another_draw(fit):
    outputs, _ = squareness(fit)
    first, second = (block(prepared(fit, NOISE, outputs, s), 0) for s in (1, 2))
    assert not np.allclose(first, second)


def test_the_volume_is_asked_at_its_corners_and_between(fit):
    told = volume_by_trials(fit, NOISE)
    assert told.position_mm.shape == (27, 3)
    assert told.sigma.shape == told.linear.shape == (81,)
    assert told.disagreement < 0.06
