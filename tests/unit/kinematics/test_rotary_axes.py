"""The linear form and its second order against exact transforms, rotary axes too."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import (
    ErrorMotion,
    compute_arm,
    list_axis_locations,
    list_squarenesses,
    make_error_motion,
)
from truepath.kinematics.effects.position_wave import RotaryEccentricity
from truepath.kinematics.effects.thermal_growth import ToolGrowth
from truepath.kinematics.machine.machine import LinearAxis, Machine, RotaryAxis, Target
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    describe_symbol,
    find_unit,
    is_turn,
    list_error_motions,
    list_locations,
)
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_second_order_mm, is_nearly_linear
from truepath_simulators import machine_file
from truepath_simulators.machine.random_machine import random_machine

CHAINS = ["w-C-b-X-Y-Z-B-t", "w-C-A-b-X-Y-Z-t", "w-C-Y-b-X-Z-A-t", "w-b-X-Y-Z-C-A-t"]
CHAINS += ["w-X-Y-Z-C-B-b-t", "w-b-C-X-Y-Z-t"]
CHAINS += ["w-b-X-Y-Z-t", "w-Y-b-X-Z-t", "w-Y-X-b-Z-t"]
INCLINED = {"B": [0.0, 1.0, 1.0], "C": [0.2, -0.1, -1.0], "A": [-1.0, 0.0, 0.0]}
TURNING = {
    "A": {"min_deg": -100, "max_deg": 30, "origin_mm": [200, 150, -60]},
    "B": {"min_deg": -30, "max_deg": 110, "origin_mm": [10, -20, 40]},
    "C": {"min_deg": 0, "max_deg": 360, "origin_mm": [240, 190, -90]},
}


def content(chain, stands_on="workpiece", *, inclined=False):
    made = machine_file.load_machine("head-table")
    axes = {k: v for k, v in made["axes"].items() if k in "XYZ"}
    for name in chain.split("-"):
        if name in TURNING:
            direction = {"direction": INCLINED[name]} if inclined else {}
            axes[name] = {"type": "rotary", **TURNING[name], **direction}
    made |= {"kinematic_chain": chain, "axes": axes}
    made["tracker"] |= {"stands_on": stands_on}
    return made


def every_effect(machine):
    named = [(s, axis) for axis in machine.axes for s in list_error_motions(axis.name)]
    motions = [make_error_motion(symbol, axis, 48) for symbol, axis in named]
    places = [e for axis in machine.rotary_axes for e in list_axis_locations(axis)]
    square = list_squarenesses(("X", "Y", "Z"))
    return MachineModel(machine, (*motions, *square, *places))


def seen(machine, q, target, observer):
    n = len(q)
    place = machine.target(target)
    at = make_standstill(machine, q, np.tile(place.offset_mm, (n, 1)))
    return at.view_from(observer, np.full(n, place.on == "workpiece"))


@pytest.mark.parametrize(
    ("stands_on", "inclined"), [("workpiece", False), ("base", True)]
)
@pytest.mark.parametrize("chain", CHAINS)
def test_the_linear_form_is_exact_to_second_order(chain, stands_on, inclined, rng):
    stated = content(chain, stands_on, inclined=inclined)
    file, machine = machine_file.parse_machine(stated), machine_from_json(stated)
    q = rng.uniform(file.low, file.high, (25, len(file.axes)))
    model = every_effect(machine)
    for target in ("T2", "W1"):
        at = seen(machine, q, target, stands_on)
        reflector = file.reflector(target)

        def rest_mm(scale, at=at, reflector=reflector):
            truth = random_machine(file, 8, scale=scale)
            there = truth.point_mm(q, reflector, stands_on)
            nominal_mm = truth.nominal_point_mm(q, reflector, stands_on)
            assert np.allclose(at.point_mm, nominal_mm, atol=1e-9)
            # Parameters that state the errors of the truth machine.
            theta = np.zeros(model.size)
            known = truth.error_motions()
            stated = {**truth.squareness_rad, **truth.locations()}
            for effect in model.effects:
                if isinstance(effect, ErrorMotion):
                    values = known[effect.symbol].at(effect.spline.knots)
                    part = np.linalg.pinv(effect.gauge) @ values
                else:
                    part = stated[effect.name]
                theta[model.slices[effect.name]] = part
            linear = model.jacobian(at) @ theta
            size = np.abs(there - at.point_mm).max()
            return np.abs(there - at.point_mm - linear).max(), size

        rest, size = rest_mm(1.0)
        # The knots hold the truth to a thousandth; the rest is of second order.
        assert rest <= 2e-3 * size
        coarse, fine = rest_mm(300.0)[0], rest_mm(100.0)[0]
        if size > 0:
            assert coarse < 9.5 * fine


@pytest.mark.parametrize("chain", CHAINS[:4])
def test_errors_and_locations_are_nothing_at_the_axis_zero(chain):
    machine = machine_from_json(content(chain))
    q = np.zeros((1, len(machine.axes)))
    model = every_effect(machine)
    names = [*(f"E{d}{a.name}" for a in machine.rotary_axes for d in "XYZABC")]
    names += [s for a in machine.rotary_axes for s in list_locations(a.name)]
    columns = model.jacobian(make_standstill(machine, q))
    for name in names:
        assert np.abs(columns[:, :, model.slices[name]]).max() < 1e-9


def test_a_full_turn_is_cyclic_and_motions_across_the_axis_have_no_mean():
    machine = machine_from_json(content(CHAINS[0]))
    table = make_error_motion("EXC", machine.rotary_axes[1], 12)
    head = make_error_motion("EXB", machine.rotary_axes[0], 12)
    ends = table.rows(np.array([0.0, 360.0]))
    assert np.allclose(ends[0], ends[1])
    ends = head.rows(np.array([-30.0, 110.0]))
    assert not np.allclose(ends[0], ends[1])
    for axis in machine.rotary_axes:
        s = np.linspace(axis.low, axis.high, 20_001)
        weight = np.ones(len(s))
        weight[[0, -1]] = 0.5
        for symbol in list_error_motions(axis.name):
            mean = weight @ make_error_motion(symbol, axis, 9).rows(s) / weight.sum()
            along = {"B": "YB", "C": "ZC"}[axis.name]
            assert (np.abs(mean).max() < 1e-7) == (symbol[1] not in along)


def test_every_symbol_has_a_meaning_and_a_unit():
    symbols = [s for a in "XYZBC" for s in list_error_motions(a)]
    symbols += [*SQUARENESS, *list_locations("B"), *list_locations("C")]
    assert len({describe_symbol(s) for s in symbols}) == 41
    meanings = {
        "EYX": "straightness of X in Y",
        "EAX": "roll of X",
        "ECC": "positioning of C",
        "EXC": "radial motion of C in X",
        "EZC": "axial motion of C in Z",
        "EAC": "tilt of C about X",
        "XOC": "shift of the axis of C in X",
    }
    assert {symbol: describe_symbol(symbol) for symbol in meanings} == meanings
    assert {find_unit(s) for s in symbols} == {"um", "urad"}
    assert [find_unit(s) for s in ("XOC", "AOC", "EXC", "ECC")] == ["um", "urad"] * 2


def test_a_spindle_grows_along_itself_wherever_the_head_turns_it(rng):
    machine = machine_from_json(content("w-b-X-Y-Z-B-t"))
    q = rng.uniform(0.0, 100.0, (20, 4))
    at = replace(seen(machine, q, "T1", "workpiece"), time_s=np.linspace(0, 30, 20))
    grown = ToolGrowth(10.0, 0.0).displacement_mm(at, np.array([0.005]))
    size = 0.005 * (1.0 - np.exp(-at.time_s / 10.0))
    B = np.radians(q[:, 3])
    axis = np.stack([np.sin(B), np.zeros(20), np.cos(B)], axis=1)
    np.testing.assert_allclose(grown, size[:, None] * axis, atol=1e-12)


def test_an_eccentric_scale_moves_nothing_at_the_axis_zero(rng):
    machine = machine_from_json(content("w-b-X-Y-Z-C-t"))
    q = rng.uniform(0.0, 100.0, (20, 4))
    q[0, 3] = 0.0
    at = seen(machine, q, "T1", "workpiece")
    effect = RotaryEccentricity(machine.rotary("C"))
    moved = effect.displacement_mm(at, np.array([2e-5, 1e-5]))
    C = np.radians(q[:, 3])
    turn = 2e-5 * np.sin(C) + 1e-5 * (np.cos(C) - 1.0)
    np.testing.assert_allclose(
        moved, compute_arm("ECC", at) * turn[:, None], atol=1e-12
    )
    assert np.abs(moved[0]).max() == 0.0


AXES = {
    "X": LinearAxis("X", 0.0, 700.0),
    "Y": LinearAxis("Y", 0.0, 500.0),
    "Z": LinearAxis("Z", -400.0, 0.0),
    "C": RotaryAxis("C", -170.0, 170.0, (300.0, 200.0, -50.0), (0.0, 0.0, 1.0)),
}
SIDES = [((), ("X", "Y", "Z")), (("Y",), ("X", "Z")), (("X", "C"), ("Y", "Z"))]


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


@pytest.mark.parametrize("chain", SIDES, ids=["tool", "table", "turning"])
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
    model = build(*SIDES[0])
    position = rng.uniform([0.0, 0.0, -400.0], [700.0, 500.0, 0.0], (50, 3))
    at = make_standstill(model.machine, position)
    small = draw(model, rng, 0.01, 1e-5)
    assert is_nearly_linear(model, at, small)
    assert np.abs(compute_second_order_mm(model, at, small)).max() < 2e-5
    assert not is_nearly_linear(model, at, 100.0 * small)


def test_from_the_base_a_table_turns_the_other_way(rng):
    model = build(*SIDES[2])
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
