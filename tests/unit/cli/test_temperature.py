"""`temperature`: a machine calibrated at four temperatures, from bundles to files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.compensation.account.residual_error import remove_rigid_motion
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import read_result
from truepath.files.earlier.temperature_file import read_result_at
from truepath.planning.lines.default_path import default_path
from truepath.results.prediction import predict
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.bundle_files import write_bundle_files
from warm_machine import load_slow_tracker, record_warm, stretch

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
    """Measure and analyse the machine at one of the temperatures; return the file."""
    recording = record_warm(content, path, warm(truth, DEGC[number]), 60 + number)
    shown = recording.temperatures
    celsius = shown.celsius + DEGC[number] + THERMOMETER_K[number] - 20.0
    recording = replace(recording, temperatures=replace(shown, celsius=celsius))
    bundle, out = folder / f"run{number}", folder / f"result{number}"
    write_bundle_files(bundle, recording)
    assert run(["analyse", str(bundle), "-o", str(out)]) == 0
    return out / "result.json"


def find_left_um(result, truth, points):
    """Mean length of what a result leaves of the machine at the unseen temperature."""
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
    without_um = find_left_um(read_result(files[2]), truth, points)
    print(f"left at {UNSEEN_DEGC} °C: {with_um:.2f} µm with, {without_um:.2f} without")
    assert with_um < 0.25 * without_um
    asked = ["--format", "siemens", "--at-temperature", str(UNSEEN_DEGC)]
    model = str(tmp_path / "warm" / "temperature.json")
    assert run(["export", model, *asked, "-o", str(tmp_path / "s.ini")]) == 0
    assert (tmp_path / "s-temperature.ini").is_file()
