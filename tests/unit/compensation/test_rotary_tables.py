"""Tables of rotary axes: by the rule of the control, and by the exact machine."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from known_machines import (
    build_model,
    map_known,
    measure_left,
    spread,
    tabulate,
)
from truepath.compensation.account.rotary_left import RotaryFiles, describe_rotary
from truepath.compensation.export import export_result
from truepath.compensation.installed import load_format
from truepath.compensation.tables.error_map import ErrorMap
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine

CARRYING = ("linuxcnc", "siemens", "siemens-lec")
every_format = pytest.mark.parametrize("name", CARRYING)
# A trunnion carries the workpiece; a head turns the tool.
MACHINES = ("trunnion", "head-table")


@dataclass(frozen=True)
class Positioning:
    """ECC as a result has it, for an exact machine."""

    errors: ErrorMap
    axis: str

    def at(self, position_deg):
        """Values in rad."""
        turned = self.errors.rotation_rad(self.axis, position_deg)
        return turned[:, "ABC".index(self.axis)]


@pytest.fixture(scope="module", params=MACHINES)
def turning(request):
    """A machine that does nothing but turn too far or too little."""
    model, rng = build_model(load_machine(request.param)), np.random.default_rng(3)
    parts = {
        motion.name: model.slices[motion.name]
        for motion in model.identifiable_motions
        if motion.symbol[1:] in ("AA", "BB", "CC")
    }
    turns = {
        name: 5e-5 * rng.standard_normal(part.stop - part.start)
        for name, part in parts.items()
    }
    return request.param, map_known(model, turns)


def write_files(errors, name):
    """The files of a format, by name."""
    return tabulate(errors, name).write(errors)


def make_truth(machine, errors):
    """The exact machine with the positioning of the result, and nothing else."""
    truth = perfect(parse_machine(load_machine(machine)))
    joints = dict(truth.joints)
    for axis in truth.machine.rotary_axes:
        turns = list(joints[axis.name].rotation)
        turns["ABC".index(axis.name)] = Positioning(errors, axis.name)
        joints[axis.name] = replace(joints[axis.name], rotation=tuple(turns))
    return replace(truth, joints=joints)


def along_all(errors, count):
    """Positions from one end of all travels to the other."""
    axes = errors.machine.axes
    return np.linspace([a.low for a in axes], [a.high for a in axes], count)


@every_format
def test_the_tool_stands_where_it_should_once_a_control_has_the_tables(turning, name):
    machine, errors = turning
    truth = make_truth(machine, errors)
    position = spread(errors.machine.axes, 200)
    before, after = measure_left(truth, write_files(errors, name), position)
    assert before.mean() > 0.003
    assert after.mean() < 0.03 * before.mean()


@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_a_wrapped_axis_that_counts_on_is_corrected_in_its_next_turn(turning, turns):
    machine, errors = turning
    files = write_files(errors, "linuxcnc")
    control = LoadedTables(files).correct(parse_machine(load_machine(machine)))
    position = along_all(errors, 90)[5:-5]
    here = control.added(position, np.ones_like(position))
    columns = [
        column
        for column, axis in enumerate(errors.machine.axes)
        if getattr(axis, "turns_fully", False)
    ]
    assert columns
    position[:, columns] += 360.0 * turns
    there = control.added(position, np.ones_like(position))
    size = np.ptp(here[:, columns])
    assert np.abs(there - here)[:, columns].max() < 0.05 * size


@every_format
def test_our_reader_and_the_simulated_control_add_the_same(turning, name):
    machine, errors = turning
    files = write_files(errors, name)
    added = load_format(name).read_rotary(files, errors.machine)
    assert set(added) == {axis.name for axis in errors.machine.rotary_axes}
    position = along_all(errors, 77)
    control = LoadedTables(files).correct(parse_machine(load_machine(machine)))
    other = control.added(position, np.ones_like(position))
    for axis, one in added.items():
        column = errors.machine.axis_names.index(axis)
        ours = one.read(position[:, column])
        np.testing.assert_allclose(ours, other[:, column], atol=1e-9)


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


def test_files_of_a_machine_with_rotary_axes_come_with_that_account():
    errors = map_known(build_model(load_machine("trunnion")), {"ECC": 5e-5})
    rng = np.random.default_rng(4)
    theta = errors.result.theta + 1e-5 * rng.standard_normal(errors.result.model.size)
    both = replace(errors, result=replace(errors.result, theta=theta))
    account = export_result(both, "siemens-lec", "c", spacing_mm=50.0).account
    names = [axis.name for axis in errors.machine.rotary_axes]
    assert list(account["rotary"]) == names
    assert "beside their positioning" in account["not_carried"]
    assert all(one["table"]["points"] >= 2 for one in account["rotary"].values())


def test_a_table_of_a_full_turn_repeats_and_ends_as_it_begins(turning):
    _, errors = turning
    (text,) = write_files(errors, "siemens-lec").values()
    rows = dict(line.split("=") for line in text.splitlines() if line[0] == "$")
    full = [axis for axis in errors.machine.rotary_axes if axis.turns_fully]
    assert full
    for axis in full:
        name = f"{axis.name}1"
        assert rows[f"$AA_ENC_COMP_IS_MODULO[0,{name}]"] == "1"
        ends = [float(rows[f"$AA_ENC_COMP_{e}[0,{name}]"]) for e in ("MIN", "MAX")]
        assert ends[1] - ends[0] == 360.0
        assert float(rows[f"$AA_ENC_COMP_STEP[0,{name}]"]) == 2.5
        first, last = (rows[f"$AA_ENC_COMP[0,{k},{name}]"] for k in (0, 144))
        assert first == last


def test_a_table_that_turns_too_little_is_sent_on(turning):
    """ECC is of the tool relative to the workpiece: a table by ECC turns too little."""
    _, errors = turning
    files = write_files(errors, "linuxcnc")
    added = load_format("linuxcnc").read_rotary(files, errors.machine)
    place = np.array([20.0])
    for axis, one in added.items():
        error = np.degrees(Positioning(errors, axis).at(place))
        sense = 1.0 if axis in errors.machine.workpiece_side else -1.0
        np.testing.assert_allclose(one.read(place), sense * error, atol=5e-5)
