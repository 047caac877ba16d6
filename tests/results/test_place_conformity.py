"""Decisions by ISO 14253-1: the uncertainty stands on neither side's account."""

import numpy as np
import pytest

from truepath.answers.verification.places.place_conformity import (
    compute_joint_factor,
    decide_places,
)

MANY = 1e6  # degrees of freedom: as good as known


@pytest.mark.parametrize(
    ("length_um", "decision"),
    [
        ([3.0, 7.9], "within"),
        ([3.0, 9.5], "undecided"),
        ([3.0, 11.0], "undecided"),
        ([3.0, 12.5], "outside"),
    ],
)
def test_only_what_is_clear_of_the_limit_by_its_uncertainty_is_decided(
    length_um, decision
):
    sigma_um = np.full(2, 0.9)  # expanded for two places: 2.0 µm
    found = decide_places(np.array(length_um), sigma_um, MANY, 10.0)
    assert found.conformity == decision
    assert found.worst == 1
    assert found.expanded_um == pytest.approx(2.01, abs=0.02)


def test_one_place_that_fails_fails_all():
    found = decide_places(
        np.array([1.0, 9.9, 20.0]), np.array([0.1, 5.0, 0.1]), MANY, 10.0
    )
    assert (found.conformity, found.worst) == ("outside", 2)


@pytest.mark.parametrize(
    ("length_um", "decision"), [(3.0, "undecided"), (20.0, "outside")]
)
def test_what_was_not_looked_at_everywhere_is_never_within(length_um, decision):
    length, sigma = np.array([length_um]), np.array([0.1])
    found = decide_places(length, sigma, MANY, 10.0, sees_all=False)
    assert found.conformity == decision


def test_so_many_places_lie_within_together_in_95_of_100_cases(rng):
    k = compute_joint_factor(30, MANY)
    within = np.abs(rng.standard_normal((20_000, 30))).max(axis=1) <= k
    assert within.mean() == pytest.approx(0.95, abs=0.005)


def test_a_noise_known_by_few_data_widens_what_is_said():
    assert compute_joint_factor(1, MANY) == pytest.approx(1.96, abs=0.01)
    assert compute_joint_factor(1, 8.0) == pytest.approx(2.306, abs=0.001)  # Student
