"""The evidence of the noise, and trials that know nothing of the algebra."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_evidence import NoiseEvidence
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem import design_matrix, normal_equations, prior
from truepath.estimation.problem.direction import select_fit
from truepath.estimation.problem.information import Information, compute_posterior
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import RunInformation, RunInput
from truepath.estimation.problem.prior import compute_evidence_cost, guess_prior
from truepath.estimation.solve.monte_carlo import (
    prepare_trials,
    run_block,
    sample_outputs,
)
from truepath.kinematics.coarse_model import (
    NestedModels,
    add_half_widths,
    build_coarse_model,
)
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.numerics.adaptive_trials import TrialPlan, agrees, propagate

NOISE = NoiseModel((1.0, 1.1), (0.3, 0.2, 0.2), 0.9, 2e-4)


@pytest.fixture(scope="module")
def seen(record_small):
    return align(record_small(3)[0])


@pytest.fixture(scope="module")
def rough(seen):
    return solve(seen)


def solve(seen):
    model, _ = build_identifiable_model(seen.at.machine, seen.at.offset_mm, intervals=6)
    about = design_matrix.linearise(seen, add_half_widths(model), seen.pose, NOISE)
    run = RunInformation(seen, about, normal_equations.compute_information(seen, about))
    prior, _ = guess_prior(about.machine_model).fit(run.own.eliminate())
    return run, prior


def evidence_of(run, prior, noise=NOISE):
    design = replace(run.linearisation, noise=noise).build(run.observations)
    columns = np.delete(design.rows, design.fixed, axis=2)
    known = Information.of_matrix(prior.precision_matrix(prior.model.size))
    return NoiseEvidence(design, columns, design.residual, known)


def moved(noise, x):
    *sizes, time = np.exp(x[:4])
    more = np.exp(x[4:])
    ou = tuple(np.multiply(noise.ou, sizes))
    noise = replace(noise, ou=ou, ou_time_s=noise.ou_time_s * time)
    if len(more) == 1:
        return replace(noise, along_sigma_mm=noise.along_sigma_mm * more[0])
    return replace(noise, place=tuple(noise.place * more)) if len(more) else noise


@pytest.mark.parametrize("kind", ["timed", "across", "places"])
def test_gradients_are_slopes_and_curvature_leads_downhill(kind, rough, record_small):
    run, prior = rough
    noise = NOISE if kind == "timed" else replace(NOISE, along_sigma_mm=np.inf)
    if kind == "places":
        run, prior = solve(align(record_small(3, "standstill")[0]))
        noise = replace(noise, place=(0.4, 0.3, 0.5))
    evidence = evidence_of(run, prior, noise)
    found = evidence.evaluate(noise).gradient
    for k, gradient in enumerate(found):
        step = 1e-3 * np.eye(len(found))[k]
        up, down = (evidence.evaluate(moved(noise, x)).cost for x in (step, -step))
        assert gradient == pytest.approx((up - down) / 2e-3, rel=1e-3, abs=0.05)
    here = evidence.evaluate(noise)
    assert np.linalg.eigvalsh(here.curvature).min() > 0.0
    step = np.clip(-np.linalg.solve(here.curvature, here.gradient), -1.0, 1.0)
    there = evidence.evaluate(moved(noise, 0.1 * step))
    assert there.cost < here.cost


def test_the_cost_is_that_of_the_evidence_of_the_problem(rough):
    run, prior = rough

    def difference(cost):
        return cost(NOISE) - cost(replace(NOISE, ou=(0.4, 0.3, 0.2), ou_time_s=1.5))

    def summed(noise):
        data = run.replace_noise(noise).own.eliminate()
        precision = prior.precision_matrix(prior.model.size)
        return compute_evidence_cost(data, prior, compute_posterior(data, precision))

    evidence = evidence_of(run, prior)
    found = difference(lambda noise: evidence.evaluate(noise).cost)
    assert found == pytest.approx(difference(summed), abs=1e-4)


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_the_fit_ends_at_the_same_noise_from_anywhere(seen, factor):
    start = guess_noise(seen, perpendicular_only=False)
    other = moved(start, np.log([factor, factor, factor, 1.0 / factor, factor]))
    model = build_coarse_model(seen.at.machine, [seen.at.offset_mm])
    runs = ([RunInput(seen, seen.pose, noise)] for noise in (start, other))
    best, again = (refine_runs(model, run)[0].noise for run in runs)
    assert np.log(again.ou) == pytest.approx(np.log(best.ou), abs=0.15)
    assert np.log(again.ou_time_s) == pytest.approx(np.log(best.ou_time_s), abs=0.3)


def test_what_was_taken_for_fast_is_lowered_where_nothing_shows_it(seen):
    start = replace(guess_noise(seen, perpendicular_only=False), fast=(2.0, 2.0))
    model = build_coarse_model(seen.at.machine, [seen.at.offset_mm])
    (found,) = refine_runs(model, [RunInput(seen, seen.pose, start)])
    assert found.noise.fast == (1.0, 1.0)


def test_one_place_tells_no_noise(record_small):
    seen = align(record_small(3, "standstill")[0])
    model = build_coarse_model(seen.at.machine, [seen.at.offset_mm])
    parts = seen, seen.select(np.array([0]))
    start = guess_noise(seen, perpendicular_only=False)
    with pytest.raises(Unidentifiable, match="add lines"):
        refine_runs(model, [RunInput(each, seen.pose, start) for each in parts])


OF_TRIALS = NoiseModel((1.0, 1.0), (0.25, 0.25, 0.25), 0.8, 1e-4)
FEW = TrialPlan(most_blocks=2)


@pytest.fixture(scope="module")
def fit(record_small):
    seen = align(record_small(33, rows=16)[0])
    model, _ = build_identifiable_model(seen.at.machine, seen.at.offset_mm, intervals=3)
    return select_fit(
        [normal_equations.RunInput(seen, seen.pose, OF_TRIALS)], NestedModels(model)
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
    quiet, louder = (spread_of(trials, noise, 500) for noise in (OF_TRIALS, loud))
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
