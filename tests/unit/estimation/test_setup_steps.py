"""Knocks of the set-up are told apart from drift and from one another."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate_one, judge_map
from following import shift
from truepath.alignment.align import align, align_all
from truepath.estimation.checks.run_segments import (
    RunSegment,
    merge_empty,
    split_at_all,
)
from truepath.estimation.checks.setup_shifts import Step

POINT = 30


@pytest.fixture(scope="module")
def moving(record):
    return record(32, "otf", rows=24)[0]


def check(run, shift_mm):
    time_s = run.tracker.device_time_s
    share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    found = estimate_one(*align_all([shift(run, shift_mm(share))], ["run"]))
    return found, time_s[0] + np.array([0.3, 0.65]) * (time_s[-1] - time_s[0])


def test_knocks_are_found_where_they_are_and_told_from_drift(record_small):
    standing, _ = record_small(31, "standstill", rows=60)
    moved_mm = np.array([[0.03, -0.02, 0.01], [-0.01, -0.03, 0.03]])
    late = np.array([0.3, 0.65])
    found, time_s = check(standing, lambda share: (share[:, None] > late) @ moved_mm)
    assert [knock.time_s for knock in found.setup_shifts] == pytest.approx(
        time_s, abs=2.5
    )
    moved_um = [1e3 * knock.moved_mm for knock in found.setup_shifts]
    assert moved_um == pytest.approx([37.4, 43.6], abs=3.0)
    small_mm = [0.006, -0.006, 0.004]
    found, time_s = check(standing, lambda share: np.outer(share > 0.65, small_mm))
    (knock,) = found.setup_shifts
    assert knock.time_s == pytest.approx(time_s[1], abs=2.5)
    found, _ = check(standing, lambda share: np.outer(share, [0.02, -0.01, 0.01]))
    assert found.setup_shifts == ()


def test_a_knock_within_a_line_is_one_step_at_its_moment(moving):
    late = 0.52
    found, _ = check(moving, lambda share: np.outer(share > late, [0.02, -0.02, 0.01]))
    time_s = moving.tracker.device_time_s
    moment_s = time_s[0] + late * (time_s[-1] - time_s[0])
    (knock,) = found.setup_shifts
    assert knock.time_s == pytest.approx(moment_s, abs=0.2)
    assert 1e3 * knock.moved_mm == pytest.approx(30.0, abs=1.5)
    assert not any(misfit.unseen for misfit in found.misfits)


def test_what_lies_between_two_knocks_of_a_line_goes_and_is_said(moving):
    (seen,) = align_all([moving], ["run"])
    first, last = max(seen.lines, key=lambda line: line[1] - line[0])
    steps = [Step(cell, 1e4, 1e4, 0.1) for cell in (first + 6, last - 6)]
    edges = np.arange(len(seen) + 1)
    off_mm = np.full(len(seen), 0.1)
    parts = split_at_all(RunSegment(0, seen), steps, edges, off_mm)
    before, after = merge_empty(parts)
    time_s = seen.at.time_s
    assert before.seen.at.time_s[-1] < time_s[first + 6]
    assert after.seen.at.time_s[0] > time_s[last - 6]
    (said,) = before.seen.left_out
    assert said.begin_s == pytest.approx(time_s[first + 6], abs=0.2)
    assert said.off_mm == pytest.approx(0.1)
    assert before.seen.offered + after.seen.offered == seen.offered  # none is lost


@pytest.fixture(scope="module")
def clean(record):
    run, truth = record(22, "standstill", rows=60)
    seen = align(run)
    return seen, truth, estimate_one(seen)


def judge_moved(clean, rows, by_mm):
    seen, truth, checked = clean
    assert checked.left_out == ((),)
    assert checked.setup_shifts == ()
    moved = seen.tracker_mm.copy()
    moved[rows] += by_mm * np.array([0.6, -0.64, 0.48])
    found = estimate_one(replace(seen, tracker_mm=moved))
    pair = found.estimate, checked.estimate
    left, usual = (judge_map(each, truth.deviation_mm) for each in pair)
    assert left.inside > 0.85
    return found, left.share / usual.share


@pytest.mark.parametrize("off_um", [20.0, 1000.0])
def test_one_point_that_is_off_is_left_out_and_harmless(clean, off_um):
    found, worse = judge_moved(clean, clean[0].row == POINT, 1e-3 * off_um)
    assert {each.row for each in found.left_out[0]} == {POINT}
    assert worse < 1.15


def test_no_machine_bends_to_follow_a_knock_between_few_points(clean):
    found, worse = judge_moved(clean, clean[0].row >= POINT, 2.0)
    (knock,) = found.setup_shifts
    assert knock.row == POINT
    assert 1e3 * knock.moved_mm == pytest.approx(2000.0, abs=3.0)
    assert worse < 1.3
