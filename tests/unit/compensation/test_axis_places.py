"""Where rotary axes are, as a control takes it, and as the exact machine has it."""

import json

import pytest

from known_machines import (
    build_model,
    displace,
    map_known,
    measure_left,
    spread,
    tabulate,
    write,
)
from truepath.compensation.account.rotary_residual import RotaryFiles, describe_rotary
from truepath.compensation.format_registry import load_format
from truepath.compensation.tables.rotary_axis_locations import find_locations
from truepath.errors import BadInput
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine

SHIFT_MM = {"XOC": 0.012, "YOC": -0.02, "ZOT": 0.03, "ACROSS": -0.015}


@pytest.fixture(scope="module", params=["A", "B"])
def shifted(request):
    """A trunnion, its tilting axis A or B, whose axes are off their place alone."""
    tilting = request.param
    text = json.dumps(load_machine("trunnion")).replace('"A"', f'"{tilting}"')
    content = json.loads(text.replace("w-C-A", f"w-C-{tilting}"))
    names = {"ZOT": f"ZO{tilting}", "ACROSS": f"{'YX'[tilting == 'B']}O{tilting}"}
    values = {names.get(name, name): value for name, value in SHIFT_MM.items()}
    return content, map_known(build_model(content), values)


def test_pins_of_the_kinematics_bring_the_tool_where_it_should_be(shifted):
    content, errors = shifted
    files = tabulate(errors, "linuxcnc").write(errors)
    pins = {name: text for name, text in files.items() if name.endswith(".hal")}
    truth = displace(content, find_locations(errors))
    before, after = measure_left(truth, pins, spread(errors.machine.axes, 300))
    assert before.max() > 0.02
    assert after.max() < 2e-5
    # With the tables of the joints in one order as well.
    assert LoadedTables(files).correct(truth.machine) is not None


@pytest.mark.parametrize("name", ["linuxcnc", "json"])
def test_what_is_read_back_is_the_location_and_the_account_says_what_it_leaves(
    shifted, name
):
    _, errors = shifted
    files, kind = tabulate(errors, name).write(errors), load_format(name)
    located = kind.read_locations(files, errors.machine)
    account = describe_rotary(errors, RotaryFiles(located=located))
    for place in find_locations(errors):
        one = account[place.axis.name]
        assert one["location_at_tool_um"]["before"] > 5.0
        assert one["location_at_tool_um"]["after"] < 1e-3
        for symbol, value in place.location.items():
            if value:
                assert located[symbol] == pytest.approx(value, abs=1e-6)
                assert symbol not in one["not_in_files"]
    if name == "linuxcnc":  # which has no pins for tilts
        assert {"AOC", "BOC"} <= set(account["C"]["not_in_files"])
    kept = describe_rotary(errors, RotaryFiles())["C"]["location_at_tool_um"]
    assert kept["after"] == kept["before"]


def test_pins_that_are_not_of_the_machine_are_refused_and_no_trunnion_gets_none(
    shifted,
):
    content, errors = shifted
    machine = errors.machine
    text = "setp maxkins.pivot-length 100\n"
    with pytest.raises(BadInput, match="is no pin of this machine"):
        load_format("linuxcnc").read_locations({"c-kinematics.hal": text}, machine)
    other = "A" if "B" in machine.axis_names else "B"
    wrong = f"setp xyz{other.lower()}c-trt-kins.x-rot-point 1\n"
    with pytest.raises(SimulatorError, match="has no axes"):
        LoadedTables({"c.hal": wrong}).correct(parse_machine(content))
    head = map_known(build_model(load_machine("head-table")), {})
    files = tabulate(head, "linuxcnc").write(head)
    assert not [name for name in files if name.endswith(".hal")]


@pytest.mark.parametrize(
    ("machine", "name"),
    [
        *(("trunnion", name) for name in ("linuxcnc", "siemens", "isg-csv", "json")),
        *(("head-table", name) for name in ("siemens", "isg-csv")),
    ],
)
def test_a_place_is_corrected_once_where_an_axis_never_comes_to_its_zero(machine, name):
    content = load_machine(machine)
    content["axes"]["C"] |= {"min_deg": 30.0, "max_deg": 300.0}
    tilting = "A" if machine == "trunnion" else "B"
    content["axes"][tilting] |= {"min_deg": 20.0, "max_deg": 95.0}
    model = build_model(content, intervals=4)
    places = {"XOC": 0.03, "YOC": -0.02, f"ZO{tilting}": 0.025}
    known = {one: value for one, value in places.items() if one in model.slices}
    errors = map_known(model, known)
    written = write(errors, name, 100.0)
    assert written.over["after"] < 0.02 * written.over["before"]
    if name == "json":  # which no control reads: software places the axes by it
        return
    truth = displace(content, find_locations(errors))
    position = spread(errors.machine.axes, 200)
    before, after = measure_left(truth, written.files, position)
    assert before.max() > 0.04
    assert after.max() < 0.02 * before.max()
