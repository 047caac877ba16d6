"""Points of a tracker that is polled: their tables tighten while they are measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate
from truepath.alignment.align import align
from truepath.alignment.point_alignment import PointAlignment
from truepath.estimation.live.live import LiveEstimator
from truepath.files.bundle.run import PointBlock, PointRows, Run
from truepath.results.error_tables import build_error_tables
from truepath.results.verdict import judge_live
from truepath_drivers.interfaces.records import TrackerSamples

ROWS = 40


@pytest.fixture(scope="module")
def polled(record) -> Run:
    """Return standstills of a stream as a polled tracker would have measured them."""
    run, _ = record(31, "standstill", rows=ROWS)
    seen = align(run)
    row, one = np.unique(seen.row, return_index=True)
    n, time_s = len(row), seen.at.time_s[one]
    samples = TrackerSamples(
        np.arange(n), time_s, seen.tracker_mm[one], np.zeros(n, np.int64)
    )
    points = PointRows(row, seen.count[one].astype(np.int64), np.zeros((n, 3, 3)))
    return replace(run, tracker=samples, points=points)


def list_blocks(run: Run) -> list[PointBlock]:
    points = run.points
    return [
        PointBlock(
            run.tracker.select(slice(k, k + 1)),
            PointRows(
                points.row[k : k + 1],
                points.count[k : k + 1],
                points.covariance_mm2[k : k + 1],
            ),
        )
        for k in range(len(run.tracker))
    ]


def follow(run: Run):
    live, on_the_way = LiveEstimator(run.machine, run.commanded), []
    for block in list_blocks(run):
        if live.take(block):
            on_the_way.append(live.estimate())
    live.finish()
    return on_the_way, live.estimate()


def test_tables_tighten_point_by_point_and_end_where_the_batch_does(polled):
    on_the_way, last = follow(polled)
    sigma = [now.volumetric_sigma_mm for now in on_the_way]
    assert len(sigma) > 0.8 * ROWS
    assert sigma[0] > 3 * sigma[-1]
    assert last.done == len(polled.tracker)
    assert judge_live(last.check, last.done).state == "usable"
    batch = build_error_tables(estimate(align(polled)))
    tables = build_error_tables(last)
    off = np.concatenate(
        [
            (tables.table(t.symbol).value - t.value) / np.maximum(t.uncertainty, 0.05)
            for t in batch.tables
        ]
    )
    assert np.abs(off).max() < 1.0


def test_points_after_a_knock_that_are_at_no_place_of_theirs_are_told(polled):
    knocked = polled.tracker.position_mm.copy()
    knocked[25:] += [0.0, 3.0, 0.0]
    run = replace(polled, tracker=replace(polled.tracker, position_mm=knocked))
    on_the_way, last = follow(run)
    told = [
        reason
        for now in [*on_the_way, last]
        for reason in judge_live(now.check, now.done).reasons
        if reason.kind == "stream-astray"
    ]
    assert len(told) > 0.5 * (len(knocked) - 25)
    assert {reason.values["line"] for reason in told} == {int(run.points.row[25])}
    assert told[-1].values["distance_um"] == pytest.approx(3000.0, abs=100.0)
    assert judge_live(last.check, last.done).state == "doubtful"


def test_points_astray_are_left_out_and_said(polled):
    astray = polled.tracker.position_mm.copy()
    astray[20] += [0.0, 30.0, 0.0]
    tracker = replace(polled.tracker, position_mm=astray)
    aligned = PointAlignment(polled.machine, polled.commanded)
    parts = []
    for block in list_blocks(replace(polled, tracker=tracker)):
        parts += aligned.add(block)
    rows = [part.row for part in parts]
    assert rows == [
        int(row) for row in polled.points.row if row != polled.points.row[20]
    ]
    said = aligned.observations(parts).left_out
    assert [(x.cause, x.row) for x in said] == [("astray", polled.points.row[20])]


def test_a_first_point_astray_is_no_reason_to_say_nothing(polled):
    astray = polled.tracker.position_mm.copy()
    astray[1] += [0.0, 0.0, 40.0]
    tracker = replace(polled.tracker, position_mm=astray)
    on_the_way, last = follow(replace(polled, tracker=tracker))
    assert len(on_the_way) > 0.7 * ROWS
    assert last.done == len(polled.tracker) - 1
