"""What a Run's model lacks is named, and nothing where nothing is missing."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.discovery.discovery_json import discovery_json, effect_json
from truepath.discovery.discover import discover
from truepath.discovery.findings import find_share
from truepath.discovery.name_trial import CERTAIN
from truepath.discovery.open_questions import design_discrimination
from truepath_simulators.hidden.setup import SetupStep, TableDrift
from truepath_simulators.worlds.synthetic import Setting

KNOCK_S, STEP_UM = 20.0, (4.0, -3.0, 0.0)
KNOCK = SetupStep(KNOCK_S, STEP_UM)


@pytest.fixture(scope="module")
def drive(record):
    """Find what lacks in a Run of a machine that hides effects."""

    def driven(*hidden):
        setting = Setting(hidden=hidden)
        return discover([record(11, rows=40, travel_mm=150.0, setting=setting)[0]])

    return driven


@pytest.fixture(scope="module")
def knocked(drive):
    """A Run in the middle of which the tracker's mount is knocked by 5 µm."""
    return drive(KNOCK)


@pytest.fixture(scope="module")
def clean(drive):
    return drive()


@pytest.mark.parametrize("found", ["knocked", "clean"])
def test_nothing_is_asked_where_one_name_stands_clear_or_nothing_is_missing(
    found, request
):
    assert design_discrimination(request.getfixturevalue(found)) is None


def test_nothing_is_found_where_nothing_is_missing(clean):
    assert clean.findings == ()
    assert clean.gap.after_um == pytest.approx(clean.gap.before_um)
    assert clean.gap.after_um < 1.05 * clean.gap.noise_floor_um


def test_an_effect_below_what_a_control_corrects_needs_nothing_done(knocked):
    (found,) = knocked.findings
    stated = effect_json(found)
    # The mean place of the tracker takes half of a step in the middle.
    assert stated["largest_um"] == pytest.approx(np.linalg.norm(STEP_UM) / 2, rel=0.1)
    assert not stated["is_small"]
    stated = effect_json(replace(found, largest_mm=2e-4))
    assert stated["is_small"]
    assert stated["remedy"] == "Nothing: it moves the target by 0.20 µm at most."


def test_a_knock_is_named_with_its_moment_and_size(knocked):
    (found,) = knocked.findings
    assert found.candidate.family == "setup-step"
    assert not found.alternatives
    assert found.grade == CERTAIN
    assert knocked.possible == ()
    said = found.parameters
    begin = knocked.aligned[0].run.tracker.device_time_s[0]
    assert abs(said["t_s"].value - begin - KNOCK_S) < 0.1
    for axis, value in zip("xyz", STEP_UM, strict=True):
        step = said[f"step_um[{axis}]"]
        assert abs(step.value - value) < 3.0 * step.uncertainty
        assert step.uncertainty < 0.5


def test_the_gap_on_lines_not_seen_falls_to_the_noise(knocked):
    gap = knocked.gap
    open_before = gap.before_um - gap.noise_floor_um
    assert open_before > 2.0 * (gap.after_um - gap.noise_floor_um)
    assert gap.after_um < 1.05 * gap.noise_floor_um


def test_a_lone_effect_closes_nearly_the_whole_gap(knocked):
    (found,) = knocked.findings
    assert 0.9 < found.evidence.share <= 1.0


@pytest.mark.long
def test_an_effect_beside_one_that_stays_closes_its_part_of_the_gap(record):
    """Of a knock and a creep the model is given one: the other's gap stays open."""
    hidden = SetupStep(40.0, STEP_UM), TableDrift((0.0, 0.05, 0.04))
    both = discover([record(11, rows=60, setting=Setting(hidden=hidden))[0]])
    without, terms = both.fitter.fit([]), [found.term for found in both.findings]
    assert len(terms) == 2
    alone = [both.fitter.fit([term]) for term in terms]
    shares = [find_share(without.misfit - a.misfit, without, a) for a in alone]
    assert max(shares) < 0.9


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
    lines = content["lines"]
    assert max(line["before_um"] for line in lines) == worst[0]["rms_um"]
    assert [line["time_s"] for line in lines] == sorted(
        line["time_s"] for line in lines
    )
    assert discovery_json(clean)["effects"] == []
