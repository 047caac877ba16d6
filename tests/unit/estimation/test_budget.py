"""The parts that uncertainty is made of add up to it; what each Run brought."""

import numpy as np
import pytest

from estimating import estimate
from truepath.alignment.align import align
from truepath.estimation.problem.noise import cell_noise
from truepath.estimation.solve.budget import SOURCES, split_uncertainty
from truepath.estimation.solve.contributions import find_contributions
from truepath.kinematics.volumetric_map import compute_volumetric_gram


@pytest.fixture(scope="module")
def found(record_small):
    """Estimate from two Runs of one machine, the first the longer one."""
    runs = [record_small(k, rows=n, machine_seed=71)[0] for k, n in ((1, 16), (2, 9))]
    seen = [align(run) for run in runs]
    return estimate(*seen, keep_fit=True)


@pytest.fixture(scope="module")
def at_points(record):
    return estimate(align(record(2, "standstill", rows=40)[0]), keep_fit=True)


def by_source(estimate):
    variance = split_uncertainty(estimate).variance_mm2
    return dict(zip(SOURCES, variance.sum(axis=1), strict=True))


def test_the_sources_add_up_to_the_uncertainty_of_the_map_and_none_takes_away(found):
    parts = by_source(found)
    total = sum(parts.values())
    stated = find_contributions(found, (0, 1)).sigma_mm
    assert np.sqrt(total) == pytest.approx(stated, rel=1e-9)
    gram = compute_volumetric_gram(found.model)
    assert stated == pytest.approx(np.sqrt(np.sum(gram * found.covariance)))
    assert min(parts.values()) > -1e-3 * total  # the step of a derivative
    for source in ("tracker", "air", "alignment", "model"):
        assert parts[source] > 1e-3 * total, source
    assert parts["thermal"] == parts["effects"] == 0.0


def test_the_part_of_the_tracker_is_its_noise_sent_through_the_solve(at_points):
    """The gain of the solve, written out over all cells, the pose held."""
    fit = at_points.fit
    (run,), size = fit.runs, fit.model.size
    design = run.linearisation.build(run.observations)
    J = design.columns[:, :, :size].reshape(-1, size)
    whitened = design.whiten(run.noise).apply(design.columns[:, :, :size])
    whitened = whitened.reshape(-1, size)
    prior = fit.prior.precision_matrix(size)
    gain = np.linalg.solve(J.T @ whitened + prior, whitened.T)
    precision, _ = cell_noise(run.observations, run.noise, design.travel)
    gain = gain.reshape(size, -1, 3)
    spread = np.einsum("pni,nij,qnj->pq", gain, np.linalg.inv(precision), gain)
    gram = compute_volumetric_gram(fit.model)
    assert by_source(at_points)["tracker"] == pytest.approx(
        np.sum(gram * spread), rel=1e-3
    )


def test_without_a_run_more_stays_unknown_and_more_without_the_longer(found):
    brought = find_contributions(found, (0, 1))
    without_long, without_short = brought.without_mm
    assert brought.sigma_mm < without_short < without_long
    # Parts of one Run have nothing to be held against.
    assert find_contributions(found, (0, 0)).without_mm == ()
