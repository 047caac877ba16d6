"""A name holds against free forms, or stays possible; the structure is described."""

import pytest

from app.discovery.discover import discover
from app.discovery.name_trial import CERTAIN
from app.results.discovery_json import discovery_json
from simulators.hidden.settling_stand import SettlingStand
from simulators.hidden.setup_step import SetupStep
from simulators.synthetic import Setting


@pytest.fixture(scope="module")
def settling(record):
    """A Run during which the tracker's stand leans, in no shape of the catalogue."""
    setting = Setting(hidden=(SettlingStand((14.0, -9.0), 25.0),))
    return discovery_json(discover([record(11, rows=40, setting=setting)[0]]))


def test_a_cause_that_nobody_listed_gets_no_name(settling):
    assert settling["effects"] == []
    assert any("t" in one["depends_on"] for one in settling["unnamed"])
    assert all(one["grade"] == "possible" for one in settling["possible"])


def test_a_shape_that_no_free_form_reaches_is_certain(record):
    setting = Setting(hidden=(SetupStep(40.0, (4.0, -3.0, 0.0)),))
    found = discover([record(11, rows=60, setting=setting)[0]])
    (effect,) = discovery_json(found)["effects"]
    assert effect["name"] == "setup-step"
    assert effect["grade"] == CERTAIN
    assert found.possible == ()
