"""A stream is recognised without a clock, a pose or luck."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.alignment.align import align
from truepath.alignment.stream.cleaning import find_valid_samples
from truepath.errors import AlignmentError
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.motion.profile import Limits
from truepath_simulators.worlds.synthetic import ROUGH, Defects, Setting


def nominal_error_mm(seen):
    """How far cells lie from their nominal place, in the workpiece frame."""
    return seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm


def with_stream(run, keep=slice(None), **changes):
    return replace(run, tracker=replace(run.tracker.select(keep), **changes))


@pytest.fixture(scope="module")
def usual(record):
    """Return a Run, its truth, and what is seen of it."""
    run, truth = record(3)
    return run, truth, align(run)


def test_every_line_of_the_path_is_found_once(usual):
    run, _, seen = usual
    assert [p.row for p in seen.passes] == list(range(1, len(run.commanded)))
    assert np.abs(nominal_error_mm(seen)).max() < 0.2


def test_passes_hold_nothing_of_ramps_or_dwells(usual):
    run, truth, seen = usual
    recording = truth.recording
    speed = np.linalg.norm(np.gradient(recording.commanded_mm, axis=0), axis=1) * 500.0
    for each in seen.passes:
        feed = run.commanded.feed_mm_min[each.row] / 60.0
        assert np.abs(speed[each.first : each.last] - feed).max() < 0.002 * feed
        assert (recording.row[each.first : each.last] == each.row).all()


def test_cells_know_their_place_and_scatter_as_the_tracker_states(usual):
    _, truth, seen = usual
    true = truth.recording
    for axis in range(3):
        place = np.interp(seen.at.time_s, true.time_s, true.commanded_mm[:, axis])
        # Phase and speed are free: what is left is the machine's error and the pose.
        assert np.abs(place - seen.at.position_mm[:, axis]).max() < 0.25
    # Four parts in a hundred of the simulator's variance are slow, unseen within cells.
    assert seen.scatter == pytest.approx(np.sqrt(0.96) * np.ones(2), abs=0.01)


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


@pytest.mark.parametrize("late_s", [0.0, 3.0, 11.0])
def test_a_recording_that_starts_late_keeps_what_it_has(record, late_s):
    run, truth = record(6)
    late = truth.recording.time_s - truth.recording.time_s[0] > late_s
    seen = align(with_stream(run, late))
    assert np.abs(nominal_error_mm(seen)).max() < 0.2
    assert len(seen.passes) > 12


def test_the_frame_of_the_tracker_does_not_matter(usual, rng):
    run, _, a = usual
    turn = Rotation.random(rng=rng).as_matrix()
    moved = with_stream(
        run, position_mm=run.tracker.position_mm @ turn.T + [1.0, 2.0, -3.0]
    )
    b = align(moved)
    assert np.allclose(a.at.time_s, b.at.time_s)
    assert np.allclose(a.at.position_mm, b.at.position_mm, atol=1e-3)


def test_a_left_handed_stream_is_refused_as_such(usual):
    run = usual[0]
    mirrored = with_stream(run, position_mm=run.tracker.position_mm * [1, 1, -1])
    with pytest.raises(AlignmentError, match="mirror image"):
        align(mirrored)


def test_another_machines_path_is_refused_with_the_causes_that_are_usual(usual, record):
    other, _ = record(11)
    with pytest.raises(AlignmentError, match=r"path\.csv.*machine that errs by more"):
        align(replace(usual[0], commanded=other.commanded))


def test_the_order_of_lines_decides(usual, rng):
    run, n = usual[0], len(usual[0].commanded)
    for order in (np.arange(n)[::-1], rng.permutation(n)):
        other = replace(run.commanded, position=run.commanded.position[order])
        with pytest.raises(AlignmentError, match="has its order"):
            align(replace(run, commanded=other))


def test_a_path_on_one_line_is_refused_with_the_remedy(usual):
    run, n = usual[0], len(usual[0].commanded)
    flat = np.zeros((n, 3))
    flat[:, 0] = 50.0 + 100.0 * (np.arange(n) % 4)
    with pytest.raises(AlignmentError, match="off the line"):
        align(replace(run, commanded=replace(run.commanded, position=flat)))


def test_a_stream_without_valid_samples_says_so(usual):
    run = usual[0]
    dead = with_stream(run, status=np.ones(len(run.tracker), np.int64))
    with pytest.raises(AlignmentError, match="0 valid samples"):
        align(dead)


def test_a_path_driven_twice_is_still_aligned(record):
    run, _ = record(6)
    n, tracker = len(run.tracker), run.tracker
    step = tracker.device_time_s[-1] - tracker.device_time_s[0] + 0.002
    twice = TrackerSamples(
        np.arange(2 * n),
        np.concatenate([tracker.device_time_s, tracker.device_time_s + step]),
        np.concatenate([tracker.position_mm, tracker.position_mm]),
        np.concatenate([tracker.status, tracker.status]),
    )
    seen = align(replace(run, tracker=twice))
    assert np.abs(nominal_error_mm(seen)).max() < 0.2
    assert len(seen.passes) >= len(run.commanded) - 1


def moving(rng, n, step_mm=0.1):
    """Return samples at 500 Hz on a straight way."""
    position = np.cumsum(np.full((n, 3), step_mm), axis=0)
    position += 0.004 * rng.normal(size=(n, 3))
    return TrackerSamples(
        np.arange(n), np.arange(n) / 500.0, position, np.zeros(n, np.int64)
    )


def list_left_out(samples):
    told = replace(samples)  # which says of each whether it has a place
    return np.flatnonzero(~find_valid_samples(told)).tolist()


def test_spikes_and_bad_status_are_not_samples(rng):
    samples = moving(rng, 400, 0.2)
    samples.status[10] = 3
    samples.position_mm[50] += 0.5
    samples.position_mm[60] = np.nan
    assert list_left_out(samples) == [10, 50, 60]


def test_a_spike_beside_a_larger_one_is_no_sample_either(rng):
    samples = moving(rng, 400, 0.2)
    samples.position_mm[50] += 0.9
    samples.position_mm[51] += 0.3
    assert list_left_out(samples) == [50, 51]


def test_a_target_between_two_that_are_near_each_other_is_no_burst(rng):
    samples = moving(rng, 12_000, 0.01)
    second = slice(4_000, 8_000)  # for 8 s
    samples.position_mm[second] += [200.0, 0.0, 0.0]
    samples.position_mm[8_000:] += [0.0, 5.0, 0.0]
    change = 5  # samples beside a jump may go
    among = find_valid_samples(samples, ("T1", "T2", "T3"))
    assert among[second][change:-change].all()
    assert not find_valid_samples(samples)[second].any()


def test_a_stream_shared_with_another_target_is_cleaned_in_little_time(rng):
    samples = moving(rng, 60_000)
    other = np.arange(60_000) % 8 // 2 == 1
    samples.position_mm[other] += [500.0, -200.0, 100.0]
    assert (find_valid_samples(samples) == ~other).all()


def test_a_target_that_creeps_is_not_at_a_standstill(record):
    run, _ = record(4, "standstill", rows=30)
    seen = align(run)
    time = run.tracker.device_time_s
    at = seen.at.time_s[seen.row == 7]
    creeping = (time > at[0] - 0.2) & (time < at[-1] + 0.2)
    off = np.where(creeping, 0.2 * (time - at[0]), 0.0)  # mm, far below any feed
    moved = run.tracker.position_mm + off[:, None] * np.array([1.0, 0.0, 0.0])
    slid = align(replace(run, tracker=replace(run.tracker, position_mm=moved)))
    assert set(seen.row.tolist()) - set(slid.row.tolist()) == {7}


def test_direction_of_approach_is_that_of_the_last_motion(usual):
    run, _, seen = usual
    step = np.diff(run.commanded.position, axis=0, prepend=0.0)[seen.row]
    step[seen.row == 0] = 0.0  # where the machine stands before its first line
    moved = step != 0.0
    assert (seen.at.approach[moved] == np.sign(step[moved])).all()


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
