"""A disturbed measurement gives the right result or says that it does not."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.hidden.setup import TableDrift
from truepath_simulators.worlds.synthetic import Setting


def shifted(run, first, last, shift_mm):
    moved = run.tracker.position_mm.copy()
    moved[first:last] += shift_mm
    return replace(run, tracker=replace(run.tracker, position_mm=moved))


@pytest.fixture(scope="module")
def clean(record):
    return record(21, rows=60)[0]


@pytest.fixture(scope="module")
def found(clean):
    return analyse(clean)


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
    assert spoilt.verdict.state == "usable"
    stated_um = spoilt.volumetric.before.mean.value_um
    clean_um = found.volumetric.before.mean.value_um
    assert stated_um == pytest.approx(clean_um, rel=0.02)
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
    assert "set-up-moved" in {reason.kind for reason in spoilt.verdict.reasons}
    assert spoilt.verdict.state == "usable"
    assert spoilt.volumetric.before.mean.value_um == pytest.approx(
        found.volumetric.before.mean.value_um, rel=0.02
    )


def test_a_drift_is_no_knock_and_is_not_passed_over(record):
    drift = TableDrift((0.1, -0.1, 0.08))
    told = analyse(record(22, rows=60, setting=Setting(hidden=(drift,)))[0])
    assert told.knocks == ()
    assert told.verdict.state != "usable"
    assert "loop-open" in {reason.kind for reason in told.verdict.reasons}


@pytest.mark.fault_row(12)
def test_a_frozen_tracker_is_said(clean):
    first = len(clean.tracker) // 2
    moved = clean.tracker.position_mm.copy()
    moved[first : first + 1000] = moved[first]
    spoilt = analyse(replace(clean, tracker=replace(clean.tracker, position_mm=moved)))
    assert "frozen" in {each.cause for each in spoilt.left_out[0]}
    assert spoilt.verdict.state == "usable"


@pytest.mark.long
@pytest.mark.fault_row(12)
def test_single_samples_of_the_wrong_sign_are_left_out_and_named(clean, found):
    rows = np.random.default_rng(5).choice(len(clean.tracker), 40, replace=False)
    moved = clean.tracker.position_mm.copy()
    moved[rows] *= [-1.0, 1.0, 1.0]
    spoilt = analyse(replace(clean, tracker=replace(clean.tracker, position_mm=moved)))
    told = [each for each in result_json(spoilt)["left_out"] if each["samples"]]
    assert sum(each["samples"] for each in told) >= 30  # others are in no pass
    assert spoilt.verdict.state == "usable"
    assert spoilt.volumetric.before.mean.value_um == pytest.approx(
        found.volumetric.before.mean.value_um, rel=0.02
    )
