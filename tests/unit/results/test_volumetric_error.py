"""What the errors do at the tool point, before and after compensation."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.compensation.account.residual_error import compute_residual_error
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.unmeasured_range import find_measured_ranges
from truepath.kinematics.effects.backlash import make_half_width
from truepath.results.error_tables import compute_half_differences
from truepath.results.prediction import predict
from truepath.results.result_assessment import assess_gain
from truepath.results.volumetric_error import (
    compute_both_directions,
    compute_volumetric_error,
)

HALF_MM, SIGMA_MM = 0.015, 2e-4


@pytest.fixture(scope="module")
def seen(estimate):
    return compute_volumetric_error(estimate)


def test_the_map_of_the_travel_is_that_of_predictions(estimate, seen, loaded):
    axes = estimate.model.machine.linear_axes
    assert len(seen.position_mm) == 729
    assert seen.position_mm.min(axis=0).tolist() == [a.low for a in axes]
    assert seen.position_mm.max(axis=0).tolist() == [a.high for a in axes]
    predicted = predict(loaded, seen.position_mm)
    assert seen.error_um == pytest.approx(predicted.error_um)
    assert seen.uncertainty_um == pytest.approx(predicted.uncertainty_um)
    length = np.linalg.norm(seen.error_um, axis=1)
    assert seen.before.mean.value_um == pytest.approx(length.mean())
    assert seen.before.p95.value_um == pytest.approx(np.quantile(length, 0.95))
    assert seen.before.largest.value_um == pytest.approx(length.max())


def test_after_is_what_the_stated_uncertainty_leaves(estimate, seen):
    """The mean square length is the mean trace of the covariance at the points."""
    expected = np.mean(np.sum(seen.uncertainty_um**2, axis=1))
    quantiles = seen.after_lengths_um
    middle = 0.5 * (quantiles[1:] + quantiles[:-1])
    assert np.mean(middle**2) == pytest.approx(expected, rel=0.1)
    assert (np.diff(quantiles) >= 0).all()
    after = seen.after
    assert after.mean.value_um < after.p95.value_um < after.largest.value_um
    halved, certain = (
        compute_volumetric_error(replace(estimate, covariance=k * estimate.covariance))
        for k in (0.25, 0.0)
    )
    assert halved.after.mean.value_um == pytest.approx(after.mean.value_um / 2)
    assert halved.before.mean.value_um == pytest.approx(seen.before.mean.value_um)
    assert certain.after.largest.value_um == 0.0
    assert certain.before.mean.uncertainty_um == pytest.approx(0.0, abs=1e-9)


def test_the_scale_of_all_lengths_is_in_the_uncertainty_of_the_volumetric_error(
    estimate,
):
    ppm, certain = 40.0, replace(estimate, covariance=1e-6 * estimate.covariance)
    scaled = certain.widen_by_scale(1e-6 * ppm)
    stated = compute_volumetric_error(scaled, ppm).before.mean
    place = compute_volumetric_error(certain)
    without = place.before.mean
    low, high = np.array([(a.low, a.high) for a in estimate.model.machine.axes]).T
    away_mm = place.position_mm - (low + high) / 2.0
    scale = 1e-3 * ppm * np.random.default_rng(4).standard_normal(2000)
    drawn = (place.error_um + one * away_mm for one in scale)
    true = [np.linalg.norm(one, axis=1).mean() for one in drawn]
    off = np.abs(np.array(true) - stated.value_um)
    assert np.mean(off <= 2.0 * stated.uncertainty_um) >= 0.94
    assert np.mean(off <= 2.0 * without.uncertainty_um) < 0.1
    assert stated.value_um == without.value_um
    # Nothing but the scale is unknown: the farthest corner is off by 1 ppm of its way.
    surest = replace(estimate, covariance=1e-12 * estimate.covariance)
    left = compute_volumetric_error(surest.widen_by_scale(1e-6), 1.0).after.largest
    corner_um = 1e-3 * np.linalg.norm(high - low) / 2.0
    most_um = left.value_um + 2.0 * left.uncertainty_um
    assert most_um == pytest.approx(2.0 * corner_um, rel=0.1)
    assert left.scale_uncertainty_um == pytest.approx(left.uncertainty_um, rel=0.1)


def test_lost_motion_adds_to_the_map_of_the_mean_as_the_account_of_files_says(
    estimate, seen, loaded
):
    """The mean of both directions does not see it: squares of both add up."""
    assert compute_both_directions(estimate) is None
    effect = make_half_width("EXX", estimate.model.machine.linear("X"))
    covariance = np.pad(estimate.covariance, (0, 1))
    covariance[-1, -1] = SIGMA_MM**2
    model, theta = estimate.model.with_effects(effect), [*estimate.theta, HALF_MM]
    losing = replace(
        estimate, model=model, theta=np.array(theta), covariance=covariance
    )
    mean = compute_volumetric_error(losing).before.mean.value_um
    assert mean == pytest.approx(seen.before.mean.value_um)
    both = compute_both_directions(losing)
    assert both.mean.value_um > max(mean, 1e3 * HALF_MM)
    assert both.mean.value_um == pytest.approx(np.hypot(mean, 1e3 * HALF_MM), rel=0.1)
    (half,) = compute_half_differences(losing)
    result = replace(loaded, half_difference_um={"X": (half.position_mm, half.value)})
    measured = find_measured_ranges(result.machine, {}, None)
    account = compute_residual_error(map_errors(result), measured).summarise_map()
    expanded = 2.0 * both.mean.uncertainty_um
    assert both.mean.value_um == pytest.approx(account["mean"], abs=expanded)
    assert both.largest.value_um == pytest.approx(account["largest"], rel=0.01)


@pytest.mark.parametrize(
    ("share", "state"),
    [(0.1, "usable"), (0.4, "doubtful"), (0.7, "doubtful"), (1.2, "not-usable")],
)
def test_a_result_that_would_hardly_make_the_machine_better_says_so(seen, share, state):
    left_um = share * seen.before.mean.value_um
    mean = replace(seen.after.mean, value_um=left_um)
    verdict = assess_gain(replace(seen, after=replace(seen.after, mean=mean)))
    assert verdict.state == state
    assert [reason.kind for reason in verdict.reasons] == (
        [] if state == "usable" else ["little-gained"]
    )
