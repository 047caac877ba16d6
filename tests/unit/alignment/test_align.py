"""A stream is recognised without a clock, a pose or luck, whole or while it comes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from recorded import nominal_error_mm, record_run, record_small, stream
from recorded import stream as follow
from truepath.alignment import streaming
from truepath.alignment.align import align
from truepath.alignment.observations.reduction import beam_frame
from truepath.alignment.repeated_points import measure_progress
from truepath.alignment.stream.cleaning import detect_valid_samples
from truepath.alignment.streaming import StreamingAlignment
from truepath.errors import AlignmentError
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds.synthetic import ROUGH, Defects, Setting


def with_stream(run, keep=slice(None), **changes):
    return replace(run, tracker=replace(run.tracker.select(keep), **changes))


@pytest.fixture(scope="module")
def usual(record):
    run, truth = record(3)
    return run, truth, align(run)


def test_every_line_of_the_path_is_found_once_without_its_ramps_or_dwells(usual):
    run, truth, seen = usual
    assert [p.row for p in seen.passes] == list(range(1, len(run.commanded)))
    assert np.abs(nominal_error_mm(seen)).max() < 0.2
    recording = truth.recording
    speed = np.linalg.norm(np.gradient(recording.commanded_mm, axis=0), axis=1) * 500.0
    for each in seen.passes:
        feed = run.commanded.feed_mm_min[each.row] / 60.0
        assert np.abs(speed[each.first : each.last] - feed).max() < 0.002 * feed
        assert (recording.row[each.first : each.last] == each.row).all()


def test_cells_know_place_and_approach_and_scatter_as_the_tracker_states(usual):
    run, truth, seen = usual
    true = truth.recording
    for axis in range(3):
        place = np.interp(seen.at.time_s, true.time_s, true.commanded_mm[:, axis])
        # Phase and speed are free: what is left is the machine's error and the pose.
        assert np.abs(place - seen.at.position_mm[:, axis]).max() < 0.25
    # Four parts in a hundred of the simulator's variance are slow, unseen within cells.
    assert seen.scatter == pytest.approx(np.sqrt(0.96) * np.ones(2), abs=0.01)
    step = np.diff(run.commanded.position, axis=0, prepend=0.0)[seen.row]
    step[seen.row == 0] = 0.0  # where the machine stands before its first line
    moved = step != 0.0
    assert (seen.at.approach[moved] == np.sign(step[moved])).all()


def test_standstill_points_are_recognised_in_the_raw_stream(record):
    run, _ = record(4, "standstill", rows=30)
    seen = align(run)
    assert sorted(set(seen.row.tolist())) == list(range(len(run.commanded)))
    assert (seen.at.line == -1).all()
    assert not seen.at.velocity_mm_s.any()
    assert np.abs(nominal_error_mm(seen)).max() < 0.2


def test_lost_frames_breaks_spikes_holds_and_repeats_cost_only_themselves(record):
    clean, _ = record(5, rows=40)
    rough, _ = record(5, rows=40, setting=Setting(defects=ROUGH))
    _, first = np.unique(rough.tracker.device_time_s, return_index=True)
    rough = with_stream(rough, first)
    a, b = align(clean), align(rough)
    # The silence swallows line 7, the broken beam most of line 13.
    steady = {p.row for p in b.passes if p.is_steady}
    assert steady == {p.row for p in a.passes} - {7, 13}
    assert b.used > 0.9 * a.used
    assert np.abs(nominal_error_mm(b)).max() < 0.2


def test_what_repeats_itself_five_times_was_not_measured_what_does_less_was(record):
    run, truth = record(6)
    commanded_mm = truth.recording.commanded_mm
    still = np.linalg.norm(np.gradient(commanded_mm, axis=0), axis=1) == 0.0
    few, many = np.flatnonzero(still & (truth.recording.row == 9))[[5, 20]]
    position_mm = run.tracker.position_mm.copy()
    position_mm[few : few + 5] = position_mm[few]
    position_mm[many : many + 6] = position_mm[many]
    valid = detect_valid_samples(with_stream(run, position_mm=position_mm).tracker)
    assert valid[few : few + 5].all()
    assert not valid[many : many + 6].any()
    assert valid.sum() == detect_valid_samples(run.tracker).sum() - 6


def test_a_missing_standstill_does_not_shift_the_lines_after_it(record):
    run, truth = record(6)
    row = truth.recording.row
    moving = np.linalg.norm(np.gradient(truth.recording.commanded_mm, axis=0), axis=1)
    lost = (row == 9) & (moving == 0.0)
    seen = align(with_stream(run, ~lost))
    rows = [p.row for p in seen.passes]
    assert rows == sorted(rows)
    assert set(range(11, len(run.commanded))) <= set(rows)
    assert np.abs(nominal_error_mm(seen)).max() < 0.2


def test_the_frame_of_the_tracker_does_not_matter(usual, rng):
    run, _, a = usual
    turn = Rotation.random(rng=rng).as_matrix()
    moved = run.tracker.position_mm @ turn.T + [1.0, 2.0, -3.0]
    b = align(with_stream(run, position_mm=moved))
    assert np.allclose(a.at.time_s, b.at.time_s)
    assert np.allclose(a.at.position_mm, b.at.position_mm, atol=1e-3)


def scaled(factor):
    return lambda run: with_stream(run, position_mm=run.tracker.position_mm * factor)


def commanded(change):
    def changed(run):
        position = change(run.commanded.position)
        return replace(run, commanded=replace(run.commanded, position=position))

    return changed


def lost(run):
    return with_stream(run, status=np.ones(len(run.tracker), np.int64))


def stamped_in_ms(run):
    return with_stream(run, device_time_s=run.tracker.device_time_s * 1e3)


def on_one_line(position):
    return np.outer(50.0 + 100.0 * (np.arange(len(position)) % 4), [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (scaled(np.array([1, 1, -1])), "mirror image"),
        (scaled(1e-3), "look like m; convert"),
        (scaled(1 / 25.4), "look like inch; convert"),
        (scaled(1e3), "look like µm; convert"),
        (commanded(lambda rows: rows[::-1]), "has its order"),
        (commanded(np.random.default_rng(1).permutation), "has its order"),
        (commanded(on_one_line), "off the line"),
        (lost, "0 valid samples"),
        (stamped_in_ms, r"steps by 2 at rate_hz 500.*ms"),
    ],
)
def test_what_cannot_be_aligned_is_refused_with_its_cause(usual, change, said):
    with pytest.raises(AlignmentError, match=said):
        align(change(usual[0]))


def test_another_machines_path_is_refused_with_the_causes_that_are_usual(usual, record):
    other, _ = record(11)
    with pytest.raises(AlignmentError, match=r"path\.csv.*machine that errs by more"):
        align(replace(usual[0], commanded=other.commanded))


def moving(rng, n, step_mm=0.1):
    place = np.cumsum(np.full((n, 3), step_mm), axis=0)
    place += 0.004 * rng.normal(size=(n, 3))
    return TrackerSamples(np.arange(n), np.arange(n) / 500.0, place, np.zeros(n, int))


def test_spikes_one_beside_another_and_bad_status_are_not_samples(rng):
    samples = moving(rng, 400, 0.2)
    samples.status[10] = 3
    samples.position_mm[50] += 0.5
    samples.position_mm[60] = np.nan
    samples.position_mm[150] += 0.9
    samples.position_mm[151] += 0.3
    told = replace(samples)  # which says of each whether it has a place
    left_out = np.flatnonzero(~detect_valid_samples(told))
    assert left_out.tolist() == [10, 50, 60, 150, 151]


def test_a_target_between_two_that_are_near_each_other_is_no_burst(rng):
    samples = moving(rng, 12_000, 0.01)
    second = slice(4_000, 8_000)  # for 8 s
    samples.position_mm[second] += [200.0, 0.0, 0.0]
    samples.position_mm[8_000:] += [0.0, 5.0, 0.0]
    change = 5  # samples beside a jump may go
    among = detect_valid_samples(samples, ("T1", "T2", "T3"))
    assert among[second][change:-change].all()
    assert not detect_valid_samples(samples)[second].any()


def test_a_stream_shared_with_another_target_is_cleaned_in_little_time(rng):
    samples = moving(rng, 60_000)
    other = np.arange(60_000) % 8 // 2 == 1
    samples.position_mm[other] += [500.0, -200.0, 100.0]
    assert (detect_valid_samples(samples) == ~other).all()


def test_a_target_that_creeps_is_not_at_a_standstill(record):
    run, _ = record(4, "standstill", rows=30)
    seen = align(run)
    time = run.tracker.device_time_s
    at = seen.at.time_s[seen.row == 7]
    creeping = (time > at[0] - 0.2) & (time < at[-1] + 0.2)
    off = np.where(creeping, 0.2 * (time - at[0]), 0.0)  # mm, far below any feed
    moved = run.tracker.position_mm + off[:, None] * np.array([1.0, 0.0, 0.0])
    slid = align(with_stream(run, position_mm=moved))
    assert set(seen.row.tolist()) - set(slid.row.tolist()) == {7}


def align_both(run):
    live, parts = follow(run)
    return align(run), live.observations(parts)


DWELL = 7  # row of the dwell in which something happens


@pytest.fixture(scope="module")
def standing(record):
    """Return a Run at points, what is seen of it, and the middle of one dwell."""
    run, _ = record(4, "standstill", rows=30)
    seen = align(run)
    return run, seen, float(seen.at.time_s[seen.row == DWELL][0])


@pytest.mark.parametrize("times", [0.5, 2.0], ids=["13 µm", "54 µm"])
def test_of_a_dwell_that_was_knocked_its_longer_side_counts(standing, times):
    run, seen, middle_s = standing
    time_s, knock_s = run.tracker.device_time_s, middle_s + 0.1
    step_mm = times * np.array([0.02, -0.015, 0.01])
    after = (time_s >= knock_s)[:, None]
    knocked = with_stream(run, position_mm=run.tracker.position_mm + after * step_mm)
    for found in align_both(knocked):
        assert found.row.tolist() == seen.row.tolist()
        moved_mm = found.tracker_mm - seen.tracker_mm
        left_mm = moved_mm - (seen.row > DWELL)[:, None] * step_mm
        assert np.linalg.norm(left_mm, axis=1).max() < 0.002
        (said,) = (each for each in found.left_out if each.row == DWELL)
        assert said.begin_s == pytest.approx(knock_s, abs=0.02)
        assert said.off_mm == pytest.approx(np.linalg.norm(step_mm), rel=0.1)


@pytest.mark.parametrize("course", ["swing", "settling", "drift"])
def test_what_moves_slowly_within_dwells_is_no_knock(standing, course):
    run, seen, middle_s = standing
    since_s = np.clip(run.tracker.device_time_s - middle_s, -0.35, 0.35)
    way = {
        "swing": 0.008 * np.sin(2.0 * np.pi / 0.7 * since_s),
        "settling": 0.03 * np.exp(-(since_s + 0.35) / 0.1),
        "drift": 0.03 * since_s,
    }[course][:, None]
    moving = with_stream(run, position_mm=run.tracker.position_mm + way)
    found = align(moving)
    assert found.row.tolist() == seen.row.tolist()
    assert [each for each in found.left_out if each.cause == "cells"] == []


def test_a_dwell_whose_samples_all_lie_apart_gives_no_cell(standing):
    run, seen, middle_s = standing
    k = np.flatnonzero(np.abs(run.tracker.device_time_s - middle_s) < 0.6)
    frame = beam_frame(run.tracker.position_mm[k])
    apart_mm = run.tracker.position_mm.copy()
    apart_mm[k] += 0.1 * (-1.0) ** (k // 3)[:, None] * frame[np.arange(len(k)), k % 3]
    others = np.flatnonzero(seen.row != DWELL)
    for found in align_both(with_stream(run, position_mm=apart_mm)):
        assert found.row.tolist() == seen.row[others].tolist()
        assert found.tracker_mm == pytest.approx(seen.tracker_mm[others], abs=1e-9)


def test_a_hold_in_mid_line_makes_two_passes_of_it(record):
    held = Setting(defects=Defects(holds=((12.0, 1.0),)))
    run, _ = record(8, setting=held)
    rows = [p.row for p in align(run).passes]
    assert len(rows) == len(set(rows)) + 1


@pytest.mark.parametrize("jerk_mm_s3", [4000.0, 2000.0])
def test_standstills_begin_where_soft_ramps_have_ended(record, jerk_mm_s3):
    soft = Setting(limits=Limits(1500.0, jerk_mm_s3))
    seen = align(record(8, rows=30, setting=soft)[0])
    assert sum(each.samples for each in seen.left_out) == 0
    moved = [
        seen.tracker_mm[last - 1] - seen.tracker_mm[first]
        for first, last in seen.lines
        if seen.at.line[first] < 0 and last - first > 1
    ]
    assert len(moved) == 30
    # Noise alone makes 1.2 µm of it.
    assert np.sqrt(np.mean(np.square(moved).sum(axis=1))) < 0.0016


@pytest.mark.parametrize("times", [40.0, 80.0])
def test_all_lines_of_a_machine_that_errs_by_millimetres_are_used_whole(record, times):
    run, truth = record(5, setting=Setting(error_scale=times))
    position = truth.recording.commanded_mm
    assert np.abs(truth.deviation_mm(position[::500])).max() > times / 40.0
    seen = align(run)
    assert seen.measured_rows == set(range(1, len(run.commanded)))
    assert times > 40.0 or "off-line" not in {each.cause for each in seen.left_out}


def test_a_stream_that_loses_its_frame_half_way_is_said_to_be_astray(record):
    run, _ = record(6)
    position = run.tracker.position_mm.copy()
    half = 6 * len(position) // 10
    position[half:, 1] *= -1.0
    seen = align(with_stream(run, position_mm=position))
    astray = [each for each in seen.left_out if each.cause == "astray"]
    assert len(astray) == 1
    assert astray[0].begin_s > run.tracker.device_time_s[half]
    assert astray[0].samples > 0.5 * half
    assert astray[0].off_mm > 10.0


def drive(rows, feed_mm_min, **setting):
    places = np.array(rows, float)
    n = len(places)
    program = Program(places, np.full(n, feed_mm_min / 60.0), np.full(n, 0.4))
    return record_run(load_machine("demo"), program, setting=Setting(**setting))[0]


def test_stamps_in_a_heap_are_left_out_and_named(record):
    run, _ = record(4, rows=12)
    time_s = run.tracker.device_time_s.copy()
    first = len(time_s) // 2
    heap = slice(first, first + 200)
    time_s[heap] = time_s[heap.stop] - 1e-5 * np.arange(200, 0, -1)
    seen = align(with_stream(run, device_time_s=time_s))
    (found,) = (each for each in seen.left_out if each.cause == "stalled")
    assert found.samples == pytest.approx(200, abs=2)
    assert found.end_s == pytest.approx(time_s[heap.stop], abs=0.01)


def test_a_line_too_short_for_its_feed_lacks_nothing():
    rows = [(50, 50, 50), (250, 60, 50), (252, 62, 50), (250, 250, 150), (50, 200, 90)]
    seen = align(drive(rows, 10_000.0))
    assert 2 not in {each.row for each in seen.passes if each.is_steady}
    assert seen.left_out == ()


@pytest.mark.parametrize(("rate_hz", "size_mm"), [(5000.0, 6.0), (50.0, 25.0)])
def test_slow_lines_at_any_rate_are_clean(rate_hz, size_mm):
    corners = np.random.default_rng(4).uniform(0.0, size_mm, (9, 3))
    corners[np.arange(9), np.arange(9) % 3] = 0.0
    corners[1::2] = size_mm - corners[1::2]
    rows = 100.0 + np.round(corners, 3)
    seen = align(drive(rows, 100.0 if rate_hz > 500 else 600.0, rate_hz=rate_hz))
    assert [each.row for each in seen.passes] == list(range(1, 9))
    assert sum(each.samples for each in seen.left_out) <= 2


def test_fast_lines_at_a_low_rate_are_found(record):
    run, _ = record(5, rows=12, feed=3000.0, setting=Setting(rate_hz=50.0))
    assert len(align(run).passes) >= 11


# To and fro along Y, then far away: the first three places are on one line.
PLACES = [
    [10.0, 8.0, 6.0], [10.0, 84.0, 6.0], [10.0, 8.0, 6.0], [436.0, 8.0, 42.0],
    [288.0, 83.0, 294.0], [60.0, 300.0, 200.0], [400.0, 250.0, 60.0],
]  # fmt: skip


def test_an_interrupted_run_goes_on_behind_its_last_whole_line(record):
    n = len(PLACES)
    program = Program(np.array(PLACES), np.full(n, 100.0), np.full(n, 0.5))
    run, _ = record(3, program=program)
    whole = align(run)

    def cut(row):
        """Return the Run as it is if it ends late within a line."""
        mine = (whole.row == row) & (whole.at.line >= 0)
        end_s = np.quantile(whole.at.time_s[mine], 0.9)
        return with_stream(run, np.flatnonzero(run.tracker.device_time_s < end_s))

    assert measure_progress(cut(5)).next_row == 5
    align(cut(3))  # the line that was cut short tells the pose, and is driven again
    with pytest.raises(AlignmentError, match="was driven lies on one straight line"):
        measure_progress(cut(3))


STEP_S, NOWHERE = 0.002, np.empty((0, 3))


def surrounded(run, before=NOWHERE, after=NOWHERE):
    tracker = run.tracker
    early_s = tracker.device_time_s[0] - STEP_S * np.arange(len(before), 0, -1)
    late_s = tracker.device_time_s[-1] + STEP_S * np.arange(1, len(after) + 1)
    time_s = np.concatenate([early_s, tracker.device_time_s, late_s])
    position = np.concatenate([before, tracker.position_mm, after])
    status = np.pad(tracker.status, (len(before), len(after)))
    samples = TrackerSamples(np.arange(len(status)), time_s, position, status)
    return replace(run, tracker=samples)


def test_a_path_driven_twice_is_still_aligned(record):
    run, _ = record(6)
    seen = align(surrounded(run, after=run.tracker.position_mm))
    assert np.abs(nominal_error_mm(seen)).max() < 0.2
    assert len(seen.passes) >= len(run.commanded) - 1


def test_a_recording_that_starts_late_or_ends_early_keeps_what_it_has(record):
    run, truth = record(6)
    since_s = truth.recording.time_s - truth.recording.time_s[0]
    for late_s in (0.0, 3.0, 11.0):
        seen = align(with_stream(run, since_s > late_s))
        assert np.abs(nominal_error_mm(seen)).max() < 0.2
        assert len(seen.passes) > 12
    usual = rows(run)
    for share in (0.55, 0.8):
        found = rows(with_stream(run, slice(int(share * len(run.tracker)))))
        assert found == usual[: len(found)]
        assert len(found) >= int(share * len(usual)) - 2


def carried_by_hand(rng, to_mm, count=4000):
    """A reflector carried from its nest, where it lay for ten seconds."""
    way = np.cumsum(np.cumsum(rng.normal(size=(count, 3)), axis=0), axis=0)
    way *= 400.0 / np.abs(way).max()
    way += to_mm - way[-1]
    nest = way[:1] + rng.normal(0.0, 0.003, (5000, 3))
    return np.concatenate([nest, way])


def driven(rng, start_mm, end_mm, count=3000):
    """The machine drives a line that is not of the path, and stands at its end."""
    share = np.concatenate([np.linspace(0.0, 1.0, count), np.ones(1500)])
    way = start_mm + share[:, None] * (end_mm - start_mm)
    return way + rng.normal(0.0, 0.003, way.shape)


def rows(run):
    return [p.row for p in align(run).passes]


def test_what_comes_before_and_after_is_no_part_of_the_path(record, rng):
    """A reflector carried to the spindle and back; the way to the start and home."""
    run, _ = record(6)
    usual, position = rows(run), run.tracker.position_mm
    before = carried_by_hand(rng, position[0])
    after = carried_by_hand(rng, position[-1])[::-1]
    assert rows(surrounded(run, before, after)) == usual
    home = position.mean(axis=0)
    before = driven(rng, home, position[0])
    after = driven(rng, position[-1], home)
    assert rows(surrounded(run, before, after)) == usual
    still = run.tracker.position_mm[:1] + rng.normal(0.0, 0.003, (100_000, 3))
    assert rows(surrounded(run, still)) == usual


def test_two_rows_that_were_swapped_cost_only_their_own_lines(record):
    run, _ = record(6)
    order = np.arange(len(run.commanded))
    order[[10, 11]] = order[[11, 10]]
    wrong = replace(run.commanded, position=run.commanded.position[order])
    seen = align(replace(run, commanded=wrong))
    assert {p.row for p in seen.passes} >= set(rows(run)) - {10, 11, 12}
    assert np.abs(nominal_error_mm(seen)).max() < 0.2


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


def test_what_lies_beside_a_commanded_line_is_the_error_of_the_machine(
    record, rigid_free
):
    run, truth = record(3, setting=Setting(noise_scale=0.0))
    live, parts = stream(run)
    seen = live.observations(parts)
    places, rows = live.locate_rows(), run.commanded.position
    error = rigid_free(rows, truth.deviation_mm(rows))
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
