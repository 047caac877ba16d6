"""Rotary axes of the truth machine, their paths and recordings."""

from dataclasses import replace

import numpy as np
import pytest

from truepath_drivers.tracker.streaming import codec, messages
from truepath_simulators import errors, faults, machine_file
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air, TrackerClock, random_pose
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.motion import paths
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import path_length
from truepath_simulators.tracker.tracker_device import TrackerDevice
from truepath_simulators.tracker.tracker_sight import TrackerParts
from truepath_simulators.worlds import recording, synthetic


@pytest.fixture(params=["head-table", "trunnion"])
def content(request):
    return machine_file.load_machine(request.param)


@pytest.fixture
def five_axes(content):
    return machine_file.parse_machine(content)


def head_table(**axis):
    content = machine_file.load_machine("head-table")
    content["axes"]["C"] |= axis
    return machine_file.parse_machine(content)


def test_a_table_turns_the_workpiece_and_a_head_the_tool():
    truth = perfect(head_table(origin_mm=[0.0, 0.0, 0.0]))
    tool = machine_file.Reflector("", "tool", (0, 0, -100))
    part = machine_file.Reflector("", "workpiece", (9, 0, 0))
    turned = np.array([[10.0, 20.0, 30.0, 90.0, 0.0], [10.0, 20.0, 30.0, 0.0, 90.0]])
    # About +Y the tool swings towards -X; a part turned by +90 deg sees it by -90.
    swung = [[10.0 - 100.0, 20.0, 30.0], [20.0, -10.0, 30.0 - 100.0]]
    found = truth.nominal_point_mm(turned, tool)
    np.testing.assert_allclose(found, swung, atol=1e-9)
    found = truth.nominal_point_mm(turned, part, "base")
    np.testing.assert_allclose(found, [[9.0, 0.0, 0.0], [0.0, 9.0, 0.0]], atol=1e-9)


def test_the_location_is_where_the_axis_is():
    """A point on the axis as it is rests while the axis turns."""
    machine = head_table()
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
    tool = machine_file.Reflector("", "tool", (10.0, 20.0, 30.0))
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"type": "linear"}, r"axes\.C\.type"),
        ({"max_deg": -5.0}, "min_deg"),
        ({"direction": [0, 0, 0]}, "direction"),
        ({"origin_mm": [0, 0]}, "three coordinates"),
    ],
)
def test_a_bad_rotary_axis_is_refused_by_name(change, said):
    with pytest.raises(errors.SimulatorError, match=said):
        head_table(**change)


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
