"""Results of a machine over time and over temperature."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from results_fixtures import as_loaded
from temperature_world import SHIFTED, World
from truepath.answers import machine_history as documents
from truepath.answers.machine_change import CHANCE, detect_changes, list_significant
from truepath.answers.machine_history import Entry, list_differing
from truepath.answers.temperature import combine_results, study_temperature
from truepath.answers.temperature_report import temperature_json
from truepath.answers.trend import ForecastModel
from truepath.answers.trend_report import describe_forecast
from truepath.errors import BadInput
from truepath.estimation.solve.drift import Course
from truepath.files.earlier.result_file import CalibrationResult, HalfDifference
from truepath.files.earlier.temperature_file import temperature_model_from_json
from truepath.kinematics.machine.machine import Target
from truepath.kinematics.model import compute_scale_parameters
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
    assert sum(detect_changes(*pair).is_significant for pair in drawn) <= most


def test_a_change_is_named_with_its_size_and_nothing_else_is(estimate):
    change = detect_changes(
        draw_result(estimate, 1), draw_result(estimate, 2, shift=8.0)
    )
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
        detect_changes(draw_result(estimate, 1), draw_result(estimate, 1))
    other = construct((Target("", "tool", (20.0, 30.0, -250.0)),))
    with pytest.raises(BadInput, match="different targets"):
        detect_changes(draw_result(estimate, 1), draw_result(other, 2))


def test_where_the_tracker_stood_and_another_scale_of_the_air_are_no_change(estimate):
    certain = replace(estimate, covariance=1e-4 * estimate.covariance)
    before = draw_result(certain, 1)
    # Both calibrations know their lengths to 20 ppm; the second has 40 ppm too much.
    after = draw_result(certain, 2)
    longer = after.theta + 40e-6 * compute_scale_parameters(after.model)
    pair = before, replace(after, theta=longer)
    known = [one.widen_by_scale(20e-6) for one in pair]
    assert not detect_changes(*known).is_significant
    change = detect_changes(*pair)
    assert change.volume.is_significant
    assert {e.symbol for e in list_significant(change)} & {"EXX", "EYY", "EZZ"}
    before = draw_result(estimate, 1)
    digest = [{"name": "later", "input_sha256": "f" * 64}]
    change = detect_changes(before, replace(before, provenance={"runs": digest}))
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
    assert said in describe_forecast(found)
    if found.due_s is not None:
        assert found.due_s / HOUR_S == pytest.approx(4.5, abs=0.2)


def test_what_is_not_known_by_itself_and_too_few_runs_have_answers_of_their_own():
    assert look(0.0, begin_um=3.0).state == "already"
    few = look(1.0, runs=2)
    assert (few.state, few.grade, few.exceeded) == ("not-known", None, None)
    assert look(1.0, limit=None).exceeded is None


KINDS = {  # of half differences: a symbol of each, and its name in a sentence
    "half_difference_um": ("EXX", "X"),
    "half_turn_urad": ("ECC", "C"),
    "half_across": ("EYX", "EYX"),
}
AT, OWN = np.array([0.0, 100.0]), 0.5


@pytest.fixture
def world(estimate):
    return World(estimate, 1e-3)  # U of a coefficient is then what matters


def name_dependent(study):
    return {one.symbol for one in study.dependences if one.is_significant}


def find_expansion(study):
    return next(one for one in study.expansions if one.axis == "X")


@pytest.mark.parametrize("scatter", [0.0, 3.0])
@pytest.mark.parametrize(
    # More would come with a chance of 0.6 and 3 % where 5 % are stated.
    ("rounds", "most"),
    [(8, 2), pytest.param(150, 12, marks=pytest.mark.long)],
)
def test_a_machine_is_said_to_depend_and_grow_as_it_does(world, rounds, most, scatter):
    steady = (study_temperature(world.draw(k, scatter=scatter)) for k in range(rounds))
    assert sum(bool(name_dependent(study)) for study in steady) <= most
    world.grow(11.0)
    grown = (study_temperature(world.draw(k, scatter=scatter)) for k in range(rounds))
    found = [find_expansion(study) for study in grown]
    off_um = [abs(one.value_um_per_m_k - 11.0) for one in found]
    u_um = [2.0 * one.uncertainty_um_per_m_k for one in found]
    assert np.sum(np.less(off_um, u_um)) >= rounds - most


def test_only_what_depends_on_temperature_is_named_and_comes_back_from_a_file(world):
    study = study_temperature(world.grow(11.0).draw(1))
    assert name_dependent(study) == {SHIFTED}
    assert study.model.grows == {"X"}
    model = study.model
    content = json.loads(json.dumps(temperature_json(study)))
    again = temperature_model_from_json(content, file="temperature.json")
    for celsius in (19.0, 24.0):
        one, other = model.at(celsius), again.at(celsius)
        np.testing.assert_allclose(other.theta, one.theta, rtol=1e-6, atol=1e-12)
        pair = other.covariance, one.covariance
        np.testing.assert_allclose(*pair, rtol=1e-6, atol=1e-20)
    assert again.grows == {"X"}


def test_a_wide_scatter_of_set_ups_is_not_taken_for_temperature(world):
    steady, loose = (study_temperature(world.draw(3, scatter=s)) for s in (0.0, 30.0))
    assert name_dependent(loose) == set()
    u, more = (find_expansion(x).uncertainty_um_per_m_k for x in (steady, loose))
    assert more > 3.0 * u


def test_an_unseen_temperature_is_told_better_by_the_line_than_by_the_mean(world):
    results = world.grow(11.0).draw(5, (18.0, 25.0, 20.0))
    at = study_temperature(results).model.at(23.5)
    truth = world.estimate.theta + 3.5 * world.coefficient
    mean = np.mean([one.result.theta for one in results], axis=0)
    part = world.model.slices[SHIFTED]
    off = at.theta - truth, mean - truth
    line_off, mean_off = (np.linalg.norm(one[part]) for one in off)
    assert line_off < 0.3 * mean_off


def test_results_that_tell_no_temperatures_apart_or_share_a_run_are_refused(world):
    with pytest.raises(BadInput, match="2 different temperatures"):
        study_temperature(world.draw(1, (20.0, 20.1, 24.0), sigma_k=0.0))
    first, second, third = world.draw(1, (18.0, 20.0, 22.0))
    same = replace(third.result, provenance=first.result.provenance)
    with pytest.raises(BadInput, match="share a Run"):
        study_temperature([first, second, replace(third, result=same)])
    world.covariance *= 50.0
    world.root *= 50.0**0.5
    with pytest.raises(BadInput, match="measure further apart in temperature"):
        study_temperature(world.draw(1, (19.6, 20.4, 20.0), sigma_k=0.0))


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (None, "is not known"),
        ((0.0, 30.0, 10.0, 20.0), "rise from result to result"),
        ((0.0, 10.0, 20.0, 30.0), ""),
    ],
)
def test_a_drift_over_time_that_would_look_the_same_is_named(world, times, words):
    study = study_temperature(world.draw(1, times=times))
    said = " ".join(study.cautions)
    assert (words in said) if words else not said
    doubtful = study.model.reference.verdict.state == "doubtful"
    assert doubtful == words.startswith("rise")


def test_beyond_the_measured_temperatures_nothing_is_told_unless_asked(world):
    results = world.draw(1, sigma_k=0.0)
    with pytest.raises(BadInput, match="is beyond the 18"):
        study_temperature(results).model.at(27.0)
    wide = study_temperature(results, range_degc=(15.0, 30.0)).model
    at = {celsius: wide.at(celsius).covariance.trace() for celsius in (21.0, 27.0)}
    assert at[27.0] > 2.0 * at[21.0]


def state(result, half):
    one = HalfDifference(AT, np.full(2, half), np.full(2, OWN))
    return replace(result, halves={symbol: one for symbol, _ in KINDS.values()})


@pytest.mark.parametrize("kind", KINDS)
def test_lost_motion_is_the_mean_and_as_uncertain_as_results_scatter(estimate, kind):
    results = [state(as_loaded(estimate), half) for half in (1.0, 2.0, 3.0)]
    joined = combine_results(results).result
    symbol, name = KINDS[kind]
    half = joined.halves[symbol]
    np.testing.assert_array_equal(half.position, AT)
    np.testing.assert_allclose(half.value, 2.0)
    expected = np.sqrt((OWN**2 + 1.0) / 3.0)  # 1 is the scatter of 1, 2 and 3
    np.testing.assert_allclose(half.sigma, expected)
    others = {s: one for s, one in results[1].halves.items() if s != symbol}
    lacking = replace(results[1], halves=others)
    combined = combine_results([results[0], lacking, results[2]])
    assert list(combined.result.halves) == list(others)
    ((_, words),) = combined.left_out
    assert words.rstrip(".").endswith(f" {name}")
