"""What is recognised while the samples come is what the whole Run says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recorded import record_small, stream
from truepath.alignment import streaming
from truepath.alignment.align import align
from truepath.alignment.streaming import StreamingAlignment
from truepath.errors import AlignmentError
from truepath_simulators.worlds.synthetic import ROUGH, Defects, Setting


def assert_same_cells(a, b, *, place_mm=0.02):
    assert len(a) == len(b)
    assert np.allclose(a.at.time_s, b.at.time_s, atol=1e-9)
    assert np.allclose(a.tracker_mm, b.tracker_mm, atol=1e-9)
    assert (a.row == b.row).all()
    assert (a.at.line == b.at.line).all()
    assert (a.at.approach == b.at.approach).all()
    assert np.abs(a.at.position_mm - b.at.position_mm).max() < place_mm


@pytest.mark.parametrize(
    ("seed", "mode", "kind"),
    [
        (5, "otf", {"rows": 16}),
        (4, "standstill", {"rows": 20}),
        (27, "otf", {"corners": True}),
    ],
    ids=["lines", "standstills", "corner to corner"],
)
def test_short_blocks_give_the_cells_of_the_whole_run(record, seed, mode, kind):
    run, _ = record(seed, mode, **kind)
    live, parts = stream(run)
    assert_same_cells(live.observations(parts), align(run))


@given(sizes=st.lists(st.integers(1, 600), min_size=1, max_size=6))
@settings(deadline=None, max_examples=5)
def test_how_the_stream_is_cut_into_blocks_does_not_matter(sizes):
    run, _ = record_small(3)
    live, parts = stream(run, [s + 20 for s in sizes])
    assert_same_cells(live.observations(parts), align(run))


def feed(run, tracker=None):
    """Give a stream in blocks of a tenth of a second; tell what came of each."""
    live = StreamingAlignment(run.machine, run.commanded)
    tracker = tracker or run.tracker
    for begin in range(0, len(tracker), 50):
        block = tracker.select(slice(begin, begin + 50))
        yield live, live.add(block), block.device_time_s[-1]


def test_a_line_is_handed_on_as_soon_as_the_machine_stands_at_its_end(record):
    """And samples are kept for a line or so, however long the Run."""
    run, _ = record(3)
    seen, most = {}, 0
    for live, parts, now_s in feed(run):
        lines = [part for part in parts if part.line >= 0]
        seen |= {part.row: now_s - part.cells.time_s[-1] for part in lines}
        most = max(most, live.samples_kept)
    late = [delay for row, delay in seen.items() if row > 5]
    assert len(late) > 10
    assert max(late) < 1.5
    assert most < 0.4 * len(run.tracker)


def beside(points, begin, end):
    """Return by which vectors points lie beside the line through two places."""
    along = (end - begin) / np.linalg.norm(end - begin)
    off = points - begin
    return off - np.outer(off @ along, along)


def less_rigid(points, at):
    """Return vectors at places without the small rigid motion of least squares."""
    turns = [np.cross(axis, at) for axis in np.eye(3)]
    columns = [np.tile(axis, (len(at), 1)) for axis in np.eye(3)] + turns
    basis = np.stack([column.ravel() for column in columns], axis=1)
    share = np.linalg.lstsq(basis, points.ravel(), rcond=None)[0]
    return points - (basis @ share).reshape(-1, 3)


def test_what_lies_beside_a_commanded_line_is_the_error_of_the_machine(record):
    run, truth = record(3, setting=Setting(noise_scale=0.0))
    live, parts = stream(run)
    seen = live.observations(parts)
    places, rows = live.locate_rows(), run.commanded.position
    error = less_rigid(truth.deviation_mm(rows), rows)
    assert np.abs(error).max() > 0.005
    frame = truth.recording.pose.rotation
    for row in (5, 9, 14):
        ends, line = slice(row - 1, row + 1), (row - 1, row)
        points = seen.tracker_mm[seen.row == row][[0, -1]]
        found = beside(points, *places[list(line)])
        told = beside(rows[ends] + error[ends], *rows[list(line)]) @ frame
        assert np.abs(found - told).max() < 0.001


def test_lost_frames_breaks_spikes_and_holds_cost_no_more_than_in_the_whole_run(record):
    run, _ = record(5, rows=40, setting=Setting(defects=ROUGH))
    _, first = np.unique(run.tracker.device_time_s, return_index=True)
    run = replace(run, tracker=run.tracker.select(first))
    live, parts = stream(run)
    a, b = live.observations(parts), align(run)
    assert {p.row for p in a.passes} == {p.row for p in b.passes}
    assert a.used > 0.98 * b.used


def test_samples_that_wait_for_a_stop_in_vain_are_let_go(record, monkeypatch):
    monkeypatch.setattr(streaming, "_MOST_KEPT_S", 4.0)
    run, _ = record(3)
    assert run.machine.tracker.rate_hz == 500.0
    live = StreamingAlignment(run.machine, run.commanded)
    for _ in range(20):
        moving = run.tracker.select(slice(600, 900))  # in the middle of a line
        live.add(moving)
        assert live.samples_kept <= 2000


def test_another_machines_path_gives_no_pose_and_no_lines(record):
    run, _ = record(3, rows=14)
    other, _ = record(11, rows=14)
    live, parts = stream(replace(run, commanded=other.commanded))
    assert parts == []
    with pytest.raises(AlignmentError, match="pose"):
        live.observations(parts)


def test_holds_on_the_way_are_not_astray(record):
    holds = tuple((begin_s, 1.0) for begin_s in (61.0, 63.0, 65.0))
    paused, most = Setting(defects=Defects(holds=holds)), 0
    for live, _, _ in feed(record(8, rows=14, feed=2500.0, setting=paused)[0]):
        if live.pose is not None:
            most = max(most, len(live._stream.stops) - 1 - live._matched[-1][0])
        assert live.list_unmatched() == ()
    assert most >= 3  # they have been seen


def test_places_that_are_too_far_ahead_to_be_known_are_not_astray(record):
    run, _ = record(31, rows=32)
    seen = align(run)
    first, last = (seen.at.time_s[seen.row == row] for row in (12, 19))
    time_s = run.tracker.device_time_s
    kept = (time_s < first.min() - 1.0) | (time_s > last.max())
    for live, _, _ in feed(run, run.tracker.select(np.flatnonzero(kept))):
        assert live.list_unmatched() == ()
    assert len(live._stream.stops) - live._matched[-1][0] > 5


def test_what_was_astray_stays_said_where_places_are_known_again(record):
    run, _ = record(31, rows=32)
    place_mm, time_s = run.tracker.position_mm.copy(), run.tracker.device_time_s
    seen = align(run)
    first, last = (seen.at.time_s[seen.row == row] for row in (12, 15))
    away = (time_s > first.min()) & (time_s < last.max())
    place_mm[away] += [3.0, -2.0, 4.0]
    *_, (live, _, _) = feed(run, replace(run.tracker, position_mm=place_mm))
    (one,) = live.list_unmatched()
    assert one.row in (12, 13)
    assert first.min() - 1.0 < one.begin_s < one.end_s < last.max() + 1.0
    assert one.off_mm > 2.0
