"""The volumetric error that counts every place in both directions of travel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from truepath.compensation.account.remaining_error import find_remaining
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.unmeasured import find_measured_ranges
from truepath.kinematics.effects.backlash import make_half_width
from truepath.results.error_tables import compute_half_differences
from truepath.results.volumetric_error import (
    compute_both_directions,
    compute_volumetric_error,
)

HALF_MM, SIGMA_MM = 0.015, 2e-4


@pytest.fixture
def losing(estimate):
    """The estimate with 15 µm of half difference in the positioning of X."""
    effect = make_half_width("EXX", estimate.model.machine.linear("X"))
    size = estimate.model.size
    covariance = np.zeros((size + 1, size + 1))
    covariance[:-1, :-1], covariance[-1, -1] = estimate.covariance, SIGMA_MM**2
    return replace(
        estimate,
        model=estimate.model.with_effects(effect),
        theta=np.append(estimate.theta, HALF_MM),
        covariance=covariance,
    )


def test_it_is_what_the_account_of_files_states_before(losing, loaded):
    (half,) = compute_half_differences(losing)
    result = replace(loaded, half_difference_um={"X": (half.position_mm, half.value)})
    measured = find_measured_ranges(result.machine, {}, None)
    account = find_remaining(map_errors(result), measured).state_map()
    both = compute_both_directions(losing)
    expanded = 2.0 * both.mean.uncertainty_um
    assert both.mean.value_um == pytest.approx(account["mean"], abs=expanded)
    assert both.largest.value_um == pytest.approx(account["largest"], rel=0.01)


def test_lost_motion_adds_to_the_map_of_the_mean(losing, estimate):
    """The mean of both directions does not see it: squares of both add up."""
    mean = compute_volumetric_error(losing).before.mean.value_um
    assert mean == pytest.approx(
        compute_volumetric_error(estimate).before.mean.value_um
    )
    both = compute_both_directions(losing).mean.value_um
    assert both > max(mean, 1e3 * HALF_MM)
    assert both == pytest.approx(np.hypot(mean, 1e3 * HALF_MM), rel=0.1)


def test_without_lost_motion_there_is_no_such_figure(estimate):
    assert compute_both_directions(estimate) is None
