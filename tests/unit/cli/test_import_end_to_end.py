"""Exports of several makers' software, streams and points, up to the machine's tables.

The writers know the truth world alone; nothing of the importer is used.
"""

import json

import numpy as np
import pytest

from exports_of_makers import generic, leica, of_stream, polyworks, spatial
from truepath.answers.predicted_points import predict_points
from truepath.files.bundle.bundle import write_bundle


def shots_of(truth, recording, shots=3):
    """Return some shots at each point, each the mean of a while of the stream."""
    row, count = recording.row, len(truth.commanded)
    way = recording.commanded_mm - truth.commanded.position[row]
    still = np.linalg.norm(way, axis=1) < 1e-9
    picked = []
    for k in range(count):
        at = np.flatnonzero((row == k) & still)
        picked += np.array_split(at[len(at) // 4 : -len(at) // 4], shots)
    times, position = (
        np.array([values[part].mean(axis=0) for part in picked])
        for values in (recording.time_s, truth.tracker.position_mm)
    )
    names = [f"P{k + 1}" for k in range(count) for _ in range(shots)]
    return times, position, np.zeros(len(picked), int), names


@pytest.mark.long
@pytest.mark.timeout(200)
@pytest.mark.parametrize("mode", ["otf", "standstill"])
@pytest.mark.parametrize("style", [leica, spatial, polyworks, generic])
def test_an_export_becomes_the_tables_of_the_machine(
    style, mode, record, tmp_path, volume, rigid_free, command
):
    truth, world = record(1012, mode, rows=40 if mode == "otf" else 60)
    write_bundle(truth, tmp_path / "truth")
    if mode == "otf":
        data, options = of_stream(style, truth.tracker)
    else:
        data, options = style(*shots_of(truth, world.recording))
    (tmp_path / "export.txt").write_bytes(data)
    bundle, out, place = (tmp_path / name for name in ("bundle", "out", "truth"))
    path = place / ("path.csv" if mode == "otf" else "points.csv")
    given = ["--machine", place / "machine.json", "--path", path, *options]
    command.run("import", tmp_path / "export.txt", *given, "-o", bundle)
    command.run("analyse", bundle, "-o", out)
    verdict = json.loads((out / "result.json").read_text())["verdict"]
    assert verdict["state"] == "usable", verdict["reasons"]
    q = volume(truth.machine)
    points = tmp_path / "points.csv"
    np.savetxt(points, q, "%.6f", ",", header="x_mm,y_mm,z_mm", comments="")
    told = predict_points(out / "result.json", points, tmp_path / "predicted.csv")
    before = 1e3 * rigid_free(q, world.deviation_mm(q))
    left = before - rigid_free(q, told.error_um)
    inside = (np.abs(left) < 2.0 * told.uncertainty_um).mean()
    was, rest = (np.sqrt(np.mean(v**2)) for v in (before, left))
    print(f"{style.__name__} {mode}: {was:.1f} to {rest:.2f} µm, {inside:.1%} in 2u")
    assert rest < 0.12 * was
    assert inside > 0.85
