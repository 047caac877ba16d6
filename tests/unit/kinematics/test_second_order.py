"""Small motions added, with what they do to one another, against motions composed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.machine.machine import LinearAxis, Machine, RotaryAxis, Target
from truepath.kinematics.machine.symbols import is_turn, list_error_motions
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_second_order_mm, is_nearly_linear

AXES = {
    "X": LinearAxis("X", 0.0, 700.0),
    "Y": LinearAxis("Y", 0.0, 500.0),
    "Z": LinearAxis("Z", -400.0, 0.0),
    "C": RotaryAxis("C", -170.0, 170.0, (300.0, 200.0, -50.0), (0.0, 0.0, 1.0)),
}
CHAINS = [((), ("X", "Y", "Z")), (("Y",), ("X", "Z")), (("X", "C"), ("Y", "Z"))]


def build(workpiece_side, tool_side):
    axes = tuple(AXES[name] for name in (*workpiece_side, *tool_side))
    target = Target("", "tool", (30.0, -20.0, -180.0))
    machine = Machine("m", workpiece_side, tool_side, axes, (target,), TrackerNoise())
    named = [(s, axis) for axis in axes for s in list_error_motions(axis.name)]
    return MachineModel(machine, tuple(make_error_motion(*one, 3) for one in named))


def draw(model, rng, size_mm, size_rad):
    sizes = [
        size_rad if is_turn(motion.symbol) else size_mm
        for motion in model.error_motions
        for _ in motion.parameters
    ]
    return rng.normal(size=len(sizes)) * np.array(sizes)


def compose(model, theta, position):
    """Return where the workpiece sees the target, one transform after another."""
    machine, names = model.machine, model.machine.axis_names
    point = np.tile(machine.target().offset_mm, (len(position), 1)).astype(float)
    for name in reversed(names):
        column = position[:, names.index(name)]
        value = {
            m.symbol[1]: m.rows(column) @ theta[model.slices[m.name]]
            for m in model.error_motions
            if m.axis.name == name
        }
        shift = np.stack([value[k] for k in "XYZ"], axis=1)
        turn = Rotation.from_rotvec(np.stack([value[k] for k in "ABC"], axis=1))
        axis = machine.axes[names.index(name)]
        if isinstance(axis, RotaryAxis):
            origin = np.array(axis.origin_mm)
            back = Rotation.from_rotvec(np.outer(-np.radians(column), [0.0, 0.0, 1.0]))
            point = origin + turn.apply(point - origin) + shift
            point = origin + back.apply(point - origin)
        else:
            point = turn.apply(point) + shift
            point[:, "XYZ".index(name)] += column
    return point


@pytest.mark.parametrize("chain", CHAINS, ids=["tool", "table", "turning"])
def test_motions_of_a_millimetre_and_a_milliradian_compose(rng, chain):
    model = build(*chain)
    low, high = np.array([(axis.low, axis.high) for axis in model.machine.axes]).T
    position = rng.uniform(low, high, (200, len(low)))
    at, theta = make_standstill(model.machine, position), draw(model, rng, 0.5, 1e-3)
    linear = model.jacobian(at) @ theta
    exact = compose(model, theta, position) - at.point_mm
    added = compute_second_order_mm(model, at, theta)
    assert np.abs(exact - linear).max() > 1e-3
    assert np.abs(exact - linear - added).max() < 0.02 * np.abs(exact - linear).max()


def test_motions_of_twenty_micrometres_add(rng):
    model = build(*CHAINS[0])
    position = rng.uniform([0.0, 0.0, -400.0], [700.0, 500.0, 0.0], (50, 3))
    at = make_standstill(model.machine, position)
    small = draw(model, rng, 0.01, 1e-5)
    assert is_nearly_linear(model, at, small)
    assert np.abs(compute_second_order_mm(model, at, small)).max() < 2e-5
    assert not is_nearly_linear(model, at, 100.0 * small)


def test_from_the_base_a_table_turns_the_other_way(rng):
    model = build(*CHAINS[2])
    position = np.array([[350.0, 90.0, 100.0, -200.0]])
    at = make_standstill(model.machine, position)
    base = replace(at, observer="base", on_workpiece=np.array([True]))
    theta = draw(model, rng, 0.5, 1e-3)
    # The tool's own axes are not seen there, and of one axis alone its arc is left.
    names = {m.name for m in model.error_motions if m.axis.name in "XC"}
    for motion in model.error_motions:
        if motion.name not in names:
            theta[model.slices[motion.name]] = 0.0
    moved = model.jacobian(base) @ theta
    added = compute_second_order_mm(model, base, theta)
    half = compute_second_order_mm(model, base, 0.5 * theta)
    assert np.abs(added).max() < 0.01 * np.abs(moved).max()
    assert added == pytest.approx(4.0 * half, rel=1e-6)
