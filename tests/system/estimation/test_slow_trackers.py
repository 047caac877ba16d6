"""Standstill points by trackers that stream slowly or are polled, and live."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimating import estimate, judge_map
from following import compare_tables, follow, list_point_blocks
from recorded import load_small, record_run, with_samples
from truepath.alignment.align import align
from truepath.alignment.streaming import PointAlignment
from truepath.errors import AlignmentError
from truepath.files.bundle.run import PointRows
from truepath.results.result_assessment import assess_live
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths

ROWS = 40


@cache
def slowly(seed):
    content = load_small("demo")
    content["tracker"]["rate_hz"] = 5.0
    program = paths.standstill_points(parse_machine(content), seed, 60, dwell_s=2.0)
    return record_run(content, program, seed, "standstill")


def judge(run, recording):
    return judge_map(estimate(align(run)), recording.truth.deviation_mm)


@pytest.fixture(scope="module")
def polled():
    run, recording = slowly(2)
    away = np.abs(recording.commanded_mm - run.commanded.position[recording.row])
    stands = away.max(axis=1) < 1e-9
    n, shots = np.arange(len(run.commanded)), []
    for row in n:
        own = np.flatnonzero(stands & (recording.row == row))[1:-1]
        shots.append((recording.time_s[own], recording.position_mm[own]))
    time_s, place = (np.array([x[k].mean(axis=0) for x in shots]) for k in (0, 1))
    spread = np.array([np.cov(place_mm.T) for _, place_mm in shots])
    points = PointRows(n, np.array([len(one) for one, _ in shots]), spread)
    samples = TrackerSamples(n, time_s, place, np.zeros_like(n))
    return replace(run, tracker=samples, points=points)


def test_a_stream_of_5_hz_and_points_of_a_polled_tracker_find_the_map(polled):
    left = judge(*slowly(1))
    assert left.share < 0.15
    assert 0.85 < left.inside <= 1.0
    left = judge(polled, slowly(2)[1])
    assert left.share < 0.12
    assert 0.85 < left.inside <= 1.0


def test_means_without_a_covariance_say_nothing_of_scatter(polled):
    unknown = np.zeros_like(polled.points.covariance_mm2)
    blind = replace(polled.points, covariance_mm2=unknown)
    assert np.isnan(align(replace(polled, points=blind)).scatter).all()
    assert align(polled).scatter == pytest.approx([1.0, 1.0], abs=0.15)


def test_points_are_told_by_their_row_each_time_they_are_measured(polled):
    row = polled.points.row.copy()
    row[[10, 40]] = row[[40, 10]]
    seen = align(replace(polled, points=replace(polled.points, row=row)))
    astray = {each.row for each in seen.left_out if each.cause == "astray"}
    missing = {each.row for each in seen.left_out if each.cause == "no-stop"}
    assert astray == missing == {10, 40}
    assert not np.isin(seen.row, [10, 40]).any()
    twice = np.insert(np.arange(len(polled.tracker)), 21, 20)
    told = polled.points.row, polled.points.count, polled.points.covariance_mm2
    points = PointRows(*(column[twice] for column in told))
    samples = polled.tracker.select(twice)
    twice_seen = align(replace(polled, tracker=samples, points=points))
    assert (twice_seen.row == 20).sum() == 2
    assert not twice_seen.left_out


def test_metres_are_refused_by_name(polled):
    metres = replace(polled.tracker, position_mm=1e-3 * polled.tracker.position_mm)
    with pytest.raises(AlignmentError, match="look like m; convert them to mm"):
        align(replace(polled, tracker=metres))


@pytest.fixture(scope="module")
def shots(record):
    run, _ = record(31, "standstill", rows=ROWS)
    seen = align(run)
    row, one = np.unique(seen.row, return_index=True)
    n, time_s = len(row), seen.at.time_s[one]
    place, status = seen.tracker_mm[one], np.zeros(n, np.int64)
    samples = TrackerSamples(np.arange(n), time_s, place, status)
    points = PointRows(row, seen.count[one].astype(np.int64), np.zeros((n, 3, 3)))
    return replace(run, tracker=samples, points=points)


def follow_points(run):
    followed = follow(run, blocks=list_point_blocks(run))
    return followed.on_the_way, followed.last


def move(run, first, last, by_mm):
    moved = run.tracker.position_mm.copy()
    moved[first:last] += by_mm
    return with_samples(run, position_mm=moved)


def test_tables_tighten_point_by_point_and_end_where_the_batch_does(shots):
    on_the_way, last = follow_points(shots)
    sigma = [now.volumetric_sigma_mm for now in on_the_way]
    assert len(sigma) > 0.8 * ROWS
    assert sigma[0] > 3 * sigma[-1]
    assert last.done == len(shots.tracker)
    assert assess_live(last.check, last.done).state == "usable"
    off = compare_tables(last, estimate(align(shots)))
    assert np.abs(off).max() < 1.0


def test_points_after_a_knock_that_are_at_no_place_of_theirs_are_told(shots):
    run = move(shots, 25, None, [0.0, 3.0, 0.0])
    on_the_way, last = follow_points(run)
    verdicts = [assess_live(now.check, now.done) for now in [*on_the_way, last]]
    told = [r for v in verdicts for r in v.reasons if r.kind == "stream-astray"]
    assert len(told) > 0.5 * (len(shots.tracker) - 25)
    assert {reason.values["line"] for reason in told} == {int(run.points.row[25])}
    assert told[-1].values["distance_um"] == pytest.approx(3000.0, abs=100.0)
    assert verdicts[-1].state == "doubtful"


def test_points_astray_are_left_out_and_said_the_first_as_well(shots):
    aligned = PointAlignment(shots.machine, shots.commanded)
    parts = []
    for block in list_point_blocks(move(shots, 20, 21, [0.0, 30.0, 0.0])):
        parts += aligned.add(block)
    rows = shots.points.row
    assert [part.row for part in parts] == [row for row in rows if row != rows[20]]
    said = aligned.observations(parts).left_out
    assert [(x.cause, x.row) for x in said] == [("astray", rows[20])]
    on_the_way, last = follow_points(move(shots, 1, 2, [0.0, 0.0, 40.0]))
    assert len(on_the_way) > 0.7 * ROWS
    assert last.done == len(shots.tracker) - 1
