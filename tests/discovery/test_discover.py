"""What a Run's model lacks is named, and nothing where nothing is missing."""

import pytest

from app.discovery.discover import discover
from app.discovery.name_trial import CERTAIN
from app.results.discovery_json import discovery_json
from simulators.hidden.setup_step import SetupStep
from simulators.synthetic import Setting


@pytest.fixture(scope="module")
def knocked(record):
    """A Run in the middle of which the tracker's mount is knocked by 5 µm."""
    setting = Setting(hidden=(SetupStep(40.0, (4.0, -3.0, 0.0)),))
    return discover([record(11, rows=60, setting=setting)[0]])


@pytest.fixture(scope="module")
def clean(record):
    return discover([record(11, rows=60)[0]])


def test_nothing_is_found_where_nothing_is_missing(clean):
    assert clean.findings == ()
    assert clean.gap.after_um == pytest.approx(clean.gap.before_um)
    assert clean.gap.after_um < 1.05 * clean.gap.noise_floor_um


def test_a_knock_is_named_with_its_moment_and_size(knocked):
    (found,) = knocked.findings
    assert found.candidate.family == "setup-step"
    assert not found.alternatives
    assert found.grade == CERTAIN
    assert knocked.possible == ()
    said = found.parameters
    begin = knocked.aligned[0].run.tracker.device_time_s[0]
    assert abs(said["t_s"].value - begin - 40.0) < 0.1
    truth = {"step_um[x]": 4.0, "step_um[y]": -3.0, "step_um[z]": 0.0}
    for name, value in truth.items():
        assert abs(said[name].value - value) < 3.0 * said[name].uncertainty
        assert said[name].uncertainty < 0.5


def test_the_gap_on_lines_not_seen_falls_to_the_noise(knocked):
    gap = knocked.gap
    open_before = gap.before_um - gap.noise_floor_um
    assert open_before > 2.0 * (gap.after_um - gap.noise_floor_um)
    assert gap.after_um < 1.05 * gap.noise_floor_um


def test_the_disagreement_is_located_by_line_and_time(knocked):
    (shown,) = knocked.residuals
    shares = shown.before.shares
    assert list(shares)[:2] == ["line", "time"]
    assert shares["line"] > 2.0 * shown.after.shares["line"]


def test_the_file_states_what_the_contract_asks(knocked, clean):
    content = discovery_json(knocked)
    assert content["schema"] == "discovery/1"
    (effect,) = content["effects"]
    assert effect["name"] == "setup-step"
    assert set(effect["parameters"]["t_s"]) == {"value", "uncertainty"}
    assert len(effect["parameters"]["step_um"]["uncertainty"]) == 3
    assert effect["indistinguishable_from"] == []
    stated = {"unit", "before", "after", "noise_floor", "expected", "on"}
    assert set(content["gap"]) == stated
    assert content["gap"]["noise_floor"] < content["gap"]["expected"]
    assert content["unnamed"] == []
    worst = content["where"]
    assert [s["rms_um"] for s in worst] == sorted(s["rms_um"] for s in worst)[::-1]
    assert discovery_json(clean)["effects"] == []
