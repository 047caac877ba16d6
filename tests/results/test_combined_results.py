"""Results of one machine side by side: lost motion is what all of them state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.temperature.combined_results import combine_results
from truepath.files.earlier.result_file import CalibrationResult

KINDS = {  # tables, their uncertainties, and the name of one of them
    "half_difference_um": ("half_difference_u_um", "X"),
    "half_turn_urad": ("half_turn_u_urad", "C"),
    "half_across": ("half_across_u", "EYX"),
}
AT, OWN = np.array([0.0, 100.0]), 0.5


@pytest.fixture
def results(estimate):
    """Three results whose lost motion of every kind is 1, 2 and 3."""
    first = CalibrationResult(estimate.model, estimate.theta, estimate.covariance)
    return [state(first, half) for half in (1.0, 2.0, 3.0)]


def state(result, half):
    tables = {key: {name: (AT, np.full(2, half))} for key, (_, name) in KINDS.items()}
    sigmas = {sigma: {name: np.full(2, OWN)} for sigma, name in KINDS.values()}
    return replace(result, **tables, **sigmas)


@pytest.mark.parametrize("kind", KINDS)
def test_lost_motion_is_the_mean_and_as_uncertain_as_results_scatter(results, kind):
    joined = combine_results(results).result
    of_sigma, name = KINDS[kind]
    at, value = getattr(joined, kind)[name]
    np.testing.assert_array_equal(at, AT)
    np.testing.assert_allclose(value, 2.0)
    expected = np.sqrt((OWN**2 + 1.0) / 3.0)  # 1 is the scatter of 1, 2 and 3
    np.testing.assert_allclose(getattr(joined, of_sigma)[name], expected)


@pytest.mark.parametrize("kind", KINDS)
def test_lost_motion_that_one_result_lacks_is_left_out_and_said(results, kind):
    lacking = replace(results[1], **{kind: {}, KINDS[kind][0]: {}})
    combined = combine_results([results[0], lacking, results[2]])
    assert getattr(combined.result, kind) == {}
    ((_, words),) = combined.left_out
    assert words.rstrip(".").endswith(f" {KINDS[kind][1]}")
