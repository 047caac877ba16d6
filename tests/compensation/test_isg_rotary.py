"""ISG_CSV of machines with rotary axes: what the volume's composition takes away."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.compensation.export import export_result
from truepath.compensation.installed import load_format
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.tabulation import Tabulation
from truepath.compensation.tables.unmeasured import find_measured_ranges
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine


@pytest.fixture(scope="module", params=["trunnion", "head-table"])
def erring(request):
    """A machine with every error, of its rotary axes as well."""
    machine = machine_from_json(load_machine(request.param), file="machine.json")
    offsets = np.array([target.offset_mm for target in machine.targets])
    model, _ = build_identifiable_model(machine, offsets)
    size = np.array([5e-3 if p.unit == "mm" else 2e-5 for p in model.parameters])
    theta = size * np.random.default_rng(8).standard_normal(model.size)
    return request.param, map_errors(CalibrationResult(model, theta, np.diag(size**2)))


def write_file(errors, choice):
    kind = load_format("isg-csv", {"tool_length": choice})
    ranges = find_measured_ranges(errors.machine, {}, None)
    return kind, Tabulation(kind, "c", ("by hand",), 5.0, ranges).write(errors)


def spread(errors, count):
    axes = errors.machine.axes
    low, high = (np.array([getattr(a, end) for a in axes]) for end in ("low", "high"))
    unit = np.random.default_rng(5).uniform(size=(count, len(axes)))
    return low + unit * (high - low)


def find_left(errors, position, added):
    """The error once the straight axes have moved as the control adds."""
    machine = errors.machine
    error = errors.error_mm(position)
    moved = make_standstill(machine, position + added).chain.point_mm
    still = make_standstill(machine, position).chain.point_mm
    return error + moved - still


@pytest.mark.parametrize("choice", ["fixed", "followed"])
def test_the_tool_stands_where_it_should_at_any_angle(erring, choice):
    name, errors = erring
    kind, files = write_file(errors, choice)
    position = spread(errors, 250)
    tool = abs(errors.machine.target().offset_mm[2])
    control = LoadedTables(files, Rules(tool_length_mm=tool)).correct(
        parse_machine(load_machine(name))
    )
    added = control.added(position, np.ones_like(position))
    ours = kind.read(files, errors.machine)(position, 1.0)
    before = np.linalg.norm(errors.error_mm(position), axis=1)
    after = np.linalg.norm(find_left(errors, position, added), axis=1)
    assert before.mean() > 0.01
    assert after.mean() < 0.02 * before.mean()
    np.testing.assert_allclose(ours, added[:, :3], atol=2e-4)


def test_the_account_states_the_error_over_all_axes(erring):
    _, errors = erring
    # LinuxCNC has 256 rows for the turn that was measured and its two neighbours.
    for name, share, left in (("isg-csv", 0.03, 0.03), ("linuxcnc", 1.0, 0.05)):
        account = export_result(errors, name, "c", spacing_mm=5.0).account
        stated = account["over_all_axes_um"]
        assert stated["before"] > 5.0
        assert stated["after"] < share * stated["before"]
        for axis in errors.machine.rotary_axes:
            one = account["rotary"][axis.name]
            assert one["at_tool_um"]["after"] < left * one["at_tool_um"]["before"]
            angle = one["positioning_urad"]
            is_turned = angle["after"] < left * angle["before"]
            assert is_turned == (name == "linuxcnc")
            assert bool(one["not_in_files"]) == is_turned


def test_the_file_names_centres_locations_and_the_tip(erring):
    _, errors = erring
    _, files = write_file(errors, "fixed")
    (text,) = files.values()
    lines = text.splitlines()
    assert "P0X  P0Y  P0Z" in lines
    for axis in errors.machine.rotary_axes:
        own = axis.name
        at = lines.index(f"PX{own}  PY{own}  PZ{own}")
        assert [float(one) for one in lines[at + 1].split()] == list(axis.origin_mm)
        head = f"{own}  EX{own}  EY{own}  EZ{own}  EA{own}  EB{own}  EC{own}"
        first = lines[lines.index(head) + 1].split()
        assert float(first[0]) == axis.low
    assert any(line.startswith(("X0C", "X0B")) for line in lines)
