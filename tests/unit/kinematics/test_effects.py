"""What effects do to the measured point."""

import numpy as np
import pytest

from mills import build_mill
from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.effects.location_error import Squareness, list_squarenesses
from truepath.kinematics.effects.pose_timing_seats import TimingLaw, TrackerPose
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    describe_symbol,
    find_unit,
    list_error_motions,
)
from truepath.kinematics.model import MachineModel
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine

OFFSET = (20.0, -30.0, -150.0)
CHAINS = [(), ("X",), ("Y",), ("X", "Y"), ("Z",), ("Y", "X")]


def machine(workpiece_side=()):
    tool_side = "".join(a for a in "XYZ" if a not in workpiece_side)
    return build_mill(OFFSET, sides=(workpiece_side, tool_side))


def moving(m, position, line, line_time_s, velocity):
    n = len(position)
    return Conditions(
        m,
        position,
        np.tile(OFFSET, (n, 1)),
        np.arange(float(n)),
        np.array(line),
        np.array(line_time_s),
        np.array(velocity),
        np.zeros((n, 3)),
    )


def full_model(m):
    motions = [
        make_error_motion(s, axis, 6)
        for axis in m.linear_axes
        for s in list_error_motions(axis.name)
    ]
    return MachineModel(m, (*motions, *list_squarenesses(("X", "Y", "Z"))))


def test_a_turn_moves_the_target_by_its_lever(rng):
    m = machine()
    q = rng.uniform(0, 500, (20, 3))
    at = make_standstill(m, q)
    effect = make_error_motion("EBX", m.linear_axes[0], 6)
    theta = 1e-5 * rng.normal(size=len(effect.parameters))
    turn = effect.rows(q[:, 0]) @ theta
    lever = np.array(OFFSET) + np.column_stack([0 * q[:, 0], q[:, 1], q[:, 2]])
    expected = np.cross(turn[:, None] * np.array([0.0, 1.0, 0.0]), lever)
    assert np.allclose(effect.displacement_mm(at, theta), expected)


@pytest.mark.parametrize("side", CHAINS)
def test_the_lever_is_the_target_and_all_axes_to_the_right(side, rng):
    m = machine(side)
    q, offset = rng.uniform(0, 500, (5, 3)), np.tile(OFFSET, (5, 1))
    for place, axis in enumerate(m.order):
        expected = offset.copy()
        for later in m.order[place + 1 :]:
            expected[:, "XYZ".index(later)] += q[:, "XYZ".index(later)]
        assert np.allclose(make_standstill(m, q).chain.lever(axis).lever_mm, expected)
    assert np.allclose(make_standstill(m, q).point_mm, q + offset)


@pytest.mark.parametrize(
    ("low", "high", "zero"), [(0, 500, 0), (-200, 300, 0), (50, 550, 50)]
)
def test_tables_keep_the_gauge(low, high, zero, rng):
    axis = LinearAxis("X", float(low), float(high))
    for symbol in ("EXX", "EAX", "EBX", "ECX", "EYX", "EZX"):
        effect = make_error_motion(symbol, axis, 8)
        theta = rng.normal(size=len(effect.parameters))
        is_straightness = symbol in ("EYX", "EZX")
        fixed = [axis.low, axis.high] if is_straightness else [float(zero)]
        assert effect.rows(np.array(fixed)) @ theta == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("symbol", "turn", "axis"),
    [("C0Y", [0, 0, 1], "Y"), ("B0Z", [0, 1, 0], "Z"), ("A0Z", [1, 0, 0], "Z")],
)
def test_squareness_is_a_right_handed_turn_of_its_axis(symbol, turn, axis):
    m = machine()
    q = np.zeros((1, 3))
    q[0, "XYZ".index(axis)] = 400.0
    leaned = Squareness(symbol).displacement_mm(make_standstill(m, q), np.array([1e-5]))
    assert np.allclose(leaned, np.cross(1e-5 * np.array(turn), q))


@pytest.mark.parametrize("side", CHAINS)
def test_the_linear_form_is_the_exact_machine_to_second_order(side, rng, rigid_free):
    """The truth machine composes homogeneous transforms; nothing is shared with it."""
    m = machine(side)
    content = load_machine("demo") | {"kinematic_chain": m.chain}
    content |= {"tool_offset_mm": list(OFFSET)}
    for axis in content["axes"].values():
        axis["max_mm"] = 500.0
    truth = random_machine(parse_machine(content), 3, scale=1.0)
    q = rng.uniform(0, 500, (600, 3))
    exact = rigid_free(q, truth.deviation_mm(q))
    model = full_model(m)
    columns = model.jacobian(make_standstill(m, q))
    pose = TrackerPose((0.0, 0.0, 0.0)).jacobian(make_standstill(m, q))
    flat = np.concatenate([columns, pose], axis=2).reshape(1800, -1)
    left = exact.ravel() - flat @ np.linalg.lstsq(flat, exact.ravel(), rcond=None)[0]
    # Six intervals do not hold every shape of the truth; what is left is far below it.
    assert np.sqrt(np.mean(left**2)) < 0.03 * np.sqrt(np.mean(exact**2))


def test_phase_and_speed_move_along_their_own_line_only_and_not_at_a_standstill(rng):
    m, law = machine(), TimingLaw((0, 1))
    position = rng.uniform(0, 500, (3, 3))
    velocity = [[100.0, 0, 0], [100.0, 0, 0], [0, 0, -50.0]]
    at = moving(m, position, [0, 0, 1], [-1.0, 1.0, 0.5], velocity)
    moved = law.displacement_mm(at, np.array([0.1, 0.01, 0.0, 0.2]))
    assert np.allclose(moved, [[0.09, 0, 0], [0.11, 0, 0], [0, 0, -0.1]])
    assert not law.jacobian(make_standstill(m, position)).any()


def test_pose_is_a_shift_and_a_turn_about_its_centre(rng):
    at = make_standstill(machine(), rng.uniform(0, 500, (4, 3)))
    turn, shift = np.array([1e-5, 2e-5, -1e-5]), np.array([0.1, 0.0, -0.2])
    effect = TrackerPose((100.0, 50.0, 0.0))
    moved = effect.displacement_mm(at, np.concatenate([shift, turn]))
    assert np.allclose(moved, shift + np.cross(turn, at.point_mm - [100.0, 50.0, 0.0]))


def test_theta_is_the_parameters_of_the_effects_one_after_another(rng):
    m = machine()
    model = full_model(m)
    at = make_standstill(m, rng.uniform(0, 500, (7, 3)))
    theta = rng.normal(size=model.size)
    parts = sum(
        e.displacement_mm(at, theta[model.slices[e.name]]) for e in model.effects
    )
    assert np.allclose(model.jacobian(at) @ theta, parts)
    assert (
        len(model.parameters) == model.size == len({p.name for p in model.parameters})
    )


def test_every_symbol_has_a_meaning_and_a_unit():
    symbols = [s for a in "XYZ" for s in list_error_motions(a)] + list(SQUARENESS)
    words = [describe_symbol(s) for s in symbols]
    assert len(set(words)) == 21
    assert describe_symbol("EYX") == "straightness of X in Y"
    assert describe_symbol("EAX") == "roll of X"
    assert {find_unit(s) for s in symbols} == {"um", "urad"}
