import itertools
import json
from dataclasses import asdict
from importlib import resources

import numpy as np
import pytest

from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import (
    Reflector,
    list_machines,
    load_machine,
    parse_machine,
)

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
