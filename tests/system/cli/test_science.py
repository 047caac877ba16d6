"""`analyse` and `predict`: files in, files out, one object on standard output."""

import csv
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from api_builders import edited
from truepath.cli.summary import print_result
from truepath.files.bundle.bundle import write_bundle, zip_bundle
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.numerics import adaptive_trials


@pytest.fixture
def bundles(record, tmp_path):
    def write(**runs):
        for name, one in runs.items():
            write_bundle(one, tmp_path / name)
        return [tmp_path / name for name in runs]

    return write


def test_a_zip_says_the_same_as_its_folder_in_all(command, record, result, tmp_path):
    archive, out = tmp_path / "run.zip", tmp_path / "out"
    archive.write_bytes(zip_bundle(record(1, rows=24)[0]))
    said = command.json("analyse", archive, "-o", out)
    assert (said["schema"], said["mode"]) == ("summary/1", "otf")
    assert said["residual_rms_um"] > 0
    assert said["observability"]["rank"] < said["observability"]["parameters"]
    names = {"result.json", "error_tables.csv", "report.html"}
    assert {str(out / name) for name in names} == set(said["files"])
    assert {path.name for path in out.iterdir()} == names
    assert result["schema"] == "result/1"
    highest = max(result["error_tables"]["EXX"]["value_um"])
    assert said["error_tables"]["EXX"]["highest_um"] == pytest.approx(highest)


def test_bundles_of_both_modes_are_analysed_jointly(command, record, bundles, tmp_path):
    otf, standstill = record(1, rows=24)[0], record(1, "standstill", rows=30)[0]
    places, out = bundles(otf=otf, standstill=standstill), tmp_path / "out"
    assert command.json("analyse", *places, "-o", out)["runs"] == [
        {"name": "otf", "mode": "otf"},
        {"name": "standstill", "mode": "standstill"},
    ]
    page = (out / "report.html").read_text()
    assert "Runs otf (on the fly), standstill (at standstill)" in page


def test_of_several_bundles_the_bad_one_is_named(command, record, bundles, tmp_path):
    whole = record(1, rows=24)[0]
    cut = replace(whole, tracker=whole.tracker.select(slice(100, None)))

    def refuse(places):
        return command.refuse("analyse", *places, "-o", tmp_path / "out")

    assert "cut: has samples of whole in it" in refuse(bundles(whole=whole, cut=cut))
    places = bundles(a=whole, b=whole)
    assert "b: is the same measurement as a" in refuse(places)
    with edited(tmp_path / "b" / "machine.json") as content:
        content["axes"]["X"]["max_mm"] += 1.0
    assert "b/machine.json: axes.X.max_mm is" in refuse(places)
    (tmp_path / "b" / "path.csv").unlink()
    assert "b: path.csv: is missing from the bundle" in refuse(places)
    assert not (tmp_path / "out").exists()


def test_perpendicular_only_knows_less_and_is_told(command, result, recorded, tmp_path):
    out = tmp_path / "out"
    said = command.run("analyse", recorded, "-o", out, "--perpendicular-only")
    assert "EXX" in said.out
    assert "C0Y" in said.out
    assert "largest U (k = 2)" in said.out
    assert "not determined: " in said.out
    assert "grade of the set-up: 0." in said.out
    stages = [line.removeprefix("analyse: ") for line in said.err.splitlines()]
    assert stages == ["reading", "aligning", "estimating", "reporting", "writing"]
    alone = json.loads((out / "result.json").read_text())
    both, across = (one["error_tables"]["EXX"] for one in (result, alone))
    assert np.mean(across["uncertainty_um"]) > np.mean(both["uncertainty_um"])


def test_trials_are_in_the_summaries(command, small_run, tmp_path, monkeypatch, capsys):
    few = partial(adaptive_trials.TrialPlan, most_blocks=2)
    monkeypatch.setattr(adaptive_trials, "TrialPlan", few)
    out, order = tmp_path / "out", ["--seed", "5", "--interval", "shortest"]
    told = command.json("analyse", small_run, "-o", out, "--monte-carlo", *order)
    said = told["monte_carlo"]
    assert (said["seed"], said["interval"]) == (5, "shortest")
    assert said["trials"] == 20_000
    assert 0 < said["agreeing"] <= said["numbers"]
    assert "error_tables" not in said
    print_result(json.loads((out / "result.json").read_text()), out)
    assert "20,000 trials did not settle" in capsys.readouterr().out


def test_predict_adds_error_with_uncertainty(command, analysed, points, tmp_path):
    out, result = tmp_path / "predicted.csv", analysed / "result.json"
    order = ["predict", result, "--points", points, "-o", out]
    assert "3 points" in command.run(*order).out
    said = command.json(*order)
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["x_mm"] for row in rows] == ["0", "250", "500"]
    for row in rows:
        assert all(float(row[name]) > 0 for name in ("ux_um", "uy_um", "uz_um"))
    assert (said["points"], said["files"]) == (3, [str(out)])
    points.write_text("x_mm,y_mm,z_mm\n600,0,0\n")
    assert "note: 1 of 1 points lie beyond the travel" in command.run(*order).err


def test_a_run_file_is_analysed_as_its_bundle_is(command, record, result, tmp_path):
    truth, _ = record(1, rows=24)
    header = RunHeader("r", truth.machine, truth.commanded, 100.0, {}, ())
    # The recording as the cell leaves it, not yet a bundle.
    recorder = Recorder(tmp_path / "r.sqlite", header, reserve_bytes=0)
    recorder.put_tracker(truth.tracker)
    recorder.close("finished")
    command.run("analyse", recorder.file, "-o", tmp_path / "again")
    again = json.loads((tmp_path / "again" / "result.json").read_text())
    for name in ("EXX", "EYX", "EZZ"):
        values = (one["error_tables"][name]["value_um"] for one in (again, result))
        np.testing.assert_allclose(*values, atol=0.05)


@pytest.mark.parametrize("name", ["r.sqlite", "odd.run"])
def test_a_file_that_is_no_run_is_bad_input(name, command, tmp_path):
    (tmp_path / name).write_bytes(b"SQLite format 3\0" + b"garbage" * 999)
    said = command.refuse("analyse", tmp_path / name, "-o", tmp_path / "out")
    assert f"{name}: is not a Run file" in said
