"""Figures of ISO 230-2 from tables, as the standard defines them."""

import numpy as np

from truepath.answers.verification.places.positioning_figures import (
    HalfDifference,
    compute_positioning_figures,
)
from truepath.results.error_tables import build_error_tables


def test_the_figures_are_ranges_of_the_tables(estimate, rng):
    tables = build_error_tables(estimate)
    halves = {}
    for symbol in ("EXX", "EYY", "EZZ"):
        size = len(tables.table(symbol).value)
        at = tables.table(symbol).position_mm
        halves[symbol] = HalfDifference(at, rng.normal(size=size), np.full(size, 0.1))
    found = compute_positioning_figures(estimate, halves, {})
    assert [one.symbol for one in found] == ["EXX", "EYY", "EZZ"]
    for one in found:
        mean, half = tables.table(one.symbol).value, halves[one.symbol].value
        both = np.concatenate([mean + half, mean - half])
        assert np.isclose(one.mean_range.value, np.ptp(mean))
        assert np.isclose(one.reversal.value, 2.0 * np.abs(half).max())
        assert np.isclose(one.systematic_range.value, np.ptp(both))
        assert one.mean_range.uncertainty > 0.0


def test_a_reversal_value_is_as_uncertain_as_its_half_difference_says(estimate):
    at = build_error_tables(estimate).table("EXX").position_mm
    half = HalfDifference(at, np.full(len(at), 3.0), np.full(len(at), 0.1))
    (one, *_) = compute_positioning_figures(estimate, {"EXX": half}, {})
    assert one.reversal.value == 6.0
    assert np.isclose(one.reversal.uncertainty, 0.2, rtol=0.2)


def test_without_directions_there_is_no_reversal_value(estimate):
    for one in compute_positioning_figures(estimate, {}, {}):
        assert one.reversal is None
        assert one.systematic_range == one.mean_range


def test_what_nobody_measured_is_not_in_the_figures(estimate):
    """X measured from -60 to 140 of its -200 to 300 mm, between rows of its table."""
    low, high = -60.0, 140.0
    (motion,) = (m for m in estimate.model.error_motions if m.symbol == "EXX")
    own = estimate.theta[estimate.model.slices[motion.name]]
    value_um = 1e3 * motion.rows(np.linspace(low, high, 401)) @ own
    half_at = np.array([-200.0, low, high, 300.0])
    half = HalfDifference(half_at, np.array([90.0, 3.0, 3.0, 90.0]), np.zeros(4))
    (one, *others) = compute_positioning_figures(
        estimate, {"EXX": half}, {"X": (low, high)}
    )
    assert one.range == (low, high)
    assert np.isclose(one.mean_range.value, np.ptp(value_um), rtol=0.03)
    assert np.isclose(one.reversal.value, 6.0)
    assert [other.range for other in others] == [(10.0, 400.0), (0.0, 310.0)]
