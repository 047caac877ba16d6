"""A CNC without any link: a program loaded by hand, a recording, an analysis."""

import json

import numpy as np

from truepath.answers.calibration.points_csv import predict_points
from truepath.files.bundle.commanded_file import encode_commanded
from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.nc_programs.programs import read_program, write_program
from truepath.planning.lines.default_path import default_path
from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.bundle_files import write_bundle_files

OVERRIDE, WAIT_S = 0.8, 4.0


def driven_by_hand(motion):
    """Return what the machine does: the approach, a wait for the operator, the path."""
    start = motion.position[:1] + np.array([37.0, 52.0, 21.0])
    dwell_s = motion.dwell_s.copy()
    dwell_s[0] += WAIT_S
    feed_mm_s = np.append(50.0, OVERRIDE * motion.feed_mm_min / 60.0)
    return Program(
        np.vstack([start, motion.position]), feed_mm_s, np.append(0.3, dwell_s)
    )


def test_a_program_and_a_recording_are_all_that_is_needed_whatever_the_override(
    command, tmp_path, volume, rigid_free
):
    content, bundle, out = load_machine("demo"), tmp_path / "bundle", tmp_path / "out"
    machine = machine_from_json(content)
    path = default_path(machine, 12_000.0, lines=14)
    motion = read_program(write_program(path, machine, "heidenhain"), "heidenhain")
    setting = synthetic.Setting(rate_hz=100.0)
    recording = synthetic.record(content, driven_by_hand(motion), 5, setting=setting)
    write_bundle_files(bundle, recording, csv=True)
    (bundle / "truth.json").unlink()
    (bundle / "path.csv").write_bytes(encode_commanded(path))
    command.run("analyse", bundle, "-o", out)
    assert json.loads((out / "result.json").read_text())["mode"] == "otf"
    q, points = volume(machine), tmp_path / "points.csv"
    np.savetxt(points, q, "%.6f", ",", header="x_mm,y_mm,z_mm", comments="")
    predicted = predict_points(out / "result.json", points, tmp_path / "predicted.csv")
    true = recording.truth.deviation_mm(q)
    before = rigid_free(q, true)
    left = rigid_free(q, true - 1e-3 * predicted.error_um)
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(before**2))
