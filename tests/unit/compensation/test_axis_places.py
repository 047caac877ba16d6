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
from truepath.compensation.account.rotary_left import RotaryFiles, describe_rotary
from truepath.compensation.installed import load_format
from truepath.compensation.tables.axis_places import find_places
from truepath.errors import BadInput
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine

SHIFT_MM = {"XOC": 0.012, "YOC": -0.02, "ZOT": 0.03, "ACROSS": -0.015}


def describe_machine(tilting):
    """The trunnion, its tilting axis A or B."""
    content = load_machine("trunnion")
    if tilting == "B":
        text = json.dumps(content).replace('"A"', '"B"').replace("w-C-A", "w-C-B")
        content = json.loads(text)
    return content


@pytest.fixture(scope="module", params=["A", "B"])
def shifted(request):
    """A trunnion whose axes are off their place, and do nothing else."""
    tilting = request.param
    content = describe_machine(tilting)
    names = {"ZOT": f"ZO{tilting}", "ACROSS": f"{'YX'[tilting == 'B']}O{tilting}"}
    values = {names.get(name, name): value for name, value in SHIFT_MM.items()}
    return content, map_known(build_model(content), values)


def write_files(errors, name):
    return tabulate(errors, name).write(errors)


def test_pins_of_the_kinematics_bring_the_tool_where_it_should_be(shifted):
    content, errors = shifted
    files = write_files(errors, "linuxcnc")
    pins = {name: text for name, text in files.items() if name.endswith(".hal")}
    truth = displace(content, find_places(errors))
    before, after = measure_left(truth, pins, spread(errors.machine.axes, 300))
    assert before.max() > 0.02
    assert after.max() < 2e-5
    # With the tables of the joints in one order as well.
    assert LoadedTables(files).correct(truth.machine) is not None


def test_pins_are_the_place_in_the_drawing_and_what_it_is_off(shifted):
    _, errors = shifted
    (text,) = (
        text for name, text in write_files(errors, "linuxcnc").items() if ".hal" in name
    )
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    module = lines[0].split()[1].partition(".")[0]
    values = {line.split()[1].partition(".")[2]: line.split()[2] for line in lines}
    assert values["x-rot-point"] == "250.012000"  # 250 + XOC
    assert values["y-rot-point"] == "224.980000"
    assert values["z-rot-point"] == "-170.000000"
    assert values["z-offset"] == "50.030000"  # -120 + 0.03 - (-170)
    across = {"xyzac-trt-kins": "0.005000", "xyzbc-trt-kins": "-0.027000"}
    letter = "y" if module == "xyzac-trt-kins" else "x"
    # The tilting axis is off by -0.015 across, C by -0.020 (Y) or 0.012 (X).
    assert values[f"{letter}-offset"] == across[module]
    assert text.startswith("# by hand\n")


@pytest.mark.parametrize("name", ["linuxcnc", "json"])
def test_what_is_read_back_is_the_location_and_the_account_says_what_it_leaves(
    shifted, name
):
    _, errors = shifted
    files, kind = write_files(errors, name), load_format(name)
    located = kind.read_locations(files, errors.machine)
    account = describe_rotary(errors, RotaryFiles(located=located))
    for place in find_places(errors):
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


def test_a_machine_that_is_no_trunnion_gets_no_pins():
    errors = map_known(build_model(load_machine("head-table")), {})
    assert not [n for n in write_files(errors, "linuxcnc") if n.endswith(".hal")]


def test_pins_that_are_not_of_the_machine_are_refused(shifted):
    content, errors = shifted
    machine = errors.machine
    text = "setp maxkins.pivot-length 100\n"
    with pytest.raises(BadInput, match="is no pin of this machine"):
        load_format("linuxcnc").read_locations({"c-kinematics.hal": text}, machine)
    other = "A" if "B" in machine.axis_names else "B"
    wrong = f"setp xyz{other.lower()}c-trt-kins.x-rot-point 1\n"
    with pytest.raises(SimulatorError, match="has no axes"):
        LoadedTables({"c.hal": wrong}).correct(parse_machine(content))


@pytest.mark.parametrize(
    ("machine", "name"),
    [
        ("trunnion", "linuxcnc"),
        ("trunnion", "siemens"),
        ("trunnion", "isg-csv"),
        ("trunnion", "json"),
        ("head-table", "siemens"),
        ("head-table", "isg-csv"),
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
    truth = displace(content, find_places(errors))
    position = spread(errors.machine.axes, 200)
    before, after = measure_left(truth, written.files, position)
    assert before.max() > 0.04
    assert after.max() < 0.02 * before.max()
