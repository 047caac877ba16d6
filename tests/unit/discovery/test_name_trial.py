"""A name holds against free forms, or stays possible; the structure is described."""

import pytest

from truepath.answers.discovery.discovery_json import discovery_json
from truepath.discovery.discover import discover
from truepath_simulators.hidden.setup import SettlingStand
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture(scope="module")
def settling(record):
    """A Run during which the tracker's stand leans, in no shape of the catalogue."""
    setting = Setting(hidden=(SettlingStand((20.0, -14.0), 15.0),))
    return discovery_json(
        discover([record(11, rows=20, travel_mm=150.0, setting=setting)[0]])
    )


def test_a_cause_that_nobody_listed_gets_no_name(settling):
    assert settling["effects"] == []
    assert any("t" in one["depends_on"] for one in settling["unnamed"])
    assert all(one["grade"] == "possible" for one in settling["possible"])
