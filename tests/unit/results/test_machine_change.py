"""What has changed between calibrations of a machine, and when the next one is due."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from truepath.answers.history import machine_documents as documents
from truepath.answers.history.machine_change import (
    CHANCE,
    find_changes,
    list_significant,
)
from truepath.answers.history.machine_history import Entry, list_differing
from truepath.answers.trend.recalibration_forecast import ForecastModel
from truepath.answers.trend.trend import describe_outlook
from truepath.errors import BadInput
from truepath.estimation.solve.drift import Course
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.estimated_model import compute_scale_parameters
from truepath.kinematics.machine.machine import Target
from truepath.results.result_json import result_json

SYMBOL = "EYX"
HOUR_S = 3600.0


def draw_result(estimate, seed, shift=0.0):
    """A result whose parameters miss the truth as its covariance says.

    shift : of all parameters of EYX, in their standard uncertainties
    """
    rng = np.random.default_rng(seed)
    off = rng.multivariate_normal(np.zeros(estimate.model.size), estimate.covariance)
    theta = estimate.theta + off
    part = estimate.model.slices[SYMBOL]
    sigma = np.sqrt(np.diag(estimate.covariance)[part])
    signs = np.resize([1.0, -1.0], sigma.shape)
    theta[part] += shift * sigma * signs
    runs = [{"name": f"run {seed}", "input_sha256": f"{seed:064d}"}]
    told = estimate.model, theta, estimate.covariance
    return CalibrationResult(*told, provenance={"runs": runs})


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    # More would come with a chance of 0.3 and 2 % where 5 % are stated.
    ("pairs", "most"),
    [(20, 4), pytest.param(100, 9, marks=pytest.mark.long)],
)
def test_a_machine_that_has_not_changed_is_rarely_said_to_have(estimate, pairs, most):
    drawn = ([draw_result(estimate, 2 * k + i) for i in (0, 1)] for k in range(pairs))
    assert sum(find_changes(*pair).is_significant for pair in drawn) <= most


def test_a_change_is_named_with_its_size_and_nothing_else_is(estimate):
    change = find_changes(draw_result(estimate, 1), draw_result(estimate, 2, shift=8.0))
    assert change.is_significant
    named = list(list_significant(change))
    worst = named[0]
    assert abs(worst.difference) > change.factor * worst.uncertainty
    assert worst.chance < CHANCE / 2.0
    quiet = {e.symbol for e in change.entries if not e.is_significant}
    assert "EZZ" in quiet
    assert {e.symbol for e in named} == {SYMBOL}
    # Many entries are held against more than one number would be.
    assert len(change.entries) > 100
    assert 2.5 < change.factor < 4.5


def test_results_of_one_run_or_of_other_targets_are_not_compared(estimate, construct):
    with pytest.raises(BadInput, match="come from one Run"):
        find_changes(draw_result(estimate, 1), draw_result(estimate, 1))
    other = construct((Target("", "tool", (20.0, 30.0, -250.0)),))
    with pytest.raises(BadInput, match="different targets"):
        find_changes(draw_result(estimate, 1), draw_result(other, 2))


def test_where_the_tracker_stood_and_another_scale_of_the_air_are_no_change(estimate):
    certain = replace(estimate, covariance=1e-4 * estimate.covariance)
    before = draw_result(certain, 1)
    # Both calibrations know their lengths to 20 ppm; the second has 40 ppm too much.
    after = draw_result(certain, 2)
    longer = after.theta + 40e-6 * compute_scale_parameters(after.model)
    pair = before, replace(after, theta=longer)
    known = [one.widen_by_scale(20e-6) for one in pair]
    assert not find_changes(*known).is_significant
    change = find_changes(*pair)
    assert change.volume.is_significant
    assert {e.symbol for e in list_significant(change)} & {"EXX", "EYY", "EZZ"}
    before = draw_result(estimate, 1)
    digest = [{"name": "later", "input_sha256": "f" * 64}]
    change = find_changes(before, replace(before, provenance={"runs": digest}))
    assert not change.is_significant
    assert change.volume.difference_um == pytest.approx(0.0, abs=1e-9)
    assert change.volume.change_um == 0.0


@pytest.fixture(scope="module")
def content(found):
    return json.loads(json.dumps(result_json(found)))


@pytest.fixture
def calibrate(content, tmp_path):
    def keep(machine, number, p95=None):
        stated = json.loads(json.dumps(content))
        if p95 is not None:
            figure = {"value_um": p95, "uncertainty_um": 0.5}
            stated["volumetric_error"]["before"]["p95"] = figure
        file = tmp_path / f"{machine}-{number}.json"
        file.write_text(json.dumps(stated), encoding="utf-8")
        job_id, when = f"job-{number}", f"2026-01-0{number}T08:00:00.000Z"
        known = machine, job_id, (job_id,), when, 1, "usable", file
        return documents.Calibration(*known)

    return keep


def test_history_states_what_results_state_and_refuses_others(calibrate, content):
    made = [calibrate("mill", 1), calibrate("mill", 2)]
    history = documents.history_json("mill", made, "EXX", None)
    table = content["error_tables"]["EXX"]
    assert [e["position"] for e in history["entries"]] == table["position_mm"]
    for point in history["calibrations"]:
        assert point["value"] == table["value_um"]
        assert point["uncertainty"] == table["uncertainty_um"]
    one = documents.history_json("mill", made, "EXX", table["position_mm"][2])
    assert one["calibrations"][0]["value"] == [table["value_um"][2]]
    made = [calibrate("mill", 1, p95=9.0)]
    history = documents.history_json("mill", made, "volumetric", None)
    assert [e["label"] for e in history["entries"]] == ["mean", "p95", "largest"]
    assert history["calibrations"][0]["value"][1] == 9.0
    with pytest.raises(BadInput, match="is no quantity"):
        documents.history_json("mill", made, "QQQ", None)
    with pytest.raises(BadInput, match=r"has no entry at 33\.3; it has"):
        documents.history_json("mill", made, "EXX", 33.3)


@pytest.mark.parametrize(
    ("p95", "state"), [(8.0, "within"), (9.5, "not-sure"), (12.0, "over")]
)
def test_a_tolerance_is_judged_with_the_uncertainty(calibrate, p95, state):
    judged = documents.assess_tolerance(calibrate("mill", 1, p95=p95), 10.0)
    assert judged.state == state
    assert "tolerance of 10 µm" in judged.text


def test_machines_are_compared_by_what_is_sure_the_more_the_more_it_takes(calibrate):
    known = {"mill": 20.0, "lathe": 9.0, "press": 9.5}
    newest = [calibrate(name, k, p95) for k, (name, p95) in enumerate(known.items(), 1)]
    found = documents.comparison_json(newest, "volumetric", None, {"mill": 15.0})
    assert [m["machine"] for m in found["machines"]] == ["lathe", "press", "mill"]
    more = {m["machine"]: m["is_more_than"] for m in found["machines"]}
    assert more == {"lathe": [], "press": [], "mill": ["lathe", "press"]}
    with pytest.raises(BadInput, match="give the position of one"):
        documents.comparison_json(newest, "EXX", None, {})
    entries = [Entry("", None, "", 0.0, 1.0)] * 2
    two, _ = list_differing(entries)
    eight, _ = list_differing(entries * 4)
    assert 1.9 < two < 2.0
    assert eight > 3.0


def look(beyond, begin_um=0.5, runs=4, limit=2.0):
    grows = np.arange(100) < 100 * beyond

    def measure(at):
        hours = (at.time_s - at_runs.time_s[-1]) / HOUR_S
        return begin_um + grows[:, None] * hours

    def course_at(*time_s):
        return Course(np.array(time_s), np.zeros((len(time_s), 0)))

    at_runs = course_at(*HOUR_S * np.arange(runs))
    told = {"course_at": course_at, "_measure_change_um": measure}
    stub = SimpleNamespace(runs=at_runs, **told)
    return ForecastModel.predict_exceedance(stub, limit, 10.0 * HOUR_S)


@pytest.mark.parametrize(
    ("beyond", "state", "grade", "said"),
    [
        (0.0, "not-within-horizon", "certain", "stays below 2 µm up to 13.0 h"),
        (0.04, "not-within-horizon", "certain", "stays below 2 µm up to 13.0 h"),
        (0.3, "cannot-be-said", None, "Later cannot be said: the chance to exceed it"),
        (0.6, "due", "possible", "(possible)"),
        (0.8, "due", "likely", "Calibrate again at 4."),
        (1.0, "due", "certain", "(certain)"),
    ],
)
def test_each_share_of_courses_beyond_has_its_answer(beyond, state, grade, said):
    found = look(beyond)
    assert (found.state, found.grade) == (state, grade)
    assert found.exceeded == pytest.approx(beyond)
    assert said in describe_outlook(found)
    if found.due_s is not None:
        assert found.due_s / HOUR_S == pytest.approx(4.5, abs=0.2)


def test_what_is_not_known_by_itself_and_too_few_runs_have_answers_of_their_own():
    assert look(0.0, begin_um=3.0).state == "already"
    few = look(1.0, runs=2)
    assert (few.state, few.grade, few.exceeded) == ("not-known", None, None)
    assert look(1.0, limit=None).exceeded is None
