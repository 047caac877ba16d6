"""`analyse` and `predict`: files in, files out, one object on standard output."""

import csv
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle, zip_bundle
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.numerics.adaptive_trials import TrialPlan


def test_analyse_writes_result_tables_and_report(analysed):
    assert {path.name for path in analysed.iterdir()} == {
        "result.json",
        "error_tables.csv",
        "report.html",
    }
    result = json.loads((analysed / "result.json").read_text())
    assert result["schema"] == "result/1"
    assert result["mode"] == "otf"


def test_a_zip_says_the_same_as_its_folder_in_one_object(
    record, analysed, tmp_path, summary
):
    archive, out = tmp_path / "run.zip", tmp_path / "out"
    archive.write_bytes(zip_bundle(record(1, rows=24)[0]))
    assert run(["analyse", str(archive), "-o", str(out), "--json"]) == 0
    said = summary()
    assert said["schema"] == "summary/1"
    assert said["mode"] == "otf"
    assert said["residual_rms_um"] > 0
    assert said["observability"]["rank"] < said["observability"]["parameters"]
    assert {str(path) for path in out.iterdir()} == set(said["files"])
    folder = json.loads((analysed / "result.json").read_text())
    highest = max(folder["error_tables"]["EXX"]["value_um"])
    assert said["error_tables"]["EXX"]["highest_um"] == pytest.approx(highest)


def test_bundles_of_both_modes_are_analysed_together(record, tmp_path, summary):
    for mode, rows in (("otf", 24), ("standstill", 30)):
        write_bundle(record(1, mode, rows=rows)[0], tmp_path / mode)
    bundles = [str(tmp_path / mode) for mode in ("otf", "standstill")]
    assert run(["analyse", *bundles, "-o", str(tmp_path / "out"), "--json"]) == 0
    said = summary()
    assert said["runs"] == [
        {"name": "otf", "mode": "otf"},
        {"name": "standstill", "mode": "standstill"},
    ]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Runs otf (on the fly), standstill (at standstill)" in page


def test_a_part_of_a_bundle_beside_the_whole_is_refused(record, tmp_path, capsys):
    whole = record(1, rows=24)[0]
    cut = replace(whole, tracker=whole.tracker.select(slice(500, None)))
    for name, one in (("whole", whole), ("cut", cut)):
        write_bundle(one, tmp_path / name)
    bundles = [str(tmp_path / name) for name in ("whole", "cut")]
    assert run(["analyse", *bundles, "-o", str(tmp_path / "out")]) == 2
    assert "cut: has samples of whole in it" in capsys.readouterr().err


def test_of_several_bundles_the_bad_one_is_named(record, tmp_path, capsys):
    for name in ("a", "b"):
        write_bundle(record(1, rows=24)[0], tmp_path / name)
    bundles = [str(tmp_path / name) for name in ("a", "b")]
    asked = ["analyse", *bundles, "-o", str(tmp_path / "out")]
    assert run(asked) == 2
    assert "b: is the same measurement as a" in capsys.readouterr().err
    machine = tmp_path / "b" / "machine.json"
    content = json.loads(machine.read_text())
    content["axes"]["X"]["max_mm"] += 1.0
    machine.write_text(json.dumps(content))
    assert run(asked) == 2
    assert "b/machine.json: axes.X.max_mm is" in capsys.readouterr().err
    (tmp_path / "b" / "path.csv").unlink()
    assert run(asked) == 2
    assert "b: path.csv: is missing from the bundle" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_perpendicular_only_knows_less_and_a_person_gets_tables(
    analysed, recorded, tmp_path, capsys
):
    out = str(tmp_path / "out")
    assert run(["analyse", str(recorded), "-o", out, "--perpendicular-only"]) == 0
    said = capsys.readouterr()
    assert "EXX" in said.out
    assert "C0Y" in said.out
    assert "not seen by this measurement" in said.out
    stages = [line.removeprefix("analyse: ") for line in said.err.splitlines()]
    assert stages == ["reading", "aligning", "estimating", "reporting", "writing"]
    tables = [
        json.loads((folder / "result.json").read_text())["error_tables"]["EXX"]
        for folder in (analysed, tmp_path / "out")
    ]
    both, across = (np.mean(table["uncertainty_um"]) for table in tables)
    assert across > both


def test_trials_are_told_in_the_summary_and_to_a_person(
    small_run, tmp_path, monkeypatch, summary, capsys
):
    plan = partial(TrialPlan, most_blocks=2)
    monkeypatch.setattr("truepath.numerics.adaptive_trials.TrialPlan", plan)
    asked = ["--monte-carlo", "--seed", "5", "--interval", "shortest"]
    out = tmp_path / "out"
    assert run(["analyse", str(small_run), "-o", str(out), *asked, "--json"]) == 0
    said = summary()["monte_carlo"]
    assert (said["seed"], said["interval"]) == (5, "shortest")
    assert said["trials"] == 20_000
    assert 0 < said["agreeing"] <= said["numbers"]
    assert "error_tables" not in said
    assert run(["analyse", str(small_run), "-o", str(out), *asked]) == 0
    assert "20,000 trials did not settle" in capsys.readouterr().out


def test_predict_adds_error_and_uncertainty_to_the_points(
    analysed, points, tmp_path, summary
):
    out = tmp_path / "new" / "predicted.csv"
    out.parent.mkdir()
    arguments = ["--points", str(points), "-o", str(out), "--json"]
    assert run(["predict", str(analysed / "result.json"), *arguments]) == 0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["x_mm"] for row in rows] == ["0", "250", "500"]
    for row in rows:
        assert all(float(row[name]) > 0 for name in ("ux_um", "uy_um", "uz_um"))
    said = summary()
    assert said["points"] == 3
    assert said["files"] == [str(out)]


def test_predict_agrees_with_the_truth_within_its_uncertainty(
    analysed, record, volume, rigid_free, tmp_path, capsys
):
    truth = record(1, rows=24)[1]
    q = volume(record(1, rows=24)[0].machine)
    file, out = tmp_path / "points.csv", tmp_path / "predicted.csv"
    np.savetxt(file, q, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    result = str(analysed / "result.json")
    assert run(["predict", result, "--points", str(file), "-o", str(out)]) == 0
    assert "300 points" in capsys.readouterr().out
    table = np.genfromtxt(out, delimiter=",", names=True)
    predicted = np.stack([table[f"d{axis}_um"] for axis in "xyz"], axis=1)
    sigma = np.stack([table[f"u{axis}_um"] for axis in "xyz"], axis=1)
    true_um = 1e3 * truth.deviation_mm(q)
    left = rigid_free(q, true_um - predicted)
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(rigid_free(q, true_um))
    assert (np.abs(left) < 2 * sigma).mean() > 0.85


def test_points_beyond_the_travel_are_noted_and_predicted(analysed, tmp_path, capsys):
    file = tmp_path / "points.csv"
    file.write_text("x_mm,y_mm,z_mm\n600,0,0\n")
    result, out = str(analysed / "result.json"), str(tmp_path / "out.csv")
    assert run(["predict", result, "--points", str(file), "-o", out]) == 0
    assert "note: 1 of 1 points lie beyond the travel" in capsys.readouterr().err


@pytest.fixture
def run_file(record, tmp_path):
    """The recording as the cell leaves it, not yet a bundle."""
    truth, _ = record(1, rows=24)
    header = RunHeader("r", truth.machine, truth.commanded, 500.0, {}, ())
    recorder = Recorder(tmp_path / "r.sqlite", header, reserve_bytes=0)
    recorder.put_tracker(truth.tracker)
    recorder.close("finished")
    return recorder.file


def _read_tables(folder):
    return json.loads((folder / "result.json").read_text())["error_tables"]


def test_a_run_file_is_analysed_as_its_bundle_is(run_file, analysed, tmp_path):
    again = tmp_path / "again"
    assert run(["analyse", str(run_file), "-o", str(again)]) == 0
    tables = [_read_tables(folder) for folder in (again, analysed)]
    for name in ("EXX", "EYX", "EZZ"):
        ours, expected = (table[name]["value_um"] for table in tables)
        np.testing.assert_allclose(ours, expected, atol=0.05)


@pytest.mark.parametrize("name", ["r.sqlite", "odd.run"])
def test_a_file_that_is_no_run_is_bad_input(name, tmp_path, capsys):
    (tmp_path / name).write_bytes(b"SQLite format 3\0" + b"garbage" * 999)
    folder = str(tmp_path / "out")
    assert run(["analyse", str(tmp_path / name), "-o", folder]) == 2
    assert f"{name}: is not a Run file" in capsys.readouterr().err
