"""Live tables of a machine with rotary axes: over degrees, with where the axes are."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.estimation.live.live_estimate import LiveEstimate
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.running.live_process import estimate_json
from truepath.kinematics.effects.location_error import AxisLocation
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_simulators.scenario import load_machine


@pytest.fixture
def now(rng):
    """An estimate of a five-axis machine, every number of it different."""
    machine = machine_from_json(load_machine("head-table"))
    offsets = {t.name: np.array([t.offset_mm]) for t in machine.targets}
    model, _ = build_identifiable_model(machine, np.concatenate(list(offsets.values())))
    theta = rng.normal(scale=1e-3, size=model.size)
    covariance = np.diag(rng.uniform(1e-5, 1e-4, model.size) ** 2)
    return LiveEstimate(model, theta, covariance, 2e-3, 12, 480, 61.5)


def test_tables_of_a_rotary_axis_are_over_degrees(now):
    tables = estimate_json(now)["error_tables"]
    for symbol, table in tables.items():
        place = "position_deg" if symbol[2] in "ABC" else "position_mm"
        value = "um" if symbol[1] in "XYZ" else "urad"
        assert set(table) == {place, f"value_{value}", f"uncertainty_{value}"}
    turning = [table for symbol, table in tables.items() if symbol[2] in "ABC"]
    assert any(max(table["position_deg"]) == 360.0 for table in turning)


def test_it_says_where_the_rotary_axes_are(now):
    places = estimate_json(now)["axis_location"]
    effects = [e for e in now.model.effects if isinstance(e, AxisLocation)]
    assert {e.symbol for e in effects} == set(places)
    for effect in effects:
        part = now.model.slices[effect.name]
        value, sigma = now.theta[part][0], np.sqrt(now.covariance[part, part][0, 0])
        is_shift = effect.symbol[0] in "XYZ"
        unit, scale = ("um", 1e3) if is_shift else ("urad", 1e6)
        entry = places[effect.symbol]
        assert entry[f"value_{unit}"] == pytest.approx(scale * value, abs=1e-3)
        assert entry[f"uncertainty_{unit}"] == pytest.approx(scale * sigma, abs=1e-3)
