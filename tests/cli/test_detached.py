"""A CNC without any link: a program loaded by hand, a recording, an analysis."""

import json

import numpy as np
import pytest

from truepath.answers.calibration.points_csv import predict_points
from truepath.cli.command import run
from truepath.files.bundle.commanded_file import encode_commanded
from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.nc_programs.programs import read_program, write_program
from truepath.planning.lines.default_path import default_path
from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.bundle_files import write_bundle_files

FEED_MM_MIN = 12_000.0


def driven_by_hand(motion, override, wait_s):
    """Return what the machine does: the approach, a wait for the operator, the path."""
    start = motion.position[:1] + np.array([37.0, 52.0, 21.0])
    dwell_s = motion.dwell_s.copy()
    dwell_s[0] += wait_s
    feed_mm_s = np.append(50.0, override * motion.feed_mm_min / 60.0)
    return Program(
        np.vstack([start, motion.position]), feed_mm_s, np.append(0.3, dwell_s)
    )


def bundle_of(content, path, folder, *, override=1.0, wait_s=4.0):
    """Write the bundle an operator makes; return the truth of its machine."""
    machine = machine_from_json(content)
    motion = read_program(write_program(path, machine, "heidenhain"), "heidenhain")
    program = driven_by_hand(motion, override, wait_s)
    recording = synthetic.record(content, program, 5)
    write_bundle_files(folder, recording, csv=True)
    (folder / "truth.json").unlink()
    (folder / "path.csv").write_bytes(encode_commanded(path))
    return recording.truth


@pytest.mark.parametrize("override", [1.0, 0.8])
def test_a_program_and_a_recording_are_all_that_is_needed(
    override, tmp_path, volume, rigid_free, capsys
):
    content = load_machine("demo")
    machine = machine_from_json(content)
    path = default_path(machine, FEED_MM_MIN, lines=14)
    truth = bundle_of(content, path, tmp_path / "bundle", override=override)
    out = tmp_path / "out"
    assert run(["analyse", str(tmp_path / "bundle"), "-o", str(out)]) == 0
    assert json.loads((out / "result.json").read_text())["mode"] == "otf"
    q = volume(machine)
    points = tmp_path / "points.csv"
    np.savetxt(points, q, "%.6f", ",", header="x_mm,y_mm,z_mm", comments="")
    predicted = predict_points(out / "result.json", points, tmp_path / "predicted.csv")
    before = rigid_free(q, truth.deviation_mm(q))
    left = rigid_free(q, truth.deviation_mm(q) - 1e-3 * predicted.error_um)
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(before**2))
