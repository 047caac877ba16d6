"""The uncertainty budget: parts of the covariance that add up to it."""

import numpy as np
import pytest
from tests.estimation.estimating import estimate
from tests.estimation.test_several_runs import recorded

from truepath.alignment.align import align
from truepath.estimation.problem.noise import cell_noise
from truepath.estimation.solve.budget import SOURCES, split_uncertainty
from truepath.estimation.solve.contributions import find_contributions
from truepath.kinematics.volumetric_map import compute_volumetric_gram


@pytest.fixture(scope="module")
def found():
    return estimate(align(recorded(1, rows=16)[0]), keep_fit=True)


@pytest.fixture(scope="module")
def at_points(record):
    return estimate(align(record(2, "standstill", rows=40)[0]), keep_fit=True)


def by_source(estimate):
    variance = split_uncertainty(estimate).variance_mm2
    return dict(zip(SOURCES, variance.sum(axis=1), strict=True))


def test_the_sources_add_up_to_the_stated_uncertainty(found):
    total = split_uncertainty(found).variance_mm2.sum()
    stated = find_contributions(found, (0,)).sigma_mm
    assert np.sqrt(total) == pytest.approx(stated, rel=1e-9)


def test_no_source_takes_uncertainty_away(found):
    parts = by_source(found)
    total = sum(parts.values())
    assert min(parts.values()) > -1e-4 * total
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
