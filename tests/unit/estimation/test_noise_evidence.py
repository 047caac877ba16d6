"""The evidence of the noise: its slope is the slope, its maximum is the truth."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.errors import Unidentifiable
from truepath.estimation.noise.noise_evidence import NoiseEvidence
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem import design_matrix, normal_equations
from truepath.estimation.problem.information import Information, compute_posterior
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import RunInformation, RunInput
from truepath.estimation.problem.prior import compute_evidence_cost, guess_prior
from truepath.kinematics.coarse_model import add_half_widths, build_coarse_model
from truepath.kinematics.identifiable import build_identifiable_model

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
