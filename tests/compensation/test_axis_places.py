"""Where rotary axes are, as a control takes it, and as the exact machine has it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.compensation.account.rotary_left import RotaryFiles, describe_rotary
from truepath.compensation.export import export_result
from truepath.compensation.installed import load_format
from truepath.compensation.tables.axis_places import find_places
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.tabulation import Tabulation
from truepath.compensation.tables.unmeasured import find_measured_ranges
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_simulators.compensation.correction import measure_deviation_mm
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.truth_machine import perfect
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
    machine = machine_from_json(content, file="machine.json")
    offsets = np.array([target.offset_mm for target in machine.targets])
    model, _ = build_identifiable_model(machine, offsets)
    theta = np.zeros(model.size)
    names = {"ZOT": f"ZO{tilting}", "ACROSS": f"{'YX'[tilting == 'B']}O{tilting}"}
    for name, value in SHIFT_MM.items():
        theta[model.slices[names.get(name, name)]] = value
    result = CalibrationResult(model, theta, 1e-16 * np.eye(model.size))
    return content, map_errors(result)


def write_files(errors, name):
    ranges = find_measured_ranges(errors.machine, {}, None)
    return Tabulation(load_format(name), "c", ("by hand",), 50.0, ranges).write(errors)


def make_truth(content, errors):
    truth = perfect(parse_machine(content))
    joints = dict(truth.joints)
    for place in find_places(errors):
        own = place.axis.name
        shift = tuple(place.location.get(f"{one}O{own}", 0.0) for one in "XYZ")
        joints[own] = replace(joints[own], shift_mm=shift)
    return replace(truth, joints=joints)


def test_pins_of_the_kinematics_bring_the_tool_where_it_should_be(shifted):
    content, errors = shifted
    files = write_files(errors, "linuxcnc")
    pins = {name: text for name, text in files.items() if name.endswith(".hal")}
    truth = make_truth(content, errors)
    low, high = truth.machine.low, truth.machine.high
    unit = np.random.default_rng(2).uniform(size=(300, len(low)))
    position = low + unit * (high - low)
    correction = LoadedTables(pins).correct(truth.machine)
    before, after = (
        np.linalg.norm(measure_deviation_mm(truth, one, position), axis=1).max()
        for one in (None, correction)
    )
    assert before > 0.02
    assert after < 2e-5
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
    kept = describe_rotary(errors, RotaryFiles())["C"]["location_at_tool_um"]
    assert kept["after"] == kept["before"]


def test_tilts_have_no_pins_and_are_named(shifted):
    _, errors = shifted
    located = load_format("linuxcnc").read_locations(
        write_files(errors, "linuxcnc"), errors.machine
    )
    account = describe_rotary(errors, RotaryFiles(located=located))
    assert {"AOC", "BOC"} <= set(account["C"]["not_in_files"])


def test_a_machine_that_is_no_trunnion_gets_no_pins():
    machine = machine_from_json(load_machine("head-table"), file="machine.json")
    offsets = np.array([target.offset_mm for target in machine.targets])
    model, _ = build_identifiable_model(machine, offsets)
    theta, covariance = np.zeros(model.size), np.eye(model.size)
    errors = map_errors(CalibrationResult(model, theta, covariance))
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
    machine = machine_from_json(content, file="machine.json")
    offsets = np.array([target.offset_mm for target in machine.targets])
    model, _ = build_identifiable_model(machine, offsets, intervals=4)
    theta = np.zeros(model.size)
    places = {"XOC": 0.03, "YOC": -0.02, f"ZO{tilting}": 0.025}
    for symbol in places.keys() & model.slices.keys():
        theta[model.slices[symbol]] = places[symbol]
    errors = map_errors(CalibrationResult(model, theta, 1e-16 * np.eye(model.size)))
    export = export_result(errors, name, "c", spacing_mm=100.0)
    over = export.account["over_all_axes_um"]
    assert over["after"] < 0.02 * over["before"]
    if name == "json":  # which no control reads: software places the axes by it
        return
    truth, rng = make_truth(content, errors), np.random.default_rng(3)
    low, high = truth.machine.low, truth.machine.high
    position = low + rng.uniform(size=(200, len(low))) * (high - low)
    before, after = (
        np.linalg.norm(measure_deviation_mm(truth, one, position), axis=1).max()
        for one in (None, LoadedTables(export.files).correct(truth.machine))
    )
    assert before > 0.04
    assert after < 0.02 * before
