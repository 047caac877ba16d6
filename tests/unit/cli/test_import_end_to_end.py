"""Exports of several makers' software, streams and points, up to the machine's tables.

The writers below know the truth world alone; nothing of the importer is used.
"""

import datetime
import json

import numpy as np
import pytest

from truepath.answers.calibration.points_csv import predict_points
from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle

DAY = datetime.datetime(2026, 3, 1, tzinfo=datetime.UTC)


def clock(t, begin="23:59:40", form="%H:%M:%S.%f"):
    hour, minute, second = map(int, begin.split(":"))
    start = DAY + datetime.timedelta(hours=hour, minutes=minute, seconds=second)
    return (start + datetime.timedelta(seconds=round(float(t), 6))).strftime(form)


def leica(time_s, position, status, names):
    """ISO times across midnight, a running number, air beside it, Windows line ends."""
    head = "Point ID,X [mm],Y [mm],Z [mm],Timestamp,Temperature [°C],Humidity [%]"
    rows = ["Tracker Pilot", "Job: acceptance", "", head]
    for t, p, name in zip(time_s, position, names, strict=True):
        stamp = clock(t - time_s[0], form="%Y-%m-%dT%H:%M:%S.%fZ")
        rows.append(",".join([name, *(f"{v:.5f}" for v in p), stamp, "20.4", "51"]))
    return "\r\n".join(rows).encode("utf-8-sig"), ()


def spatial(time_s, position, status, names):
    """Inches, commas with blanks, group and point in one name, epoch seconds."""
    rows = ["// SpatialAnalyzer", "// Units: Inches", "Units: Inches"]
    rows += ["Name, X, Y, Z, Epoch Time [s], Status"]
    for t, p, ok, name in zip(time_s, position, status, names, strict=True):
        cells = [f"A::run::{name}", *(f"{v / 25.4:.7f}" for v in p)]
        cells += [f"{1772323200 + t:.6f}", "OK" if ok == 0 else "LOST"]
        rows.append(", ".join(cells))
    return "\n".join(rows).encode(), ("--column", "time=Epoch Time [s]")


def polyworks(time_s, position, status, names):
    """German, tabs, metres below the names, thousands, ms since the start, UTF-16."""
    rows = ["Punktname\tX gemessen\tY gemessen\tZ gemessen\tAbw. X\tZeit"]
    rows += ["\tmm\tmm\tmm\tmm\tms"]
    for t, p, name in zip(time_s, position, names, strict=True):
        cells = [name, *(f"{v:,.5f}" for v in p), "0.00100"]
        cells += [f"{1e3 * (t - time_s[0]):.3f}"]
        swap = str.maketrans(",.", ".,")
        rows.append("\t".join([cells[0], *(c.translate(swap) for c in cells[1:])]))
    return "\r\n".join(rows).encode("utf-16"), ()


def generic(time_s, position, status, names):
    """No names of columns, blanks, metres: all by hand."""
    rows = []
    for t, p, name in zip(time_s, position, names, strict=True):
        point = "".join(c for c in name if c.isdigit())
        cells = [point, *(f"{v / 1e3:.8f}" for v in p), clock(t - time_s[0])]
        rows.append(" ".join(cells))
    roles = ["point=1", "x=2", "y=3", "z=4", "time=5"]
    options = [word for role in roles for word in ("--column", role)]
    return "\n".join(rows).encode(), (*options, "--unit", "m", "--across-midnight")


STYLES = [leica, spatial, polyworks, generic]


def shots_of(truth, recording, shots=3):
    """Return some shots at each point, each the mean of a while of the stream."""
    row, time_s = recording.row, recording.time_s
    still = np.linalg.norm(
        recording.commanded_mm - truth.commanded.position[row], axis=1
    )
    rows, picked = [], []
    for k in range(len(truth.commanded)):
        at = np.flatnonzero((row == k) & (still < 1e-9))
        at = at[len(at) // 4 : -len(at) // 4]
        for part in np.array_split(at, shots):
            rows.append(k)
            picked.append(part)
    position = np.array(
        [truth.tracker.position_mm[part].mean(axis=0) for part in picked]
    )
    names = [f"P{k + 1}" for k in rows]
    times = np.array([time_s[part].mean() for part in picked])
    return times, position, np.zeros(len(rows), int), names


@pytest.mark.long
@pytest.mark.timeout(200)
@pytest.mark.parametrize("mode", ["otf", "standstill"])
@pytest.mark.parametrize("style", STYLES)
def test_an_export_becomes_the_tables_of_the_machine(
    style, mode, record, tmp_path, volume, rigid_free, capsys
):
    truth, world = record(1012, mode, rows=40 if mode == "otf" else 60)
    write_bundle(truth, tmp_path / "truth")
    if mode == "otf":
        stream = truth.tracker
        times, position, status = (
            stream.device_time_s,
            stream.position_mm,
            stream.status,
        )
        names = [f"N{k + 1}" for k in range(len(times))]
    else:
        times, position, status, names = shots_of(truth, world.recording)
    data, options = style(times, position, status, names)
    if mode == "otf" and style is generic:
        options = options[2:]  # the first column counts samples
    (tmp_path / "export.txt").write_bytes(data)
    source = "path.csv" if mode == "otf" else "points.csv"
    bundle, out = tmp_path / "bundle", tmp_path / "out"
    place = tmp_path / "truth"
    assert run([
        "import", str(tmp_path / "export.txt"),
        "--machine", str(place / "machine.json"),
        "--path", str(place / source), "-o", str(bundle), *options,
    ]) == 0, capsys.readouterr().err  # fmt: skip
    assert run(["analyse", str(bundle), "-o", str(out)]) == 0
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
