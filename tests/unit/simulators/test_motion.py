import math
import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath_simulators.motion import planner, profile
from truepath_simulators.motion.followed_positions import FollowedPositions
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.program import Arc, Program

JERKY = profile.Limits(1500.0, 30_000.0)
TRAPEZOID = profile.Limits(1500.0, math.inf)

lengths = st.floats(1e-3, 800.0)
feeds = st.floats(0.5, 400.0)
shares = st.floats(0.0, 1.0)
limits = st.sampled_from([JERKY, TRAPEZOID])


def one_line(length_mm, feed_mm_s, dwell_s=0.5):
    place = np.array([[length_mm, 0.0, 0.0]])
    return Program(place, np.array([feed_mm_s]), np.array([dwell_s]))


def random_program(rng, n=30):
    places, feeds = rng.uniform(0.0, 500.0, (n, 3)), rng.uniform(20.0, 200.0, n)
    return Program(places, feeds, rng.choice([0.0, 0.1, 0.4], n))


def drive(program, limits=JERKY, begin_s=0.0):
    return make_program_timeline(program, np.zeros(3), begin_s, limits)


def assert_smooth(timeline, limits, feed_mm_s):
    """Position and speed have no jump; limits hold."""
    joints = timeline.start_s[1:]
    before, after = np.nextafter(joints, -np.inf), joints
    step_mm = np.abs(timeline.positions(before) - timeline.positions(after)).max()
    assert step_mm < 1e-6
    jump = np.abs(timeline.speeds(before) - timeline.speeds(after)).max()
    assert jump < 1e-6 * feed_mm_s + 1e-6
    t = np.linspace(timeline.start_s[0] - 0.1, timeline.end_s + 0.1, 3000)
    assert timeline.speeds(t).min() > -1e-6
    assert timeline.speeds(t).max() < feed_mm_s + 1e-6
    a = np.abs(timeline.accelerations(t))
    assert a.max() < limits.acceleration_mm_s2 * (1 + 1e-6)
    if math.isfinite(limits.jerk_mm_s3):
        assert np.abs(timeline.jerk).max() < limits.jerk_mm_s3 * (1 + 1e-6)


@pytest.mark.parametrize("limits", [JERKY, TRAPEZOID])
def test_a_program_is_driven_within_its_limits_and_through_its_points(rng, limits):
    program = random_program(rng)
    program = replace(program, dwell_s=np.maximum(program.dwell_s, 0.05))
    timeline = drive(program, limits, 2.0)
    assert_smooth(timeline, limits, program.feed_mm_s.max())
    rows = zip(program.position, program.dwell_s, strict=True)
    for row, (point, dwell) in enumerate(rows):
        there = timeline.start_s[timeline.row == row][-1]
        np.testing.assert_allclose(timeline.positions(np.array([there]))[0], point)
        assert timeline.speeds(np.array([there]))[0] == 0.0
        still = timeline.positions(there + np.array([0.0, 0.999 * dwell]))
        np.testing.assert_allclose(still, [point, point])


@settings(max_examples=50, deadline=None)
@given(lengths, feeds, limits)
def test_a_line_takes_the_time_of_its_feed_and_its_ramps(length, feed, limits):
    stretches = profile.rest_to_rest(np.array([length]), np.array([feed]), limits)[0]
    t, a, j = stretches.T
    speed = np.cumsum(t * (a + t * j / 2.0))
    before = np.r_[0.0, speed[:-1]]
    travelled = float(np.sum(t * (before + t * (a / 2.0 + t * j / 6.0))))
    assert travelled == pytest.approx(length, rel=1e-9)
    assert speed[-1] == pytest.approx(0.0, abs=1e-9 * feed)
    assert speed.max() <= feed * (1 + 1e-9)
    assert t.sum() >= length / feed * (1 - 1e-9)


def test_a_long_line_cruises_at_its_feed_and_rows_dwell_as_long_as_ordered():
    timeline = drive(one_line(500.0, 100.0))
    t = np.linspace(0.0, timeline.end_s - 0.5, 1000)
    share = np.mean(np.abs(timeline.speeds(t) - 100.0) < 1e-9)
    assert share > 0.95
    long = drive(one_line(500.0, 100.0, 1.7))
    assert long.end_s - timeline.end_s == pytest.approx(1.2)
    program = Program(np.zeros((3, 3)), np.full(3, 10.0), np.full(3, 0.5))
    timeline = drive(program, begin_s=1.0)
    assert timeline.end_s == pytest.approx(2.5)
    assert not timeline.speeds(np.linspace(0, 3, 50)).any()
    program = one_line(50.0, 100.0, 2.0)
    timeline = drive(program)
    at = timeline.end_s - 1.5
    left = planner.find_rest(timeline, program, at)
    assert left.dwell_s[0] == pytest.approx(1.5)
    held = planner.hold_motion(timeline, at, JERKY)
    whole = planner.resume_motion(held, left, 10.0, JERKY)
    assert whole.end_s == pytest.approx(11.5)


@settings(max_examples=60, deadline=None)
@given(lengths, feeds, shares, limits)
def test_a_hold_stops_on_the_line_within_the_limits(length, feed, when, limits):
    timeline = drive(one_line(length, feed, 0.0), limits)
    at = when * timeline.end_s
    stopped = planner.hold_motion(timeline, at, limits)
    assert_smooth(stopped, limits, feed)
    rest = stopped.positions(np.array([stopped.end_s + 1.0]))[0]
    assert rest[0] <= length + 1e-6
    assert not rest[1:].any()
    speed = float(timeline.speeds(np.array([at]))[0])
    A = limits.acceleration_mm_s2
    ramp = 0.0 if math.isinf(limits.jerk_mm_s3) else A / limits.jerk_mm_s3
    # No later than from this speed with a whole ramp up and a whole ramp down.
    assert stopped.end_s - at <= speed / A + 3.0 * ramp + 1e-6


@settings(max_examples=50, deadline=None)
@given(shares, st.floats(0.01, 5.0), st.integers(0, 2**32 - 1))
def test_a_held_program_goes_on_to_its_end(when, pause, seed):
    program = random_program(np.random.default_rng(seed), 5)
    timeline = drive(program)
    at = when * timeline.end_s
    left = planner.find_rest(timeline, program, at)
    stopped = planner.hold_motion(timeline, at, JERKY)
    begin = stopped.end_s + pause
    whole = planner.resume_motion(stopped, left, begin, JERKY)
    assert_smooth(whole, JERKY, program.feed_mm_s.max())
    end = whole.positions(np.array([whole.end_s]))[0]
    np.testing.assert_allclose(end, program.position[-1], atol=1e-9)
    t = np.linspace(stopped.end_s, begin, 10)
    assert np.ptp(whole.positions(t), axis=0).max() < 1e-9


@settings(max_examples=50, deadline=None)
@given(lengths, feeds, feeds, shares, limits)
def test_the_feed_changes_under_way_within_limits(length, feed, other, when, limits):
    timeline = drive(one_line(length, feed, 0.3), limits)
    at = when * timeline.end_s
    changed = planner.with_feed(timeline, one_line(length, other, 0.3), at, limits)
    assert_smooth(changed, limits, max(feed, other))
    end = changed.positions(np.array([changed.end_s]))[0]
    assert end[0] == pytest.approx(length, abs=1e-6)


def test_half_the_feed_takes_twice_the_time_from_then_on():
    timeline = drive(one_line(400.0, 100.0, 0.0))
    slower = planner.with_feed(timeline, one_line(400.0, 50.0, 0.0), 2.0, JERKY)
    assert slower.speeds(np.array([3.0]))[0] == pytest.approx(50.0)
    assert slower.end_s == pytest.approx(2.0 + 2.0 * (timeline.end_s - 2.0), rel=0.02)


def test_what_has_ended_can_be_forgotten(rng):
    timeline = drive(random_program(rng))
    t = np.linspace(20.0, timeline.end_s + 1.0, 500)
    kept = timeline.since(20.0)
    np.testing.assert_array_equal(kept.positions(t), timeline.positions(t))
    assert len(kept) < len(timeline)


def two_turns():
    """Stand beside a circle, go round it a little more than twice, and back."""
    end = np.radians(10.0)
    places = [[250.0, 100.0, 50.0], [0.0, 0.0, 50.0], [250.0, 100.0, 50.0]]
    places[1][:2] = 100.0 + 150.0 * np.cos(end), 100.0 + 150.0 * np.sin(end)
    turn = np.radians(730.0)
    arcs = Arc((0, 1), (100.0, 100.0), turn), Arc((0, 1), (100.0, 100.0), -turn)
    feeds, dwells = np.full(3, 50.0), np.full(3, 0.5)
    return Program(np.array(places), feeds, dwells, arc=(None, *arcs))


@pytest.mark.parametrize("held_at_s", [None, 20.3, 39.0])
def test_a_circle_is_driven_on_its_radius_whether_or_not_it_is_held(held_at_s):
    program = two_turns()
    motion = make_program_timeline(program, program.position[0], 0.0, JERKY)
    whole_s = motion.end_s
    if held_at_s is not None:
        held = planner.hold_motion(motion, held_at_s, JERKY)
        motion = planner.resume_motion(held, program, held.end_s + 1.0, JERKY)
        assert 1.0 < motion.end_s - whole_s < 1.5
    t = np.linspace(0.0, motion.end_s, 2000)
    out = motion.positions(t)[:, :2] - 100.0
    assert np.abs(np.linalg.norm(out, axis=1) - 150.0).max() < 1e-4
    assert_smooth(motion, JERKY, 50.0)
    turned = np.degrees(np.unwrap(np.arctan2(out[:, 1], out[:, 0])))
    assert turned.max() == pytest.approx(730.0, abs=0.1)
    end = motion.positions(np.array([motion.end_s]))[0]
    assert end == pytest.approx([250, 100, 50])
    if held_at_s is None:  # within a piece no axis turns back
        for begin_s, end_s in zip(motion.start_s, motion.start_s[1:], strict=False):
            inside = np.linspace(begin_s, end_s - 1e-9, 30)
            step = np.diff(motion.positions(inside), axis=0)
            assert ((step > -1e-7).all(axis=0) | (step < 1e-7).all(axis=0)).all()


@pytest.fixture
def source():
    """Positions of two axes in milliseconds, and where to write them."""
    read, write = os.pipe()
    followed = FollowedPositions(read, 2, 1e-3)
    yield followed, lambda text: os.write(write, text.encode())
    followed.close()
    os.close(write)


def test_positions_are_those_of_the_source_at_its_own_times(source):
    followed, write = source
    assert (followed.timeline(), followed.now_s()) == (None, 0.0)
    write("1000 10.0 5.0\n1001 10.2 5.0\n1002 10.4 5.1 99 98\n1003 10.4 ")
    at = followed.timeline().positions(np.array([1.0, 1.0005, 1.0015, 1.002, 7.0]))
    expected = [[10.0, 5.0], [10.1, 5.0], [10.3, 5.05], [10.4, 5.1], [10.4, 5.1]]
    np.testing.assert_allclose(at, expected)
    assert followed.now_s() == pytest.approx(1.002)
    write("5.1\n")
    assert followed.timeline().end_s == pytest.approx(1.003)


def test_what_is_no_position_and_time_that_goes_back_are_left_out(source):
    followed, write = source
    write("1000, 1.0, 2.0\noverrun\n1001 nan 2.0\n999 7.0 7.0\n1000 8 8\n1002 3 4\n")
    timeline = followed.timeline()
    np.testing.assert_allclose(timeline.start_s, [1.0, 1.002])
    np.testing.assert_allclose(timeline.origin, [[1.0, 2.0], [3.0, 4.0]])


def test_only_the_last_seconds_are_kept(source):
    followed, write = source
    for begin in range(0, 30_000, 1000):
        write("".join(f"{t} {t} 0\n" for t in range(begin, begin + 1000, 10)))
        timeline = followed.timeline()
    assert timeline.start_s[0] == pytest.approx(19.99, abs=0.011)
