"""Replies that look like points and are none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from truepath_drivers.tracker.geocom.codec import is_point, to_cartesian_mm
from truepath_drivers.tracker.t2sa.codec import parse_place


@pytest.mark.parametrize(
    ("hz", "v", "distance"),
    [
        (1.0, 90.0, 2.5),  # degrees
        (1.0, 100.0, 2.5),  # gon
        (57.3, 1.5, 2.5),
        (1.0, 1.5, 0.0),
        (1.0, 1.5, -2.5),
        (1.0, 1.5, math.inf),
        (math.nan, 1.5, 2.5),
    ],
)
def test_a_shot_in_other_units_or_without_a_distance_is_no_point(hz, v, distance):
    assert not is_point(hz, v, distance)
    assert is_point(1.0, 1.5, 2.5)


def test_a_reading_in_the_second_face_is_the_same_point():
    other = to_cartesian_mm(1.0 + math.pi, 2.0 * math.pi - 1.4, 2.5)
    np.testing.assert_allclose(other, to_cartesian_mm(1.0, 1.4, 2.5), atol=1e-9)
    assert is_point(1.0 + math.pi, 2.0 * math.pi - 1.4, 2.5)


@pytest.mark.parametrize("place", ["0.0,0.0,0.0", "1,5,2,5,3,5", "nan,1.0,2.0"])
def test_zeros_decimal_commas_and_words_are_no_place(place):
    assert parse_place(f"Single Point Measurement p result {place}", "p") is None
