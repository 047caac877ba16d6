"""The evidence of the noise: its slope is the slope, its maximum is the truth."""

from dataclasses import replace

import numpy as np
import pytest

from app.alignment.align import align
from app.estimation.direction import with_half_widths
from app.estimation.information import Information, information, posterior, without_rest
from app.estimation.noise import NoiseModel
from app.estimation.noise_evidence import NoiseEvidence
from app.estimation.noise_fit import first_noise, looked_at
from app.estimation.prior import evidence_cost, first_guess, fitted
from app.estimation.problem import pose_problem
from app.estimation.runs import Measured
from app.kinematics.identifiable import identifiable_model

NOISE = NoiseModel((1.0, 1.1), (0.3, 0.2), 0.9, 2e-4)


@pytest.fixture(scope="module")
def seen(record):
    return align(record(3)[0])


@pytest.fixture(scope="module")
def rough(seen):
    model, _ = identifiable_model(seen.at.machine, seen.at.offset_mm, intervals=6)
    problem = pose_problem(seen, with_half_widths(model), seen.pose)
    size = problem.machine_model.size
    data = without_rest(information(problem, NOISE), size)
    prior, _ = fitted(data, first_guess(problem.machine_model))
    return problem, prior


@pytest.fixture(scope="module", params=[2e-4, np.inf], ids=["timed", "across"])
def judged(request, rough):
    problem, prior = rough
    timing = bool(np.isfinite(request.param))
    noise = replace(NOISE, along_sigma_mm=request.param)
    return evidence_of(replace(problem, timing=timing), prior), noise


def evidence_of(problem, prior):
    part, size = problem.part(problem.seen), prior.model.size
    columns = np.delete(part.rows, part.data, axis=2)
    known = Information(prior.precision_matrix(size), np.zeros(size), 0.0, 0.0)
    return NoiseEvidence(part, columns, part.off, known)


def moved(noise, x):
    beam, across, time, *jitter = np.exp(x)
    along = noise.along_sigma_mm * jitter[0] if jitter else noise.along_sigma_mm
    ou = (noise.ou[0] * beam, noise.ou[1] * across)
    return NoiseModel(noise.white, ou, noise.ou_time_s * time, along)


def test_the_gradient_is_the_slope_of_the_cost(judged):
    evidence, noise = judged
    found = evidence.at(noise).gradient
    for k, gradient in enumerate(found):
        step = 1e-3 * np.eye(len(found))[k]
        up, down = (evidence.at(moved(noise, x)).cost for x in (step, -step))
        assert gradient == pytest.approx((up - down) / 2e-3, rel=1e-3, abs=0.05)


def test_the_curvature_leads_downhill(judged):
    evidence, noise = judged
    here = evidence.at(noise)
    assert np.linalg.eigvalsh(here.curvature).min() > 0.0
    step = -np.linalg.solve(here.curvature, here.gradient)
    there = evidence.at(moved(noise, 0.1 * step))
    assert there.cost < here.cost


def test_the_cost_is_that_of_the_evidence_of_the_problem(rough):
    problem, prior = rough

    def difference(cost):
        return cost(NOISE) - cost(replace(NOISE, ou=(0.4, 0.3), ou_time_s=1.5))

    def summed(noise):
        data = without_rest(information(problem, noise), problem.machine_model.size)
        precision = prior.precision_matrix(problem.machine_model.size)
        return evidence_cost(data, prior, posterior(data, precision))

    evidence = evidence_of(problem, prior)
    assert difference(lambda noise: evidence.at(noise).cost) == pytest.approx(
        difference(summed), abs=1e-4
    )


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_the_fit_ends_at_the_same_noise_from_anywhere(seen, factor):
    start = first_noise(seen, perpendicular_only=False)
    other = moved(start, np.log([factor, factor, 1.0 / factor, factor]))
    best, again = (
        looked_at(seen.at.machine, [Measured(seen, seen.pose, noise)])[0].noise
        for noise in (start, other)
    )
    assert np.log(again.ou) == pytest.approx(np.log(best.ou), abs=0.15)
    assert np.log(again.ou_time_s) == pytest.approx(np.log(best.ou_time_s), abs=0.3)
