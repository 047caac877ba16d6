"""What each of several Runs brought."""

import numpy as np
import pytest
from tests.estimation.estimating import estimate
from tests.estimation.test_several_runs import recorded

from truepath.alignment.align import align
from truepath.estimation.solve.contributions import find_contributions
from truepath.kinematics.volumetric_map import compute_volumetric_gram


@pytest.fixture(scope="module")
def found():
    seen = [align(recorded(seed, rows=rows)[0]) for seed, rows in ((1, 16), (2, 9))]
    return estimate(*seen, keep_fit=True)


def test_without_a_run_more_stays_unknown_and_more_without_the_longer(found):
    brought = find_contributions(found, (0, 1))
    without_long, without_short = brought.without_mm
    assert brought.sigma_mm < without_short < without_long


def test_the_uncertainty_is_that_of_the_map(found):
    gram = compute_volumetric_gram(found.model)
    stated = np.sqrt(np.sum(gram * found.covariance))
    assert find_contributions(found, (0, 1)).sigma_mm == pytest.approx(stated)


def test_parts_of_one_run_have_nothing_to_be_held_against(found):
    assert find_contributions(found, (0, 0)).without_mm == ()
