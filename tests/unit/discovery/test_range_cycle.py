"""A cyclic error of the tracker's distance meter is named so, and nothing else is."""

import numpy as np
import pytest

from truepath.discovery.discover import discover
from truepath.discovery.name_trial import LIKELY
from truepath_simulators.hidden import drives, setup
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture
def search(record):
    def searched(seed, *hidden):
        setting = Setting(hidden=hidden)
        return discover([record(seed, rows=40, travel_mm=150.0, setting=setting)[0]])

    return searched


@pytest.mark.parametrize("seed", [2, 4, 6])
def test_a_cycle_of_the_range_is_named_with_its_period_and_size(search, seed):
    rng = np.random.default_rng(seed)
    amplitude_um = rng.uniform(1.5, 4.0)
    period_mm = np.exp(rng.uniform(np.log(5.0), np.log(120.0)))
    hidden = setup.RangeCycle(period_mm, amplitude_um, rng.uniform(0.0, 2.0 * np.pi))
    (found,) = search(seed, hidden).findings
    assert found.candidate.family == "range-cycle"
    for name in ("period_mm", "amplitude_um"):
        said, true = found.parameters[name], getattr(hidden, name)
        assert abs(said.value - true) < 3.0 * said.uncertainty
        assert said.uncertainty < 0.1 * true


def test_a_longer_cycle_gets_no_other_cause_and_a_vibration_is_still_one(search):
    found = search(1, setup.RangeCycle(245.0, 2.8, 0.9))
    causes = [one for one in found.findings if one.structure is None]
    assert {one.candidate.family for one in causes} <= {"range-cycle"}
    (found,) = search(1, drives.Vibration("Y", 12.0, 2.0)).findings
    assert found.candidate.label == "vibration Y"
    assert (found.grade, found.is_imitated) == (LIKELY, True)  # or the tracker's head
