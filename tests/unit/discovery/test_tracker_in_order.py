"""What a tracker in order adds is not taken for an effect of the machine."""

from dataclasses import replace

import numpy as np
import pytest

from following import shift
from recorded import choose_program, load_erring, record_run
from truepath.answers.discovery.discovery_json import discovery_json, explain
from truepath.answers.discovery.model_file import build_next_model
from truepath.discovery.discover import discover
from truepath.discovery.name_trial import CERTAIN
from truepath.discovery.open_questions import design_discrimination
from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath_simulators.hidden.drives import Backlash
from truepath_simulators.worlds.synthetic import Setting


def measure(errors, *hidden, stated=None):
    made, setting = load_erring(errors), Setting(hidden=hidden)
    run, _ = record_run(made, choose_program(made, 12, rows=40), 12, setting=setting)
    if stated is None:
        return run
    tracker = replace(run.machine.tracker, specification=stated)
    return replace(run, machine=replace(run.machine, tracker=tracker))


def test_what_a_tracker_beyond_its_specification_may_do_is_asked_not_named():
    stated = TrackerSpecification(delay_us=8.0)
    found = discover([measure({"delay_us": 90.0}, stated=stated)])
    content = discovery_json(found)
    assert content["effects"] == []
    (possible,) = content["possible"]
    assert {"name": "tracker-errors"} in possible["indistinguishable_from"]
    assert "an error of the tracker" in explain(design_discrimination(found))


def test_what_is_counted_as_noise_beyond_the_stated_is_described():
    run = measure(None)
    point_mm = run.tracker.position_mm
    distance_mm = np.linalg.norm(point_mm, axis=1)[:, None]
    cyclic_mm = 0.01 * np.sin(2.0 * np.pi * distance_mm / 3.0)
    found = discover([shift(run, cyclic_mm * point_mm / distance_mm)])
    said = [one["description"] for one in discovery_json(found)["unnamed"]]
    assert any("along the beam" in text and "as noise" in text for text in said)


@pytest.mark.parametrize("errors", [None, {"delay_us": 90.0}], ids=["typical", "late"])
def test_a_tracker_that_errs_is_no_lost_motion_and_no_lag_of_the_machine(errors):
    found = discover([measure(errors, stated=TrackerSpecification())])
    assert found.findings == ()
    assert found.possible == ()
    assert found.gap.after_um < 1.05 * found.gap.noise_floor_um


def test_play_is_certain_and_errors_of_the_tracker_are_no_part_of_the_next_model():
    worn = discover([measure(None, Backlash("Y", 8.0))])
    (found,) = worn.findings
    assert found.candidate.label == "backlash Y"
    assert found.grade == CERTAIN
    width = found.parameters["width_um"]
    assert abs(width.value - 8.0) < 3.0 * width.uncertainty
    said = str(build_next_model(worn, None).content["model"])
    assert "backlash" in said
    assert "tracker" not in said
    assert "set-up" not in said
