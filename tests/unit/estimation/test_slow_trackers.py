"""Standstill points by trackers that stream slowly or are polled, against truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimating import estimate, judge_map
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointRows
from truepath.results.analysis import analyse
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths


@cache
def slowly(seed):
    """Make a standstill recording of 60 points at 5 Hz, dwell 2 s."""
    content = load_small("demo")
    content["tracker"]["rate_hz"] = 5.0
    program = paths.standstill_points(parse_machine(content), seed, 60, dwell_s=2.0)
    return record_run(content, program, seed, "standstill")


def judge(run, recording):
    return judge_map(estimate(align(run)), recording.truth.deviation_mm)


def poll(run, recording):
    """Return the Run as a tracker leaves it that measures point by point."""
    away = np.abs(recording.commanded_mm - run.commanded.position[recording.row])
    stands = away.max(axis=1) < 1e-9
    place, time_s, count, spread = [], [], [], []
    for row in range(len(run.commanded)):
        shots = np.flatnonzero(stands & (recording.row == row))[1:-1]
        place.append(recording.position_mm[shots].mean(axis=0))
        time_s.append(recording.time_s[shots].mean())
        count.append(len(shots))
        spread.append(np.cov(recording.position_mm[shots].T))
    n = len(place)
    status = np.zeros(n, np.int64)
    samples = TrackerSamples(np.arange(n), np.array(time_s), np.array(place), status)
    points = PointRows(np.arange(n), np.array(count), np.array(spread))
    return replace(run, tracker=samples, points=points)


def move(run, rows, shift_mm):
    """Return a polled Run whose reflector moved before some of its points."""
    position = run.tracker.position_mm.copy()
    position[rows] += shift_mm
    return replace(run, tracker=replace(run.tracker, position_mm=position))


@pytest.fixture(scope="module")
def polled():
    return poll(*slowly(2))


def test_a_stream_of_5_hz_with_dwells_of_2_s_finds_the_map():
    left = judge(*slowly(1))
    assert left.share < 0.15
    assert 0.85 < left.inside <= 1.0


def test_points_of_a_polled_tracker_find_the_map(polled):
    left = judge(polled, slowly(2)[1])
    assert left.share < 0.12
    assert 0.85 < left.inside <= 1.0


def test_means_without_a_covariance_say_nothing_of_scatter(polled):
    unknown = np.zeros_like(polled.points.covariance_mm2)
    blind = replace(polled.points, covariance_mm2=unknown)
    assert np.isnan(align(replace(polled, points=blind)).scatter).all()
    assert align(polled).scatter == pytest.approx([1.0, 1.0], abs=0.15)


def test_points_that_are_not_where_their_row_is_are_left_out_and_named(polled):
    row = polled.points.row.copy()
    row[[10, 40]] = row[[40, 10]]
    seen = align(replace(polled, points=replace(polled.points, row=row)))
    astray = {each.row for each in seen.left_out if each.cause == "astray"}
    missing = {each.row for each in seen.left_out if each.cause == "no-stop"}
    assert astray == missing == {10, 40}
    assert not np.isin(seen.row, [10, 40]).any()


def test_a_point_measured_twice_counts_twice(polled):
    twice = np.insert(np.arange(len(polled.tracker)), 21, 20)
    points = PointRows(
        polled.points.row[twice],
        polled.points.count[twice],
        polled.points.covariance_mm2[twice],
    )
    seen = align(replace(polled, tracker=polled.tracker.select(twice), points=points))
    assert (seen.row == 20).sum() == 2
    assert not seen.left_out


def test_metres_are_refused_by_name(polled):
    metres = replace(polled.tracker, position_mm=1e-3 * polled.tracker.position_mm)
    with pytest.raises(AlignmentError, match="look like m; convert them to mm"):
        align(replace(polled, tracker=metres))


@pytest.mark.long
def test_a_reflector_that_moved_is_told_and_solved_with_both_places(polled):
    moved = move(polled, np.arange(34, 68), [0.1, 0.03, 0.0])
    found = analyse(moved)
    kinds = {reason.kind for reason in found.verdict.reasons}
    assert "set-up-moved" in kinds
    assert found.verdict.state == "usable"


@pytest.mark.long
def test_a_point_whose_reflector_was_knocked_and_came_back_is_left_out(polled):
    seen = analyse(move(polled, [20], [0.2, 0.0, 0.0]))
    assert [reason.values["line"] for reason in seen.verdict.reasons] == [20]
