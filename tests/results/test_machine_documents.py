"""History and comparison of machines from result files."""

from __future__ import annotations

import json

import pytest

from truepath.answers.history.machine_documents import (
    Calibration,
    comparison_json,
    history_json,
    judge_tolerance,
)
from truepath.answers.history.machine_history import Entry, list_differing
from truepath.errors import BadInput
from truepath.results.result_json import result_json


@pytest.fixture(scope="module")
def content(found):
    return json.loads(json.dumps(result_json(found)))


@pytest.fixture
def calibrate(content, tmp_path):
    """Keep a result of a machine; its p95 may be another than the constructed one."""

    def keep(machine, number, p95=None):
        stated = json.loads(json.dumps(content))
        if p95 is not None:
            figure = {"value_um": p95, "uncertainty_um": 0.5}
            stated["volumetric_error"]["before"]["p95"] = figure
        file = tmp_path / f"{machine}-{number}.json"
        file.write_text(json.dumps(stated), encoding="utf-8")
        job_id, when = f"job-{number}", f"2026-01-0{number}T08:00:00.000Z"
        return Calibration(machine, job_id, (job_id,), when, 1, "usable", file)

    return keep


def test_history_states_each_entry_as_the_results_do(calibrate, content):
    made = [calibrate("mill", 1), calibrate("mill", 2)]
    history = history_json("mill", made, "EXX", None)
    table = content["error_tables"]["EXX"]
    assert [e["position"] for e in history["entries"]] == table["position_mm"]
    for point in history["calibrations"]:
        assert point["value"] == table["value_um"]
        assert point["uncertainty"] == table["uncertainty_um"]
    one = history_json("mill", made, "EXX", table["position_mm"][2])
    assert one["calibrations"][0]["value"] == [table["value_um"][2]]


def test_history_of_the_volume_has_its_three_figures(calibrate):
    history = history_json("mill", [calibrate("mill", 1, p95=9.0)], "volumetric", None)
    labels = [e["label"] for e in history["entries"]]
    assert labels == ["mean", "p95", "largest"]
    assert history["calibrations"][0]["value"][1] == 9.0


@pytest.mark.parametrize(
    ("quantity", "position", "problem"),
    [("QQQ", None, "is no quantity"), ("EXX", 33.3, "has no entry at 33.3; it has")],
)
def test_what_is_not_stated_is_refused_by_name(calibrate, quantity, position, problem):
    with pytest.raises(BadInput, match=problem):
        history_json("mill", [calibrate("mill", 1)], quantity, position)


@pytest.mark.parametrize(
    ("p95", "state"), [(8.0, "within"), (9.5, "not-sure"), (12.0, "over")]
)
def test_a_tolerance_is_judged_with_the_uncertainty(calibrate, p95, state):
    judged = judge_tolerance(calibrate("mill", 1, p95=p95), 10.0)
    assert judged.state == state
    assert "tolerance of 10 µm" in judged.text


def test_machines_are_compared_by_what_is_sure(calibrate):
    newest = [
        calibrate("mill", 1, p95=20.0),
        calibrate("lathe", 2, p95=9.0),
        calibrate("press", 3, p95=9.5),
    ]
    found = comparison_json(newest, "volumetric", None, {"mill": 15.0})
    assert [m["machine"] for m in found["machines"]] == ["lathe", "press", "mill"]
    more = {m["machine"]: m["is_more_than"] for m in found["machines"]}
    assert more == {"lathe": [], "press": [], "mill": ["lathe", "press"]}
    with pytest.raises(BadInput, match="give the position of one"):
        comparison_json(newest, "EXX", None, {})


def test_the_more_machines_the_more_two_have_to_differ():
    entries = [Entry("", None, "", 0.0, 1.0)] * 2
    two, _ = list_differing(entries)
    eight, _ = list_differing(entries * 4)
    assert 1.9 < two < 2.0
    assert eight > 3.0
