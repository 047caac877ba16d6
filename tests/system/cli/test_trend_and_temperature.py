"""`trend` and `temperature`: a machine that warms, from short bundles to files."""

import json
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

from recorded import load_small, record_path
from truepath.cli.command import run
from truepath.compensation.residual_error import remove_rigid_motion
from truepath.files.bundle.bundle import read_bundle, zip_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import read_result
from truepath.files.earlier.temperature_file import read_result_at
from truepath.jobs.workers.analysis_tasks import follow_recorded
from truepath.planning.default_path import default_path
from truepath.results.prediction import predict
from truepath.service.api.models.results.discovery import TrendOut
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.recording import write_bundle_files
from truepath_simulators.worlds.synthetic import Setting

load_slow_tracker = partial(load_small, share=1.0)


def stretch(truth, name, strain):
    """Return the machine with a linear axis longer by a strain, from its zero on."""
    axes = truth.machine.linear_axes
    column, axis = next((k, a) for k, a in enumerate(axes) if a.name == name)
    joint = truth.joints[name]
    motions = list(joint.translation)
    motions[column] = motions[column].shift(strain * (axis.low - axis.zero_mm), strain)
    grown = replace(joint, translation=tuple(motions))
    return replace(truth, joints={**truth.joints, name: grown})


def record_warm(content, path, truth, seed):
    return record_path(content, path, seed, setting=Setting(truth=truth))[1]


HOURS, TAU_H, GROWTH = (0.0, 0.3, 0.9, 2.0), 0.5, 60e-6
AT = ",".join(map(str, HOURS))


def write_bundles(content, path, folder):
    truth = random_machine(parse_machine(content), 5)
    places = [folder / f"run{number}" for number in range(len(HOURS))]
    for number, place in enumerate(places):
        grown = stretch(truth, "X", -GROWTH * np.expm1(-HOURS[number] / TAU_H))
        write_bundle_files(place, record_warm(content, path, grown, 40 + number))
    return places


@pytest.fixture(scope="module")
def warming(tmp_path_factory):
    content = load_slow_tracker("demo")
    for axis in content["axes"].values():
        axis["max_mm"] = axis["min_mm"] + 300.0
    path = default_path(machine_from_json(content, file=""), 9000.0, lines=14)
    return write_bundles(content, path, tmp_path_factory.mktemp("warming"))


def find_growth_um(content):
    """Return how the far end of X grew since the first Run, and in truth."""
    times = [*content["runs"], *content["later"]]
    tables = [at["error_tables"]["EXX"] for at in times]
    far_end_um = np.array([table["value_um"][-1] for table in tables])
    length_mm = tables[0]["position_mm"][-1] - tables[0]["position_mm"][0]
    hours = np.array([at["time_h"] for at in times])
    grown_um = -1e3 * GROWTH * length_mm * np.expm1(-hours / TAU_H)
    return far_end_um - far_end_um[0], grown_um


def test_a_scale_that_warms_is_followed_and_said_when_due(command, warming, tmp_path):
    asked = ["--at", AT, "--limit", "4", "--later", "1", "-o", tmp_path]
    command.run("trend", *warming, *asked)
    content = json.loads((tmp_path / "trend.json").read_text())
    assert content["schema"] == "trend/1"
    assert [at["time_h"] for at in content["runs"]] == pytest.approx(HOURS)
    found_um, grown_um = find_growth_um(content)
    assert np.abs(found_um - grown_um).max() < 1.5
    said = ("due", "cannot-be-said", "not-within-horizon")
    assert content["outlook"]["state"] in said
    TrendOut.model_validate(content, extra="forbid")
    page = (tmp_path / "report.html").read_text()
    for shown in (content["outlook"]["sentence"], "spindle", "<svg"):
        assert shown in page
    asked = ["--at", "0,1,2", "-o", tmp_path / "out"]
    said = command.refuse("trend", *warming[:2], warming[0], *asked)
    assert "run0 (1) and run0 (3) are the same Run" in said


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--at", "0,1"], "2 times are given for 4 Runs"),
        (["--at", "0,2,1,3"], "do not increase"),
        (["--at", "0,x"], "write hours"),
        ([], "--at"),
        (["--at", AT, "--temperature", "oil=20"], "has no temperature oil"),
        (["--at", AT, "--temperature", "X"], "NAME=DEGC"),
    ],
)
def test_what_is_wrong_with_times_is_said(command, warming, tmp_path, options, problem):
    order = ["trend", *warming, "-o", tmp_path / "out", *options]
    assert problem in command.refuse(*order)


def test_the_task_of_a_job_writes_what_the_command_writes(warming, tmp_path):
    names = ["cold", "warm"]
    zipped = [tmp_path / f"{name}.zip" for name in names]
    for file, bundle in zip(zipped, warming, strict=False):
        file.write_bytes(zip_bundle(read_bundle(bundle)))
    asked = {"at_h": [8.0, 9.0], "limit_um": 4.0}
    files, told = list(map(str, zipped)), Mock()
    follow_recorded(files, names, str(tmp_path / "out"), asked, on_progress=told)
    content = json.loads((tmp_path / "out" / "trend.json").read_text())
    TrendOut.model_validate(content, extra="forbid")
    assert [at["name"] for at in content["runs"]] == names
    assert [at["time_h"] for at in content["runs"]] == [0.0, 1.0]
    assert content["outlook"]["state"] == "not-known"
    stages = {call.args[1] for call in told.call_args_list}
    assert {"estimating", "following"} <= stages


@pytest.mark.long
@pytest.mark.timeout(600)
def test_five_axes_with_six_targets_are_followed(command, tmp_path):
    content = load_slow_tracker("trunnion")
    path = default_path(machine_from_json(content, file=""))
    bundles = write_bundles(content, path, tmp_path)
    asked = ["--at", AT, "--limit", "5", "-o", tmp_path / "out"]
    command.run("trend", *bundles, *asked)
    content = json.loads((tmp_path / "out" / "trend.json").read_text())
    TrendOut.model_validate(content, extra="forbid")
    found_um, grown_um = find_growth_um(content)
    assert np.abs(found_um - grown_um).max() < 1.5
    places = [at["axis_location"] for at in content["runs"]]
    assert {"YOA", "XOC"} <= places[0].keys()
    for name in ("YOA", "XOC"):
        assert np.ptp([place[name]["value_um"] for place in places]) < 2.0


DEGC, THERMOMETER_K = (18.0, 25.0, 20.0, 22.0), (0.1, -0.05, -0.1, 0.08)
GROWTH_PER_K = {"X": 11e-6, "Y": 8e-6, "Z": 14e-6}
LEAN_PER_K = 4e-6  # of Y about Z
UNSEEN_DEGC = 23.5


def warm(truth, celsius):
    """Return the machine at a temperature: axes grow, Y leans."""
    for name, growth in GROWTH_PER_K.items():
        truth = stretch(truth, name, growth * (celsius - 20.0))
    leaning = truth.joints["Y"]
    x, *others = leaning.translation
    motions = (x.shift(0.0, LEAN_PER_K * (celsius - 20.0)), *others)
    joints = {**truth.joints, "Y": replace(leaning, translation=motions)}
    return replace(truth, joints=joints)


def analyse_at(content, path, truth, number, folder):
    recording = record_warm(content, path, warm(truth, DEGC[number]), 60 + number)
    shown = recording.temperatures
    celsius = shown.celsius + DEGC[number] + THERMOMETER_K[number] - 20.0
    recording = replace(recording, temperatures=replace(shown, celsius=celsius))
    bundle, out = folder / f"run{number}", folder / f"result{number}"
    write_bundle_files(bundle, recording)
    assert run(["analyse", str(bundle), "-o", str(out)]) == 0
    return out / "result.json"


def find_left_um(result, truth, points):
    error = 1e3 * warm(truth, UNSEEN_DEGC).deviation_mm(points)
    off = error - predict(result, points).error_um
    return float(np.linalg.norm(remove_rigid_motion(points, off), axis=1).mean())


@pytest.mark.long
@pytest.mark.timeout(900)
def test_growth_and_squareness_per_kelvin_are_told_and_serve_at_another(tmp_path):
    content = load_slow_tracker("demo")
    path = default_path(machine_from_json(content, file=""), 9000.0, lines=20)
    truth = random_machine(parse_machine(content), 5)
    files = [analyse_at(content, path, truth, k, tmp_path) for k in range(len(DEGC))]
    asked = ["--at", "0,20,50,60", "-o", str(tmp_path / "warm")]
    assert run(["temperature", *map(str, files), *asked]) == 0
    found = json.loads((tmp_path / "warm" / "temperature.json").read_text())
    for axis, one in found["expansion"].items():
        off = one["value_um_per_m_K"] - 1e6 * GROWTH_PER_K[axis]
        assert abs(off) < 2.5 * one["uncertainty_um_per_m_K"], axis
        assert one["is_significant"]
    lean = found["coefficients"]["C0Y"]
    off = abs(lean["value_urad_per_K"]) - 1e6 * LEAN_PER_K
    assert abs(off) < 2.5 * lean["uncertainty_urad_per_K"]
    named = {one["symbol"] for one in found["dependences"] if one["is_significant"]}
    assert named == {"EXX", "EYY", "EZZ", "C0Y"}
    low, high = np.array([(a.low, a.high) for a in truth.machine.linear_axes]).T
    points = np.random.default_rng(1).uniform(low, high, (300, 3))
    told, _ = read_result_at(tmp_path / "warm" / "temperature.json", UNSEEN_DEGC)
    with_um = find_left_um(told, truth, points)
    assert with_um < 0.25 * find_left_um(read_result(files[2]), truth, points)
    asked = ["--format", "siemens", "--at-temperature", str(UNSEEN_DEGC)]
    model = str(tmp_path / "warm" / "temperature.json")
    assert run(["export", model, *asked, "-o", str(tmp_path / "s.ini")]) == 0
    assert (tmp_path / "s-temperature.ini").is_file()
