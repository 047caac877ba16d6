"""Standstill points by trackers that stream slowly or are polled, against truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.conftest import Truth, _run
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointRows
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.analysis import analyse
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic


@pytest.fixture(scope="module")
def slowly():
    """Make a standstill recording of 60 points at 5 Hz, dwell 2 s."""

    def made(seed, **figures):
        content = dict(load_machine("demo"))
        content["tracker"] = {**content["tracker"], "rate_hz": 5.0, **figures}
        machine = parse_machine(content)
        program = paths.standstill_points(machine, seed, 60, dwell_s=2.0)
        setting = synthetic.Setting(rate_hz=5.0)
        recording = synthetic.record(content, program, seed, "standstill", setting)
        return _run(recording), Truth(recording)

    return made


@pytest.fixture(scope="module")
def judge(rigid_free, volume, at_rest):
    """Return (share of the error left, share of truth inside 2u)."""

    def judged(run, truth):
        result = estimate(align(run))
        q = volume(run.machine)
        at, maps = at_rest(run.machine, q), build_volumetric_map(result.model)
        before = rigid_free(q, truth.deviation_mm(q))
        left = before - rigid_free(q, maps.error_mm(at, result.theta))
        inside = np.abs(left) < 2 * maps.sigma_mm(at, result.covariance)
        share = np.linalg.norm(left, axis=1).mean()
        return share / np.linalg.norm(before, axis=1).mean(), float(inside.mean())

    return judged


def poll(run, truth):
    """Return the Run as a tracker leaves it that measures point by point."""
    recording = truth.recording
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


def test_a_stream_of_5_hz_with_dwells_of_2_s_finds_the_map(slowly, judge):
    share, inside = judge(*slowly(1))
    assert share < 0.15
    assert 0.85 < inside <= 1.0


def test_points_of_a_polled_tracker_find_the_map(slowly, judge):
    run, truth = slowly(2)
    share, inside = judge(poll(run, truth), truth)
    assert share < 0.12
    assert 0.85 < inside <= 1.0


def test_means_without_a_covariance_stand_on_the_trackers_own_figures(slowly):
    run, truth = slowly(2)
    polled = poll(run, truth)
    blind = replace(
        polled.points, covariance_mm2=np.zeros_like(polled.points.covariance_mm2)
    )
    assert align(replace(polled, points=blind)).scatter.tolist() == [1.0, 1.0]
    assert align(polled).scatter == pytest.approx([1.0, 1.0], abs=0.15)


def test_points_that_are_not_where_their_row_is_are_left_out_and_named(slowly):
    polled = poll(*slowly(2))
    row = polled.points.row.copy()
    row[[10, 40]] = row[[40, 10]]
    seen = align(replace(polled, points=replace(polled.points, row=row)))
    astray = {each.row for each in seen.left_out if each.cause == "astray"}
    missing = {each.row for each in seen.left_out if each.cause == "no-stop"}
    assert astray == missing == {10, 40}
    assert not np.isin(seen.row, [10, 40]).any()


def test_a_point_measured_twice_counts_twice(slowly):
    polled = poll(*slowly(2))
    twice = np.insert(np.arange(len(polled.tracker)), 21, 20)
    points = PointRows(
        polled.points.row[twice],
        polled.points.count[twice],
        polled.points.covariance_mm2[twice],
    )
    seen = align(replace(polled, tracker=polled.tracker.select(twice), points=points))
    assert (seen.row == 20).sum() == 2
    assert not seen.left_out


def test_metres_are_refused_by_name(slowly):
    polled = poll(*slowly(2))
    metres = replace(polled.tracker, position_mm=1e-3 * polled.tracker.position_mm)
    with pytest.raises(AlignmentError, match="look like m; convert them to mm"):
        align(replace(polled, tracker=metres))


@pytest.mark.long
def test_a_reflector_that_moved_is_told_and_solved_with_both_places(slowly):
    moved = move(poll(*slowly(2)), np.arange(34, 68), [0.3, 0.1, 0.0])
    found = analyse(moved)
    kinds = {reason.kind for reason in found.verdict.reasons}
    assert "set-up-moved" in kinds
    assert found.verdict.state == "usable"


@pytest.mark.long
def test_a_point_whose_reflector_was_knocked_and_came_back_is_left_out(slowly):
    seen = analyse(move(poll(*slowly(2)), [20], [0.2, 0.0, 0.0]))
    assert [reason.values["line"] for reason in seen.verdict.reasons] == [20]
