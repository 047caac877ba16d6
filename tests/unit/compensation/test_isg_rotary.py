"""ISG_CSV of machines with rotary axes: what the volume's composition takes away."""

import numpy as np
import pytest

from known_machines import build_model, map_known, spread, tabulate, write
from truepath.kinematics.conditions import make_standstill
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine


@pytest.fixture(scope="module", params=["trunnion", "head-table"])
def erring(request):
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
def test_the_tool_stands_where_it_should_at_any_angle(erring, choice):
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
