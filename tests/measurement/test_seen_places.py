"""Where a target should be, from where it was seen."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.measurement.target.target_search import ExpectedPlace, SeenPlaces
from truepath.numerics.rigid import RigidTransform, build_rotation

TO_TRACKER = RigidTransform(
    build_rotation(np.array([0.02, -0.03, 1.1])), np.array([1500.0, 600.0, 80.0])
)


def see(position: np.ndarray) -> np.ndarray:
    return TO_TRACKER.apply(position[None])[0]


def name_axes(position: np.ndarray) -> dict[str, float]:
    return dict(zip("XYZ", position.tolist(), strict=True))


def remember(places: SeenPlaces, position: np.ndarray, *, stands: bool) -> None:
    shift = 0.0 if stands else 10.0  # axes and place are not of one moment
    place = see(position) + shift
    places.remember(name_axes(position), "", place, stands=stands)


def foretell(places: SeenPlaces, position: np.ndarray) -> ExpectedPlace:
    expected = places.foretell(name_axes(position), "")
    assert expected is not None
    return expected


def test_nothing_is_foretold_of_a_target_that_was_never_seen(mill):
    assert SeenPlaces(mill).foretell(name_axes(np.zeros(3)), "") is None


def test_a_few_standstills_tell_where_it_is_anywhere(mill, rng):
    places = SeenPlaces(mill)
    for position in rng.uniform(0.0, 300.0, (6, 3)):
        remember(places, position, stands=True)
        remember(places, position + 20.0, stands=False)
    there = np.array([400.0, -100.0, 350.0])
    expected = foretell(places, there)
    np.testing.assert_allclose(expected.place_mm, see(there), atol=1e-6)
    x, y, z = see(there)
    direction = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    assert expected.direction_rad == pytest.approx(direction)


def test_lines_tell_roughly_where_it_is(mill, rng):
    places = SeenPlaces(mill)
    for position in rng.uniform(0.0, 300.0, (6, 3)):
        remember(places, position, stands=False)
    there = np.array([400.0, -100.0, 350.0])
    expected = foretell(places, there)
    assert np.linalg.norm(expected.place_mm - see(there)) < expected.reach_mm
    assert expected.basis == "as the lines have it"


def test_one_line_tells_where_it_was_seen_last_and_how_far_it_may_be(mill):
    places = SeenPlaces(mill)
    for x in (0.0, 40.0, 80.0, 120.0, 160.0):
        remember(places, np.array([x, x, 0.0]), stands=True)
    there = np.array([160.0, 160.0, 70.0])
    expected = foretell(places, there)
    assert expected.basis == "where it was seen last"
    np.testing.assert_allclose(expected.place_mm, see(np.array([160.0, 160.0, 0.0])))
    assert expected.reach_mm > 70.0
