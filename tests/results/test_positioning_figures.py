"""Figures of ISO 230-2 from tables, as the standard defines them."""

import numpy as np
import pytest

from tests.results.conftest import ONE_TARGET, machine_with
from truepath.app.kinematics.coarse_model import build_run_models
from truepath.app.kinematics.estimated_model import EstimatedModel
from truepath.app.results.error_tables import (
    build_error_tables,
    compute_half_differences,
)
from truepath.app.results.positioning_figures import compute_positioning_figures


@pytest.fixture
def both_ways():
    """An estimate in which every error motion has a half difference."""
    machine = machine_with(ONE_TARGET)
    offset = np.array([ONE_TARGET[0].offset_mm])
    model = build_run_models(machine, [offset]).nested.constant
    rng = np.random.default_rng(3)
    size = np.array([1e-2 if p.unit == "mm" else 4e-5 for p in model.parameters])
    theta = size * rng.standard_normal(model.size)
    return EstimatedModel(model, theta, np.diag((0.1 * size) ** 2))


def test_the_figures_are_ranges_of_the_tables(both_ways):
    estimate = both_ways
    tables = build_error_tables(estimate)
    halves = {half.symbol: half for half in compute_half_differences(estimate)}
    found = {one.symbol: one for one in compute_positioning_figures(estimate)}
    assert set(found) == {"EXX", "EYY", "EZZ"}
    for symbol, one in found.items():
        mean, half = tables.table(symbol).value, halves[symbol].value
        both = np.concatenate([mean + half, mean - half])
        assert np.isclose(one.mean_range.value, np.ptp(mean))
        assert np.isclose(one.reversal.value, 2.0 * np.abs(half).max())
        assert np.isclose(one.systematic_range.value, np.ptp(both))
        assert one.mean_range.uncertainty > 0.0


def test_without_directions_there_is_no_reversal_value(construct):
    for one in compute_positioning_figures(construct()):
        assert one.reversal is None
        assert one.systematic_range == one.mean_range
