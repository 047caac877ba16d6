"""Files of machines with rotary axes: by the rule of the control, by the exact one."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from known_machines import (
    build_model,
    map_known,
    measure_left,
    spread,
    tabulate,
    write,
)
from truepath.compensation.account.rotary_residual import RotaryFiles, describe_rotary
from truepath.compensation.format_registry import load_format
from truepath.kinematics.conditions import make_standstill
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine

# A trunnion carries the workpiece; a head turns the tool.
MACHINES = ("trunnion", "head-table")


@pytest.fixture(scope="module", params=MACHINES)
def turning(request):
    """A machine that does nothing but turn too far or too little."""
    model, rng = build_model(load_machine(request.param)), np.random.default_rng(3)
    turns = {
        motion.name: 5e-5 * rng.standard_normal(len(motion.parameters))
        for motion in model.identifiable_motions
        if motion.symbol[1:] in ("AA", "BB", "CC")
    }
    return request.param, map_known(model, turns)


def make_truth(machine, errors):
    """The exact machine with the positioning of the result, and nothing else."""
    truth = perfect(parse_machine(load_machine(machine)))
    joints = dict(truth.joints)
    for axis in truth.machine.rotary_axes:
        turns, own = list(joints[axis.name].rotation), "ABC".index(axis.name)
        turn_rad = partial(errors.rotation_rad, axis.name)
        turns[own] = SimpleNamespace(at=lambda deg, of=turn_rad, k=own: of(deg)[:, k])
        joints[axis.name] = replace(joints[axis.name], rotation=tuple(turns))
    return replace(truth, joints=joints)


@pytest.mark.parametrize("name", ["linuxcnc", "siemens", "siemens-lec"])
def test_the_tool_stands_where_it_should_once_a_control_has_the_tables(turning, name):
    machine, errors = turning
    truth = make_truth(machine, errors)
    position = spread(errors.machine.axes, 200)
    before, after = measure_left(truth, tabulate(errors, name).write(errors), position)
    assert before.mean() > 0.003
    assert after.mean() < 0.03 * before.mean()


@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_a_wrapped_axis_that_counts_on_is_corrected_in_its_next_turn(turning, turns):
    machine, errors = turning
    files = tabulate(errors, "linuxcnc").write(errors)
    control = LoadedTables(files).correct(parse_machine(load_machine(machine)))
    low, high = np.array([(a.low, a.high) for a in errors.machine.axes]).T
    position = np.linspace(low, high, 90)[5:-5]
    here = control.added(position, np.ones_like(position))
    turns_fully = [getattr(one, "turns_fully", False) for one in errors.machine.axes]
    columns = np.flatnonzero(turns_fully)
    assert len(columns)
    position[:, columns] += 360.0 * turns
    there = control.added(position, np.ones_like(position))
    size = np.ptp(here[:, columns])
    assert np.abs(there - here)[:, columns].max() < 0.05 * size


def test_the_account_states_the_angle_and_what_it_does_at_the_tool(turning):
    _, errors = turning
    content = tabulate(errors, "linuxcnc").tabulate(errors)
    kind = load_format("linuxcnc")
    added = kind.read_rotary(kind.write(content), errors.machine)
    carried = describe_rotary(errors, RotaryFiles(content.rotary, added))
    left = describe_rotary(errors, RotaryFiles())  # of a format without such tables
    assert not load_format("fanuc").carries_rotary
    for axis in errors.machine.rotary_axes:
        one, other = carried[axis.name], left[axis.name]
        for what in ("positioning_urad", "at_tool_um"):
            assert one[what]["after"] < 0.035 * one[what]["before"]
            assert other[what]["after"] == other[what]["before"] > 1.0
        assert not one["table"]["repeats_each_turn"]  # a joint counts turns
        low, high = one["table"]["from_deg"], one["table"]["to_deg"]
        beyond = 360.0 if axis.turns_fully else 0.0
        assert (low, high) == pytest.approx((axis.low - beyond, axis.high + beyond))
        assert other["table"] is None
        assert one["not_in_files"]


@pytest.fixture(scope="module", params=MACHINES)
def erring(request):
    """A machine with errors of every kind."""
    model = build_model(load_machine(request.param))
    size = np.array([5e-3 if p.unit == "mm" else 2e-5 for p in model.parameters])
    theta = size * np.random.default_rng(8).standard_normal(model.size)
    return request.param, map_known(model, theta, size**2)


def find_left(errors, position, added):
    """The error once the straight axes have moved as the control adds."""
    machine = errors.machine
    error = errors.error_mm(position)
    moved = make_standstill(machine, position + added).chain.point_mm
    still = make_standstill(machine, position).chain.point_mm
    return error + moved - still


@pytest.mark.parametrize("choice", ["fixed", "followed"])
def test_an_isg_volume_brings_the_tool_where_it_should_be_at_any_angle(erring, choice):
    name, errors = erring
    made = tabulate(errors, "isg-csv", 5.0, tool_length=choice)
    files = made.write(errors)
    position = spread(errors.machine.axes, 250)
    tool = abs(errors.machine.target().offset_mm[2])
    control = LoadedTables(files, Rules(tool_length_mm=tool)).correct(
        parse_machine(load_machine(name))
    )
    added = control.added(position, np.ones_like(position))
    ours = made.kind.read(files, errors.machine)(position, 1.0)
    before = np.linalg.norm(errors.error_mm(position), axis=1)
    after = np.linalg.norm(find_left(errors, position, added), axis=1)
    assert before.mean() > 0.01
    assert after.mean() < 0.02 * before.mean()
    np.testing.assert_allclose(ours, added[:, :3], atol=2e-4)


def test_the_account_states_the_error_over_all_axes(erring):
    _, errors = erring
    # LinuxCNC has 256 rows for the turn that was measured and its two neighbours.
    for name, share, left in (("isg-csv", 0.03, 0.03), ("linuxcnc", 1.0, 0.05)):
        stated = write(errors, name, 5.0)
        assert stated.over["before"] > 5.0
        assert stated.over["after"] < share * stated.over["before"]
        for axis in errors.machine.rotary_axes:
            one = stated.rotary[axis.name]
            assert one["at_tool_um"]["after"] < left * one["at_tool_um"]["before"]
            angle = one["positioning_urad"]
            is_turned = angle["after"] < left * angle["before"]
            assert is_turned == (name == "linuxcnc")
            assert bool(one["not_in_files"]) == is_turned
