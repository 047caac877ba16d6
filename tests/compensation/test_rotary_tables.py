"""Tables of rotary axes: by the rule of the control, and by the exact machine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from truepath.compensation.account.rotary_left import RotaryFiles, describe_rotary
from truepath.compensation.export import export_result
from truepath.compensation.installed import load_format
from truepath.compensation.tables.error_map import ErrorMap, map_errors
from truepath.compensation.tables.tabulation import Tabulation
from truepath.compensation.tables.unmeasured import find_measured_ranges
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_simulators.compensation.correction import measure_deviation_mm
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
    machine = machine_from_json(load_machine(request.param), file="machine.json")
    offsets = np.array([target.offset_mm for target in machine.targets])
    model, _ = build_identifiable_model(machine, offsets)
    theta, rng = np.zeros(model.size), np.random.default_rng(3)
    for motion in model.identifiable_motions:
        if motion.symbol[1:] in ("AA", "BB", "CC"):
            part = model.slices[motion.name]
            theta[part] = 5e-5 * rng.standard_normal(part.stop - part.start)
    covariance = 1e-16 * np.eye(model.size)
    return request.param, map_errors(CalibrationResult(model, theta, covariance))


def tabulate(errors, name):
    """What makes files of errors, with tables over the whole travel."""
    ranges = find_measured_ranges(errors.machine, {}, None)
    return Tabulation(load_format(name), "c", ("by hand",), 50.0, ranges)


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


def spread(errors, count):
    """Positions from one end of all travels to the other."""
    axes = errors.machine.axes
    return np.linspace([a.low for a in axes], [a.high for a in axes], count)


@every_format
def test_the_tool_stands_where_it_should_once_a_control_has_the_tables(turning, name):
    machine, errors = turning
    files = write_files(errors, name)
    truth = make_truth(machine, errors)
    position = spread(errors, 200)
    for column in position.T:  # any order, so that axes move apart
        np.random.default_rng(1).shuffle(column)
        column[:] = np.roll(column, 7)
    correction = LoadedTables(files).correct(truth.machine)
    before, after = (
        np.linalg.norm(measure_deviation_mm(truth, one, position), axis=1).mean()
        for one in (None, correction)
    )
    assert before > 0.003
    assert after < 0.03 * before


@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_a_wrapped_axis_that_counts_on_is_corrected_in_its_next_turn(turning, turns):
    machine, errors = turning
    files = write_files(errors, "linuxcnc")
    control = LoadedTables(files).correct(parse_machine(load_machine(machine)))
    position = spread(errors, 90)[5:-5]
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
    position = spread(errors, 77)
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


def test_files_of_a_machine_with_rotary_axes_come_with_that_account(turning):
    _, errors = turning
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
