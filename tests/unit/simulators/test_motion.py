"""Motion of simulated machines, and machines that are known exactly."""

import itertools
import json
import math
import os
from dataclasses import asdict, replace
from importlib import resources

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath_drivers.tracker.streaming import codec, messages
from truepath_simulators import faults, machine_file
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air, TrackerClock, random_pose
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import Reflector
from truepath_simulators.motion import paths, planner, profile
from truepath_simulators.motion.followed_positions import FollowedPositions
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Arc, Program, path_length
from truepath_simulators.tracker.tracker_device import TrackerDevice
from truepath_simulators.tracker.tracker_sight import TrackerParts
from truepath_simulators.worlds import recording, synthetic

JERKY = Limits(1500.0, 30_000.0)
TRAPEZOID = Limits(1500.0, math.inf)

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


@pytest.mark.parametrize("held_at_s", [None, 20.3, 39.0])
def test_a_circle_is_driven_on_its_radius_whether_or_not_it_is_held(held_at_s):
    # It goes from beside the circle a little more than twice round it, and back.
    beyond, turn = np.radians(10.0), np.radians(730.0)
    places = [[250.0, 100.0, 50.0], [0.0, 0.0, 50.0], [250.0, 100.0, 50.0]]
    places[1][:2] = 100.0 + 150.0 * np.cos(beyond), 100.0 + 150.0 * np.sin(beyond)
    arcs = Arc((0, 1), (100.0, 100.0), turn), Arc((0, 1), (100.0, 100.0), -turn)
    feeds, dwells = np.full(3, 50.0), np.full(3, 0.5)
    program = Program(np.array(places), feeds, dwells, arc=(None, *arcs))
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


CHAINS = [
    "-".join(["w", *order[:k], "b", *order[k:], "t"])
    for order in itertools.permutations("XYZ")
    for k in range(4)
]
LINEAR = {"type": "linear", "min_mm": 0.0, "max_mm": 300.0}
STRAIGHT = dict.fromkeys("XYZ", LINEAR)


def with_chain(demo, chain):
    return machine_file.parse_machine(demo | {"kinematic_chain": chain})


def somewhere(rng, machine, n=200):
    return rng.uniform(machine.low_mm, machine.high_mm, (n, 3))


def linear_form_mm(truth, q):
    """Sum over the axes of E_i + omega_i x L_i, as the file formats state it."""
    machine, s = truth.machine, truth.squareness_rad
    # Turns of the direction of travel: C0Y and B0Z, A0Z about Z, Y and X.
    slopes = {"Y": [-s["C0Y"], 0.0, 0.0], "Z": [s["B0Z"], -s["A0Z"], 0.0]}
    deviation = np.zeros_like(q)
    arm = np.tile(machine.reflector().offset_mm, (len(q), 1))
    for name in reversed(machine.workpiece_side + machine.tool_side):
        joint, k = truth.joints[name], "XYZ".index(name)
        shift = np.stack([m.at(q[:, k]) for m in joint.translation], axis=1)
        shift += np.outer(q[:, k], slopes.get(name, np.zeros(3)))
        turn = np.stack([m.at(q[:, k]) for m in joint.rotation], axis=1)
        deviation += shift + np.cross(turn, arm)
        arm[:, k] += q[:, k]
    return deviation


@pytest.mark.parametrize("chain", CHAINS)
def test_it_is_where_it_should_be_or_as_the_linear_form_says(demo, rng, chain):
    machine = with_chain(demo, chain)
    q = somewhere(rng, machine)
    exact = perfect(machine)
    nominal = q + machine.reflector().offset_mm
    np.testing.assert_allclose(exact.locate_target_mm(q), nominal, atol=1e-9)
    assert np.abs(exact.deviation_mm(q)).max() < 1e-9

    def rest_mm(scale):
        truth = random_machine(machine, 5, scale=scale)
        return np.abs(truth.deviation_mm(q) - linear_form_mm(truth, q)).max()

    size_mm = np.abs(random_machine(machine, 5).deviation_mm(q)).max()
    assert rest_mm(1.0) < 1e-3 * size_mm
    # Ten times the errors leave a hundred times the rest.
    assert rest_mm(100.0) / rest_mm(10.0) == pytest.approx(100.0, rel=0.1)


@pytest.mark.parametrize("chain", ["w-b-X-Y-Z-t", "w-X-b-Y-Z-t", "w-X-Y-Z-b-t"])
def test_reflectors_on_one_tool_keep_their_distance(demo, rng, chain):
    machine = with_chain(demo, chain)
    truth = random_machine(machine, 2, scale=100.0)
    q = somewhere(rng, machine)
    a, b = np.array([10.0, -40.0, -90.0]), np.array([-25.0, 5.0, -210.0])
    seen = [truth.point_mm(q, Reflector("", "tool", tuple(p))) for p in (a, b)]
    distance = np.linalg.norm(seen[1] - seen[0], axis=1)
    np.testing.assert_allclose(distance, np.linalg.norm(b - a), rtol=1e-12)


def test_error_motions_have_the_tables_gauge_and_usual_magnitudes(demo, machine):
    limits = {"positioning": (5e-3, 40e-3), "straight": (2e-3, 15e-3)}
    grid = np.linspace(0.0, 1.0, 201)
    for seed in range(5):
        truth = random_machine(machine, seed)
        motions = truth.error_motions()
        assert len(motions) == 18
        for symbol, motion in motions.items():
            own = symbol[1] == symbol[2]
            ends = np.array([motion.low_mm, motion.high_mm])
            straightness = symbol[1] in "XYZ" and not own
            zeros = motion.at(ends) if straightness else motion.at(np.zeros(1))
            np.testing.assert_allclose(zeros, 0.0, atol=1e-12)
            s = motion.low_mm + grid * (motion.high_mm - motion.low_mm)
            peak = np.abs(motion.at(s)).max()
            low, high = limits["positioning" if own else "straight"]
            if symbol[1] in "ABC":
                low, high = 5e-6, 40e-6
            assert low * 0.999 <= peak <= high * 1.001
        assert all(5e-6 <= abs(v) <= 60e-6 for v in truth.squareness_rad.values())
    # The axis zero is the lowest position where zero is out of travel.
    axes = demo["axes"] | {"X": {"type": "linear", "min_mm": 100.0, "max_mm": 300.0}}
    truth = random_machine(machine_file.parse_machine(demo | {"axes": axes}), 1)
    assert abs(truth.error_motions()["EXX"].at(np.array([100.0]))[0]) < 1e-12


def test_a_seed_says_the_machine_and_many_points_are_as_one_by_one(machine, rng):
    q = somewhere(rng, machine)
    first, same, other = (random_machine(machine, s).deviation_mm(q) for s in (7, 7, 8))
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1e-3
    truth = random_machine(machine, 1)
    q = somewhere(rng, machine, 45_000)
    some = [0, 19_999, 20_000, 44_999]
    alone = np.vstack([truth.deviation_mm(q[k : k + 1]) for k in some])
    np.testing.assert_allclose(truth.deviation_mm(q)[some], alone, atol=1e-12)


def test_bundled_machines_can_be_simulated_and_an_unknown_one_names_them():
    folder = resources.files("truepath_simulators") / "scenarios"
    for name in machine_file.list_machines():
        machine = machine_file.parse_machine(machine_file.load_machine(name))
        assert np.all(machine.high > machine.low)
        content = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        # Its tracker errs as its maker specifies, as real ones do.
        assert content["tracker"]["specification"] == asdict(TrackerSpecification())
    with pytest.raises(SimulatorError, match="demo"):
        machine_file.load_machine("no-such-machine.json")


def turn_c(**axis):
    content = machine_file.load_machine("head-table")
    content["axes"]["C"] |= axis
    return content


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "machine/2"}, "schema"),
        ({"kinematic_chain": "w-X-Y-Z-t"}, "kinematic_chain"),
        ({"kinematic_chain": "w-b-X-Y-t"}, "axes"),
        ({"axes": {"X": {}}}, "axes"),
        ({"tool_offset_mm": [1.0]}, "three coordinates"),
        ({"tracker": {"colour": "red"}}, "colour"),
        ({"axes": {**STRAIGHT, "Y": LINEAR | {"max_mm": 0.0}}}, r"axes\.Y"),
        (turn_c(type="linear"), r"axes\.C\.type"),
        (turn_c(max_deg=-5.0), "min_deg"),
        (turn_c(direction=[0, 0, 0]), "direction"),
        (turn_c(origin_mm=[0, 0]), "three coordinates"),
    ],
)
def test_a_bad_machine_file_is_refused_by_name(demo, change, said):
    with pytest.raises(SimulatorError, match=said):
        machine_file.parse_machine(demo | change)


def test_targets_go_by_name(demo):
    del demo["tool_offset_mm"]
    with pytest.raises(SimulatorError, match="tool_offset_mm"):
        machine_file.parse_machine(demo)
    demo["targets"] = {"T1": {"on": "tool", "offset_mm": [0, 0, -100]}}
    demo["targets"]["T2"] = {"on": "workpiece", "offset_mm": [1, 2, 3]}
    machine = machine_file.parse_machine(demo)
    assert machine.reflector("T2").on == "workpiece"
    assert machine.reflector() == machine.reflector("T1")
    with pytest.raises(SimulatorError, match="T3"):
        machine.reflector("T3")


@pytest.fixture(params=["head-table", "trunnion"])
def content(request):
    return machine_file.load_machine(request.param)


@pytest.fixture
def five_axes(content):
    return machine_file.parse_machine(content)


def test_a_table_turns_the_workpiece_and_a_head_the_tool():
    truth = perfect(machine_file.parse_machine(turn_c(origin_mm=[0.0, 0.0, 0.0])))
    tool = Reflector("", "tool", (0, 0, -100))
    part = Reflector("", "workpiece", (9, 0, 0))
    turned = np.array([[10.0, 20.0, 30.0, 90.0, 0.0], [10.0, 20.0, 30.0, 0.0, 90.0]])
    # About +Y the tool swings towards -X; a part turned by +90 deg sees it by -90.
    swung = [[10.0 - 100.0, 20.0, 30.0], [20.0, -10.0, 30.0 - 100.0]]
    found = truth.nominal_point_mm(turned, tool)
    np.testing.assert_allclose(found, swung, atol=1e-9)
    found = truth.nominal_point_mm(turned, part, "base")
    np.testing.assert_allclose(found, [[9.0, 0.0, 0.0], [0.0, 9.0, 0.0]], atol=1e-9)


def test_the_location_is_where_the_axis_is():
    """A point on the axis as it is rests while the axis turns."""
    machine = machine_file.parse_machine(turn_c())
    axis = machine.rotary_axes[1]
    joint = perfect(machine).joints["C"]
    joint = replace(joint, shift_mm=(0.05, -0.02, 0.0), tilt_rad=(3e-5, 1e-5, 0.0))
    turns = joint.actual(np.linspace(0.0, 360.0, 13))
    base = np.append(np.add(axis.origin_mm, (0.05, -0.02, 0.0)), 1.0)
    above = np.add(base, (1e-5 * 400.0, -3e-5 * 400.0, 400.0, 0.0))
    for point, slack in ((base, 1e-9), (above, 1e-6)):
        moved = turns @ point - point
        np.testing.assert_allclose(moved, 0.0, atol=slack)
    away = turns @ np.add(base, (100.0, 0.0, 0.0, 0.0))
    assert np.ptp(away[:, 0]) == pytest.approx(200.0, rel=1e-6)


def test_the_motions_are_those_of_the_tool_relative_to_the_workpiece(five_axes):
    """At the axis zero of all others, a displacement of any axis is one of the tool."""
    truth = perfect(five_axes)
    tool = Reflector("", "tool", (10.0, 20.0, 30.0))
    for name in five_axes.rotary_axes:
        motion = random_machine(five_axes, 1).error_motions()[f"EX{name.name}"]
        motion = replace(motion, amplitude=(), phase=(), offset=0.01, bend=0.0)
        joint = truth.joints[name.name]
        moved = replace(joint, translation=(motion, *joint.translation[1:]))
        shift = replace(truth, joints={**truth.joints, name.name: moved})
        by_mm = shift.point_mm(np.zeros((1, 5)), tool) - tool.offset_mm
        np.testing.assert_allclose(by_mm, [[0.01, 0.0, 0.0]], atol=1e-12)


def test_rows_are_joined_by_straight_lines_in_axis_positions(five_axes):
    program = paths.turning_path(five_axes, 3, 24, 8000.0)
    timeline = make_program_timeline(program, program.position[0], 1.0, Limits())
    time_s = np.linspace(1.0, timeline.end_s, 4000)
    row, place = timeline.rows(time_s), timeline.positions(time_s)
    begin, end = program.position[row - 1], program.position[row]
    step = end - begin
    along, length2 = ((one * step).sum(axis=1) for one in (place - begin, step))
    straight = begin + (along / np.maximum(length2, 1e-9))[:, None] * step
    np.testing.assert_allclose(place[row > 0], straight[row > 0], atol=1e-6)
    rate = np.abs(np.diff(place[:, 3:], axis=0)) / np.diff(time_s)[:, None]
    assert rate.max() < 41.0
    # The feed is that of the straight axes, else of the rotary ones.
    step = np.array([[3.0, 4.0, 0.0, 90.0, 0.0], [0.0, 0.0, 0.0, 30.0, 40.0]])
    np.testing.assert_allclose(path_length(step), [5.0, 50.0])


def test_each_row_measures_its_own_target(content, five_axes):
    program = paths.turning_path(five_axes, 3, 10, 8000.0)
    quiet = synthetic.Setting(noise_scale=0.0, rate_hz=50.0)
    made = synthetic.record(content, program, 5, setting=quiet)
    assert set(program.target) == {r.name for r in five_axes.reflectors}
    for target in program.target:
        mine = np.array(program.target)[made.row] == target
        seen = made.truth.locate_target_mm(made.commanded_mm[mine], target)
        expected = made.pose.from_table(seen)
        np.testing.assert_allclose(made.position_mm[mine], expected, atol=1e-9)


def test_a_bundle_states_axes_in_deg_and_the_target(tmp_path):
    content = machine_file.load_machine("head-table")
    program = paths.turning_points(machine_file.parse_machine(content), 3, 4)
    made = synthetic.record(content, program, 5, "standstill")
    recording.write_bundle_files(tmp_path, made, csv=True)
    header, first, *_ = (tmp_path / "points.csv").read_text().splitlines()
    assert header.startswith("x_mm,y_mm,z_mm,")
    assert header.endswith("c_deg,dwell_s,target")
    assert first.endswith(",T1")


def test_the_tracker_is_turned_to_the_target_of_each_row(five_axes):
    program = paths.turning_path(five_axes, 3, 24, 8000.0)
    orders = paths.looking_at(five_axes, program.target)
    assert len(orders) == 5
    truth, pose = perfect(five_axes), random_pose(five_axes, 1)
    parts = TrackerParts(truth, pose, TrackerClock(0.0, 0.0), Air(), 1)
    device = TrackerDevice(parts, faults.Schedule(map(faults.parse_fault, orders)))
    timeline = make_program_timeline(program, program.position[0], 0.0, Limits())
    device.receive(messages.encode_message(messages.Start(1, 50.0)), 0.0, 0.0)
    frames = device.due(timeline, timeline.end_s, 0.1)
    samples = codec.StreamDecoder().feed(frames).samples
    row = timeline.rows(samples.device_time_s)
    position = timeline.positions(samples.device_time_s)
    for name in dict.fromkeys(program.target):
        mine = np.array(program.target)[row] == name
        expected = pose.from_table(truth.locate_target_mm(position[mine], name))
        assert mine.any()
        np.testing.assert_allclose(samples.position_mm[mine], expected, atol=0.1)
