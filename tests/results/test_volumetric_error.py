"""What the errors do at the tool point, before and after compensation."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.results.prediction import predict
from truepath.results.volumetric_error import compute_volumetric_error


@pytest.fixture
def seen(estimate):
    return compute_volumetric_error(estimate)


def test_the_grid_spans_the_travel(estimate, seen):
    axes = estimate.model.machine.linear_axes
    assert len(seen.position_mm) == 729
    assert seen.position_mm.min(axis=0).tolist() == [a.low for a in axes]
    assert seen.position_mm.max(axis=0).tolist() == [a.high for a in axes]


def test_errors_and_uncertainties_are_those_of_predictions(seen, loaded):
    predicted = predict(loaded, seen.position_mm)
    assert seen.error_um == pytest.approx(predicted.error_um)
    assert seen.uncertainty_um == pytest.approx(predicted.uncertainty_um)


def test_before_is_the_length_of_the_map(seen):
    length = np.linalg.norm(seen.error_um, axis=1)
    assert seen.before.mean.value_um == pytest.approx(length.mean())
    assert seen.before.p95.value_um == pytest.approx(np.quantile(length, 0.95))
    assert seen.before.largest.value_um == pytest.approx(length.max())


def test_after_is_what_the_stated_uncertainty_leaves(seen):
    """The mean square length is the mean trace of the covariance at the points."""
    expected = np.mean(np.sum(seen.uncertainty_um**2, axis=1))
    quantiles = seen.after_lengths_um
    middle = 0.5 * (quantiles[1:] + quantiles[:-1])
    assert np.mean(middle**2) == pytest.approx(expected, rel=0.1)
    assert (np.diff(quantiles) >= 0).all()
    after = seen.after
    assert after.mean.value_um < after.p95.value_um < after.largest.value_um


def test_a_certain_estimate_leaves_nothing(estimate):
    covariance = np.zeros_like(estimate.covariance)
    certain = compute_volumetric_error(replace(estimate, covariance=covariance))
    assert certain.after.largest.value_um == 0.0
    assert certain.before.mean.uncertainty_um == pytest.approx(0.0, abs=1e-9)


def test_half_the_uncertainty_leaves_half(estimate, seen):
    covariance = estimate.covariance / 4
    halved = compute_volumetric_error(replace(estimate, covariance=covariance))
    assert halved.after.mean.value_um == pytest.approx(seen.after.mean.value_um / 2)
    assert halved.before.mean.value_um == pytest.approx(seen.before.mean.value_um)


def test_the_scale_of_all_lengths_is_in_the_uncertainty_of_the_volumetric_error(
    estimate,
):
    ppm, certain = 40.0, replace(estimate, covariance=1e-6 * estimate.covariance)
    stated = compute_volumetric_error(certain, ppm).before.mean
    without = compute_volumetric_error(certain).before.mean
    low, high = (
        np.array([getattr(a, end) for a in estimate.model.machine.axes])
        for end in ("low", "high")
    )
    place = compute_volumetric_error(certain)
    away_mm = place.position_mm - (low + high) / 2.0
    rng = np.random.default_rng(4)
    scale = 1e-3 * ppm * rng.standard_normal(2000)
    true = [
        np.linalg.norm(place.error_um + one * away_mm, axis=1).mean() for one in scale
    ]
    off = np.abs(np.array(true) - stated.value_um)
    assert np.mean(off <= 2.0 * stated.uncertainty_um) >= 0.94
    assert np.mean(off <= 2.0 * without.uncertainty_um) < 0.1
    assert stated.value_um == without.value_um


def test_what_compensation_leaves_is_as_uncertain_as_the_scale_of_its_lengths(
    estimate,
):
    certain = replace(estimate, covariance=1e-12 * estimate.covariance)
    left = compute_volumetric_error(certain, 1.0).after.largest
    # Nothing but the scale is unknown: the farthest corner is off by 1 ppm of its way.
    size = np.array([a.high - a.low for a in estimate.model.machine.axes])
    corner_um = 1e-3 * np.linalg.norm(size) / 2.0
    assert left.scale_uncertainty_um == pytest.approx(corner_um, rel=1e-3)
    assert left.uncertainty_um == pytest.approx(corner_um, rel=1e-3)
