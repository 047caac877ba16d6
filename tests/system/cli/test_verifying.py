"""`verify`, `discover` and `demo`: a result held against further measurements."""

import json

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.cli.demo import compare_with_truth, plan_path
from truepath.errors import PlanningError
from truepath.files.bundle import bundle, machine_file
from truepath.files.earlier.result_file import result_from_json
from truepath.motion.motion_times import travel_time_s
from truepath.results.prediction import predict
from truepath_simulators.machine_file import load_machine
from truepath_simulators.worlds import synthetic


@pytest.fixture(scope="module")
def held_out(record, tmp_path_factory):
    setting = synthetic.Setting(machine_seed=1)
    again, _ = record(101, "standstill", rows=30, feed=6000.0, setting=setting)
    folder = tmp_path_factory.mktemp("held-out") / "again"
    bundle.write_bundle(again, folder)
    return folder


@pytest.fixture
def words(analysed, held_out, tmp_path):
    def spell(*more):
        result = analysed / "result.json"
        return ["verify", result, held_out, "-o", tmp_path / "out", *more]

    return spell


def test_verify_writes_file_and_page_and_says_what_fails(command, words, tmp_path):
    order = words("--tolerance-um", "10")
    said = command.json(*order)
    assert said["schema"] == "verification-summary/1"
    assert said["conformity"]["deviation"]["conformity"] == "within"
    assert said["agreement"]["consistent"]
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {"verification.json", "report.html"}
    content = json.loads((out / "verification.json").read_text())
    assert content["schema"] == "verification/1"
    assert content["statements"] == said["statements"]
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 1
    assert "ISO 14253-1" in page
    # It was verified; what it says of the machine is another matter.
    told = command.run(*order)
    assert "The machine as it is fails" in told.out
    assert "noise deducted" in told.out
    assert "measured: outside" in told.err


def test_inactive_files_are_found_out(few_places, command, words, analysed, tmp_path):
    stem = tmp_path / "tables" / "c"
    result = analysed / "result.json"
    command.run("export", result, "--format", "linuxcnc", "-o", stem)
    files = [x for f in stem.parent.glob("*.tbl") for x in ("--compensation", f)]
    said = command.run(*words("--format", "linuxcnc", *files))
    assert "the compensation is not active" in said.out
    assert "say its format with --format" in command.refuse(*words(*files))
    said = command.refuse(*words("--format", "linuxcnc"))
    assert "--compensation FILE" in said


@pytest.fixture(scope="module")
def discovered(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("discovered")
    assert run(["discover", str(recorded), "-o", str(folder)]) == 0
    return folder


def test_files_are_written_and_points_predicted(command, discovered, points, tmp_path):
    names = {path.name for path in discovered.iterdir() if path.is_file()}
    assert names == {"discovery.json", "model.json", "report.html"}
    content = json.loads((discovered / "discovery.json").read_text())
    assert content["schema"] == "discovery/1"
    assert content["effects"] == content["unnamed"] == []
    out, model = tmp_path / "predicted.csv", discovered / "model.json"
    command.run("predict", model, "--points", points, "-o", out)
    header, *rows = out.read_text().splitlines()
    assert header.endswith("dx_um,dy_um,dz_um,ux_um,uy_um,uz_um")
    assert len(rows) == 3


def test_a_model_of_no_use_is_refused(command, recorded, discovered, keep, tmp_path):
    content = json.loads((discovered / "model.json").read_text())

    def refuse(file):
        line = command.refuse("discover", recorded, "-o", tmp_path, "--model", file)
        assert file.name in line
        return line

    assert "cannot be read" in refuse(tmp_path / "missing.json")
    schema = refuse(keep({**content, "schema": "discovery/1"}))
    assert "schema is not that of a result or model" in schema
    assert "version is 1.5" in refuse(keep({**content, "version": 1.5}))
    content["machine"]["axes"]["X"]["max_mm"] += 100.0
    assert "machine.axes" in refuse(keep(content))


def test_the_path_takes_the_minutes_that_were_asked_or_says_the_least():
    machine = machine_file.machine_from_json(load_machine("demo"))
    path = plan_path(machine, 6000.0, 1.5)
    assert travel_time_s(path) == pytest.approx(90.0, rel=0.15)
    with pytest.raises(PlanningError, match=r"give --minutes \d+\.\d or more"):
        plan_path(machine, 2500.0, 0.5)


def test_the_proof_is_exact_for_a_result_that_is_the_truth(result):
    """The truth less what the result says is nothing: 0 % left, all within 2 u."""
    loaded = result_from_json(result)

    def truth_um(position_mm):
        moved = np.cross([3e-2, -1e-2, 2e-2], position_mm) + np.array([5.0, 6.0, 7.0])
        return predict(loaded, position_mm).error_um + moved

    found = compare_with_truth(result, truth_um)
    assert found.before_um > 1.0
    assert (found.after_um, found.covered) == (pytest.approx(0.0, abs=1e-6), 1.0)
