"""A disturbed measurement gives the right result or says that it does not."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from following import shift
from recorded import with_samples
from results_fixtures import shorten
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators import machine_file
from truepath_simulators.hidden.setup import TableDrift, TrackerRangeOffset
from truepath_simulators.motion.paths import turning_points
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Setting

TRAVEL_MM = 150.0
SEAT_MM = np.array([0.06, -0.08, 0.05])  # of W1 off its place
CONTENT = shorten(machine_file.load_machine("trunnion"))
CONTENT["tracker"]["stands_on"] = "base"


def shifted(run, first, last, shift_mm):
    moved = run.tracker.position_mm.copy()
    moved[first:last] += shift_mm
    return with_samples(run, position_mm=moved)


@pytest.fixture(scope="module")
def clean(record):
    return record(21, rows=40, travel_mm=TRAVEL_MM)[0]


@pytest.fixture(scope="module")
def found(clean):
    return analyse(clean)


def assert_states_the_same(spoilt, found):
    assert spoilt.verdict.state == "usable"
    stated_um = spoilt.volumetric.before.mean.value_um
    clean_um = found.volumetric.before.mean.value_um
    assert stated_um == pytest.approx(clean_um, rel=0.02)
    return stated_um, clean_um


def test_a_clean_measurement_is_usable_and_keeps_all(found):
    assert found.verdict.state == "usable"
    # One line is too short for a constant feed.
    assert {r.kind for r in found.verdict.reasons} <= {"lines-without-data"}
    assert found.knocks == ()
    content = result_json(found)
    assert {each["cause"] for each in content["left_out"]} <= {"no-pass"}
    assert content["setup_steps"] == []


@pytest.mark.parametrize(("samples", "off_mm"), [(50, 5.0), (700, 0.1)])
@pytest.mark.fault_row(12)
def test_a_burst_is_left_out_and_named_by_its_time(
    clean, found, samples, off_mm, measured
):
    first = len(clean.tracker) // 3
    spoilt = analyse(shifted(clean, first, first + samples, [0.0, off_mm, 0.0]))
    time_s = clean.tracker.device_time_s[[first, first + samples - 1]]
    told = [each for each in result_json(spoilt)["left_out"] if each["samples"]]
    assert told
    assert min(each["from_s"] for each in told) < time_s[1]
    assert max(each["to_s"] for each in told) > time_s[0]
    assert max(each["distance_um"] for each in told) > 500.0 * off_mm
    stated_um, clean_um = assert_states_the_same(spoilt, found)
    measured(
        f"{samples} samples {off_mm:g} mm off: {stated_um:.2f} µm stated, "
        f"{clean_um:.2f} µm without them"
    )


@pytest.mark.fault_row(11)
def test_a_knock_splits_the_run_and_both_places_are_solved(clean, found):
    first = int(0.55 * len(clean.tracker))
    spoilt = analyse(shifted(clean, first, None, [0.03, -0.03, 0.02]))
    (knock,) = spoilt.knocks
    assert abs(knock.time_s - clean.tracker.device_time_s[first]) < 3.0
    assert 1e3 * knock.moved_mm == pytest.approx(46.9, abs=2.0)
    assert [run.part for run in spoilt.runs] == [1, 2]
    (step,) = result_json(spoilt)["setup_steps"]
    assert step["kind"] == "place"
    assert "set-up-moved" in {reason.kind for reason in spoilt.verdict.reasons}
    assert_states_the_same(spoilt, found)


def test_a_drift_is_no_knock_and_widens_what_is_stated(record):
    drift, how = TableDrift((0.3, -0.3, 0.24)), {"rows": 40, "travel_mm": TRAVEL_MM}
    settings = Setting(), Setting(hidden=(drift,))
    runs = (record(22, setting=setting, **how)[0] for setting in settings)
    still, drifting = map(analyse, runs)
    assert drifting.knocks == ()
    before, after = (one.volumetric.before.mean for one in (still, drifting))
    assert after.uncertainty_um > 1.3 * before.uncertainty_um
    apart = np.hypot(before.uncertainty_um, after.uncertainty_um)
    assert abs(after.value_um - before.value_um) < 2.0 * apart
    noise = drifting.estimate.runs[0].noise
    assert noise.ou_time_s > 3.0 * still.estimate.runs[0].noise.ou_time_s


@pytest.mark.fault_row(12)
def test_a_frozen_tracker_is_said(clean):
    first = len(clean.tracker) // 2
    moved = clean.tracker.position_mm.copy()
    moved[first : first + 1000] = moved[first]
    spoilt = analyse(with_samples(clean, position_mm=moved))
    assert "frozen" in {each.cause for each in spoilt.left_out[0]}
    assert spoilt.verdict.state == "usable"


@pytest.mark.long
@pytest.mark.fault_row(12)
def test_single_samples_of_the_wrong_sign_are_left_out_and_named(clean, found):
    rows = np.random.default_rng(5).choice(len(clean.tracker), 40, replace=False)
    moved = clean.tracker.position_mm.copy()
    moved[rows] *= [-1.0, 1.0, 1.0]
    spoilt = analyse(with_samples(clean, position_mm=moved))
    told = [each for each in result_json(spoilt)["left_out"] if each["samples"]]
    assert sum(each["samples"] for each in told) >= 30  # others are in no pass
    assert_states_the_same(spoilt, found)


@pytest.mark.parametrize(
    ("offset_um", "state", "how", "most_um"),
    [
        (-60.0, "doubtful", {"rows": 30, "travel_mm": 300.0}, 12.0),
        pytest.param(-40.0, "doubtful", {"rows": 60}, 6.0, marks=pytest.mark.long),
        pytest.param(250.0, "not-usable", {"rows": 60}, 10.0, marks=pytest.mark.long),
    ],
)
def test_a_wrong_home_distance_is_named_in_um(record, offset_um, state, how, most_um):
    setting = Setting(hidden=(TrackerRangeOffset(offset_um),))
    findings = analyse(record(31, **how, setting=setting)[0])
    assert findings.knocks == ()
    reasons = findings.verdict.reasons
    (reason,) = (one for one in reasons if one.kind == "range-off")
    assert reason.state == state
    found, within = reason.values["distance_um"], reason.values["within_um"]
    assert abs(found - offset_um) < 1.5 * within
    assert within < most_um


@pytest.fixture(scope="module")
def made():
    program = turning_points(machine_file.parse_machine(CONTENT), 5, 96, dwell_s=0.4)
    return synthetic.record(CONTENT, program, 5, "standstill")


@pytest.fixture(scope="module")
def change(made):
    return made.program.target.index("W1")


def test_a_point_lost_where_the_target_changes_may_be_a_knock(made, run_of, change):
    run, amid = run_of(made), change + 8
    status = np.where(np.isin(made.row, (change, amid)), 1, run.tracker.status)
    verdict = analyse(with_samples(run, status=status)).verdict
    values = {reason.kind: reason.values for reason in verdict.reasons}
    assert verdict.state == "doubtful"
    assert values["points-without-data"] == {"points": f"{change}, {amid}"}
    near = values["knock-unseen"]["rows"].split(", ")
    assert (str(change) in near, str(amid) in near) == (True, False)


@pytest.mark.long
def test_a_run_without_its_first_target_at_the_end_says_so(made, run_of, change):
    kinds = {r.kind: r.values for r in analyse(run_of(made)).verdict.reasons}
    assert str(change) in kinds["not-measured-again"]["rows"].split(", ")


@pytest.mark.long
def test_a_knock_at_a_change_shows_where_the_first_target_comes_again(made, run_of):
    program = made.program
    own = program.target.index("T2") // 2
    position = np.vstack([program.position[:-4], program.position[:4]])
    target = program.target[own:] + program.target[:own]
    order = replace(program, position=position, target=target)
    seated = copy.deepcopy(CONTENT)
    w1 = seated["targets"]["W1"]
    w1["offset_mm"] = (np.array(w1["offset_mm"]) + SEAT_MM).tolist()
    recorded = synthetic.record(seated, order, 5, "standstill")
    made_again = replace(recorded, content=CONTENT)
    first = made_again.program.target.index("W1")
    knock_s = made_again.time_s[made_again.row >= first][0]
    run = run_of(made_again)
    late = (run.tracker.device_time_s >= knock_s)[:, None]
    knocked = analyse(shift(run, late * [0.012, -0.008, 0.014]))
    (knock,) = knocked.knocks
    assert 1e3 * knock.moved_mm == pytest.approx(20.1, abs=3.0)
    every = [seat for part in knocked.runs for seat in part.estimate.seats]
    seats = [seat for seat in every if seat.target.name == "W1"]
    assert seats
    for seat in seats:
        assert (np.abs(seat.shift_mm - SEAT_MM) < 3.0 * seat.sigma_mm).all()
