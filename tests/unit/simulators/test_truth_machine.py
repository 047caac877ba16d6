"""Machines that are known exactly, rotary axes too."""

import itertools
import json
from dataclasses import asdict, replace
from importlib import resources

import numpy as np
import pytest

from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath_drivers.tracker.streaming import codec, message_codec, messages
from truepath_simulators import errors, faults, machine_file, scenario
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air, TrackerClock, random_pose
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import Reflector, parse_machine
from truepath_simulators.motion import turning_paths
from truepath_simulators.motion.driven_motion import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import path_length
from truepath_simulators.scenario import list_machines, load_machine
from truepath_simulators.tracker.tracker_device import TrackerDevice
from truepath_simulators.tracker.tracker_sight import TrackerParts
from truepath_simulators.worlds import bundle_files, synthetic

CHAINS = [
    "-".join(["w", *order[:k], "b", *order[k:], "t"])
    for order in itertools.permutations("XYZ")
    for k in range(4)
]
LINEAR = {"type": "linear", "min_mm": 0.0, "max_mm": 300.0}
STRAIGHT = dict.fromkeys("XYZ", LINEAR)


def with_chain(demo, chain):
    return parse_machine(demo | {"kinematic_chain": chain})


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
    truth = random_machine(parse_machine(demo | {"axes": axes}), 1)
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
    for name in list_machines():
        machine = parse_machine(load_machine(name))
        assert np.all(machine.high > machine.low)
        content = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        # Its tracker errs as its maker specifies, as real ones do.
        assert content["tracker"]["specification"] == asdict(TrackerSpecification())
    with pytest.raises(SimulatorError, match="demo"):
        load_machine("no-such-machine.json")


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
    ],
)
def test_a_bad_machine_file_is_refused_by_name(demo, change, said):
    with pytest.raises(SimulatorError, match=said):
        parse_machine(demo | change)


def test_targets_go_by_name(demo):
    del demo["tool_offset_mm"]
    with pytest.raises(SimulatorError, match="tool_offset_mm"):
        parse_machine(demo)
    demo["targets"] = {"T1": {"on": "tool", "offset_mm": [0, 0, -100]}}
    demo["targets"]["T2"] = {"on": "workpiece", "offset_mm": [1, 2, 3]}
    machine = parse_machine(demo)
    assert machine.reflector("T2").on == "workpiece"
    assert machine.reflector() == machine.reflector("T1")
    with pytest.raises(SimulatorError, match="T3"):
        machine.reflector("T3")


@pytest.fixture(params=["head-table", "trunnion"])
def content(request):
    return scenario.load_machine(request.param)


@pytest.fixture
def five_axes(content):
    return machine_file.parse_machine(content)


def head_table(**axis):
    content = scenario.load_machine("head-table")
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
    program = turning_paths.turning_path(five_axes, 3, 24, 8000.0)
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
    program = turning_paths.turning_path(five_axes, 3, 10, 8000.0)
    quiet = synthetic.Setting(noise_scale=0.0, rate_hz=50.0)
    made = synthetic.record(content, program, 5, setting=quiet)
    assert set(program.target) == {r.name for r in five_axes.reflectors}
    for target in program.target:
        mine = np.array(program.target)[made.row] == target
        seen = made.truth.locate_target_mm(made.commanded_mm[mine], target)
        expected = made.pose.from_table(seen)
        np.testing.assert_allclose(made.position_mm[mine], expected, atol=1e-9)


def test_a_bundle_states_axes_in_deg_and_the_target(tmp_path):
    content = scenario.load_machine("head-table")
    program = turning_paths.turning_points(machine_file.parse_machine(content), 3, 4)
    made = synthetic.record(content, program, 5, "standstill")
    bundle_files.write_bundle_files(tmp_path, made, csv=True)
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
    program = turning_paths.turning_path(five_axes, 3, 24, 8000.0)
    orders = turning_paths.looking_at(five_axes, program.target)
    assert len(orders) == 5
    truth, pose = perfect(five_axes), random_pose(five_axes, 1)
    parts = TrackerParts(truth, pose, TrackerClock(0.0, 0.0), Air(), 1)
    device = TrackerDevice(parts, faults.Schedule(map(faults.parse_fault, orders)))
    timeline = make_program_timeline(program, program.position[0], 0.0, Limits())
    device.receive(message_codec.encode_message(messages.Start(1, 50.0)), 0.0, 0.0)
    frames = device.due(timeline, timeline.end_s, 0.1)
    samples = codec.StreamDecoder().feed(frames).samples
    row = timeline.rows(samples.device_time_s)
    position = timeline.positions(samples.device_time_s)
    for name in dict.fromkeys(program.target):
        mine = np.array(program.target)[row] == name
        expected = pose.from_table(truth.locate_target_mm(position[mine], name))
        assert mine.any()
        np.testing.assert_allclose(samples.position_mm[mine], expected, atol=0.1)
