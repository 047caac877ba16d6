"""`export` of a machine whose control compensates while it is measured."""

import json

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic

pytestmark = pytest.mark.timeout(240)  # two measurements are analysed


def export(result, name, output, *more):
    return run(["export", str(result), "--format", name, "-o", str(output), *more])


def say_control(result, state):
    """The result with what the control said of its compensation."""
    content = json.loads(result.read_text())
    for source in (content["provenance"], *content["runs"]):
        source["source"] = {**source["source"], "control_compensation": state}
    result.write_text(json.dumps(content))
    return result


def list_files(folder):
    return sorted(f for f in folder.iterdir() if f.suffix != ".json")


@pytest.fixture(scope="module")
def active(analysed, tmp_path_factory):
    """Files of the machine as it was found."""
    folder = tmp_path_factory.mktemp("active")
    assert export(analysed / "result.json", "siemens", folder / "t") == 0
    return list_files(folder)


@pytest.fixture(scope="module")
def left(record, active, tmp_path_factory):
    """A result of the same machine, measured while its control has these files."""
    folder = tmp_path_factory.mktemp("left")
    tables = LoadedTables.from_paths(active)
    setting = synthetic.Setting(machine_seed=1, compensation=tables)
    run_of_truth, truth = record(7, rows=24, setting=setting)
    write_bundle(run_of_truth, folder / "bundle")
    assert run(["analyse", str(folder / "bundle"), "-o", str(folder)]) == 0
    return say_control(folder / "result.json", "on"), truth


def find_left_um(truth, files, q, rigid_free):
    """What a control with these files leaves of the machine's own errors, µm."""
    machine = parse_machine(load_machine("demo"))
    control = LoadedTables.from_paths(files).correct(machine)
    added = control.added(q, np.ones_like(q))
    left = rigid_free(q, truth.deviation_mm(q) + added[:, :3])
    return 1e3 * np.sqrt(np.mean(np.sum(left**2, axis=1)))


def test_files_that_would_undo_the_active_tables_are_refused(left, tmp_path, capsys):
    assert export(left[0], "siemens", tmp_path / "t") == 2
    said = capsys.readouterr().err
    assert "the control compensated while this was measured" in said
    assert "--active FILE" in said
    assert not list(tmp_path.iterdir())


def test_combined_files_take_the_true_errors_away_in_place_of_the_active_ones(
    left, active, volume, rigid_free, tmp_path, summary
):
    result, truth = left
    given = [word for file in active for word in ("--active", str(file))]
    assert export(result, "siemens", tmp_path / "t", *given, "--json") == 0
    said = summary()
    assert said["basis"]["holds"] == "combined"
    assert any(line.startswith("holds combined") for line in said["stamp"])
    q = volume(machine_from_json(load_machine("demo")))
    before = find_left_um(truth, active, q, rigid_free)
    after = find_left_um(truth, list_files(tmp_path), q, rigid_free)
    bare = 1e3 * np.sqrt(
        np.mean(np.sum(rigid_free(q, truth.deviation_mm(q)) ** 2, axis=1))
    )
    assert after < 1.1 * before < 0.2 * bare
    assert after < 1.5 * said["volumetric_error_um"]["after"]["mean"] + 0.3


def test_the_difference_is_said_to_be_one(left, active, tmp_path, summary, capsys):
    assert export(left[0], "siemens", tmp_path / "t", "--difference", "--json") == 0
    basis = summary()["basis"]
    assert basis["holds"] == "difference"
    assert "to be added to these" in basis["text"]
    assert "holds difference" in (tmp_path / "t-lec.ini").read_text()


@pytest.mark.parametrize(
    ("state", "more", "words"),
    [
        ("off", ["--active"], "leave them out"),
        ("mixed", [], "not measured alike"),
        ("on", ["--difference", "--active"], "leave them out"),
    ],
)
def test_tables_that_were_not_active_are_refused(
    analysed, active, tmp_path, capsys, state, more, words
):
    result = tmp_path / "result.json"
    result.write_bytes((analysed / "result.json").read_bytes())
    say_control(result, state)
    files = more and [*more, str(active[0])]
    assert export(result, "siemens", tmp_path / "t", *files) == 2
    assert words in capsys.readouterr().err


def test_a_result_with_the_control_off_is_the_whole_correction(
    analysed, tmp_path, summary
):
    result = tmp_path / "result.json"
    result.write_bytes((analysed / "result.json").read_bytes())
    say_control(result, "off")
    assert export(result, "csv", tmp_path / "t.csv", "--json") == 0
    assert summary()["basis"]["holds"] == "as-found"


@pytest.fixture(scope="module")
def verified(left, active, record, tmp_path_factory):
    """A verification of the result, its combined files in the control."""
    folder = tmp_path_factory.mktemp("verified")
    given = [word for file in active for word in ("--active", str(file))]
    assert export(left[0], "siemens", folder / "c" / "t", *given) == 0
    files = list_files(folder / "c")
    tables = LoadedTables.from_paths(files)
    setting = synthetic.Setting(machine_seed=1, compensation=tables)
    write_bundle(record(11, "standstill", setting=setting)[0], folder / "bundle")
    named = [word for file in files for word in ("--compensation", str(file))]
    words = ["verify", str(left[0]), str(folder / "bundle"), "--format", "siemens"]
    assert run([*words, *named, "-o", str(folder / "v")]) == 0
    return json.loads((folder / "v" / "verification.json").read_text())


def test_a_machine_with_combined_files_is_verified_as_what_they_leave(verified):
    assert verified["compensated"]
    assert any("Measurement and result agree" in one for one in verified["statements"])
