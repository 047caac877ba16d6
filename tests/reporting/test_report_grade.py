"""Files and report about the set-up: grade, weak shapes, extrapolated ends."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.calibration.calibration_report import render_calibration_report
from truepath.files.earlier.result_file import result_from_json
from truepath.planning.grade import grade
from truepath.planning.lines.default_path import default_path
from truepath.results.error_table_files import error_tables_csv
from truepath.results.error_tables import build_error_tables
from truepath.results.findings import state_findings
from truepath.results.grade_json import grade_json, in_words
from truepath.results.prediction import predict
from truepath.results.result_json import result_json

STATION_MM = np.array([900.0, 100.0, -200.0])
MEASURED = {"X": (-100.0, 300.0), "Y": (10.0, 300.0), "Z": (20.0, 290.0)}
WEAK = "EZZ together with B0Z: a bow of the error along Z is poorly observable; …"


@pytest.fixture(scope="module")
def partly(estimate):
    """The estimate, had only a part of the travel been measured."""
    seen = replace(estimate.observability, poorly_observable=(WEAK,))
    return replace(estimate, measured=MEASURED, observability=seen)


@pytest.fixture(scope="module")
def graded(partly, provenance):
    machine = partly.model.machine
    poor = grade(machine, default_path(machine, lines=5), station_mm=STATION_MM)
    return state_findings(partly, provenance, None, poor)


def test_every_extrapolated_value_is_marked_in_the_csv_file(graded):
    rows = list(
        csv.DictReader(io.StringIO(error_tables_csv(graded.tables, graded.verdict)))
    )
    for row in rows:
        if row["position_mm"]:
            low, high = MEASURED[row["error"][2]]
            beyond = not low <= float(row["position_mm"]) <= high
            assert row["extrapolated"] == str(int(beyond))
        else:
            assert row["extrapolated"] == ""
    assert {row["extrapolated"] for row in rows} == {"0", "1", ""}


def test_the_result_marks_them_and_a_reader_finds_them_again(graded):
    content = json.loads(json.dumps(result_json(graded)))
    table = content["error_tables"]["EYX"]
    beyond = np.array(table["position_mm"]) < -100.0
    assert table["extrapolated"] == beyond.tolist()
    assert content["measured_range"]["Z"] == {"from_mm": 20.0, "to_mm": 290.0}
    loaded = result_from_json(content)
    assert loaded.measured == MEASURED
    again = build_error_tables(loaded, loaded.measured).table("EYX")
    assert again.extrapolated.tolist() == beyond.tolist()


def test_a_result_without_a_measured_range_marks_nothing(graded):
    content = result_json(graded)
    del content["measured_range"]
    loaded = result_from_json(content)
    assert loaded.measured == {}
    assert (
        not build_error_tables(loaded, loaded.measured).table("EYX").extrapolated.any()
    )


def test_weak_shapes_stand_beside_what_cannot_be_seen(graded):
    assert result_json(graded)["observability"]["weak"] == [WEAK]
    assert "EZZ together with B0Z" in render_calibration_report(graded)


def test_the_report_states_grade_remedy_and_extrapolated_ends(graded):
    page = render_calibration_report(graded)
    assert f"Grade of the set-up: <strong>{graded.grade.number:.2f}" in page
    assert graded.grade.weakest[0].remedy.text in page
    assert "X -200 to -100 mm" in page.replace("−", "-")
    assert "Z 290 to 310 mm" in page


def test_the_grade_says_in_words_what_to_add(graded):
    said = in_words(graded.grade)
    assert said.startswith(f"{graded.grade.number:.2f}, {graded.grade.verdict}: ")
    assert f"which makes it {graded.grade.improved:.2f}." in said
    content = grade_json(graded.grade)
    assert content["weakest"][0]["remedy"].startswith("add a line ") or content[
        "weakest"
    ][0]["remedy"].startswith("add the diagonal ")
    assert content["thresholds"] == {"good": 0.25, "usable": 1.0}
    expanded = 2 * content["expected_uncertainty_um"]
    assert f"expected are {expanded:.1f} µm (k = 2)" in said


def test_without_a_grade_the_report_says_nothing_of_one(found):
    assert result_json(found)["grade"] is None
    assert "Grade of the set-up" not in render_calibration_report(found)


def test_prediction_warns_of_points_far_beyond_what_was_measured(partly, load):
    loaded = replace(load(partly), measured=MEASURED)
    inside, far = [0.0, 100.0, 100.0], [-190.0, 100.0, 100.0]
    (said,) = predict(loaded, np.array([inside, far])).warnings
    assert said.startswith("1 of 2 points lie in the travel but far beyond what was")
    assert predict(loaded, np.array([inside])).warnings == ()


def test_prediction_is_less_sure_the_farther_it_leaves_the_travel(loaded):
    x = np.array([300.0, 320.0, 400.0, 600.0])
    position = np.column_stack([x, np.full(4, 200.0), np.full(4, 100.0)])
    sigma = np.linalg.norm(predict(loaded, position).uncertainty_um, axis=1)
    assert (np.diff(sigma) > 0.0).all()
