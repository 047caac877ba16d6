"""`export` of a machine whose control compensates while it is measured."""

import json

import numpy as np
import pytest

from api_builders import edited
from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic

CONTENT = load_machine("demo")
pytestmark = [
    pytest.mark.timeout(240),  # two measurements are analysed
    pytest.mark.usefixtures("few_places"),
]


def export(result, output, *more):
    words = ["export", str(result), "--format", "siemens", "-o", str(output), *more]
    assert run(words) == 0


def say_control(content, state):
    for source in (content["provenance"], *content["runs"]):
        source["source"] = {**source["source"], "control_compensation": state}
    return content


def list_files(folder):
    return sorted(f for f in folder.iterdir() if f.suffix != ".json")


@pytest.fixture(scope="module")
def active(few_places, analysed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("active")
    export(analysed / "result.json", folder / "t")
    return list_files(folder)


@pytest.fixture(scope="module")
def given(active):
    return [word for file in active for word in ("--active", str(file))]


@pytest.fixture(scope="module")
def left(record, active, tmp_path_factory):
    """A result of the same machine, measured while its control has these files."""
    folder = tmp_path_factory.mktemp("left")
    tables = LoadedTables.from_paths(active)
    setting = synthetic.Setting(machine_seed=1, compensation=tables)
    run_of_truth, truth = record(7, rows=24, setting=setting)
    write_bundle(run_of_truth, folder / "bundle")
    assert run(["analyse", str(folder / "bundle"), "-o", str(folder)]) == 0
    with edited(folder / "result.json") as content:
        say_control(content, "on")
    return folder / "result.json", truth


@pytest.fixture(scope="module")
def combined(left, given, tmp_path_factory):
    """Files that hold what the active ones hold as well."""
    folder = tmp_path_factory.mktemp("combined")
    export(left[0], folder / "t", *given)
    return folder


def find_left_um(truth, files, q, rigid_free):
    """What a control with these files, or with none, leaves of the errors, µm."""
    left = truth.deviation_mm(q)
    if files:
        control = LoadedTables.from_paths(files).correct(parse_machine(CONTENT))
        left = left + control.added(q, np.ones_like(q))[:, :3]
    return 1e3 * np.sqrt(np.mean(np.sum(rigid_free(q, left) ** 2, axis=1)))


@pytest.fixture
def words(tmp_path):
    def spell(result, *more):
        output = tmp_path / "t" / "t"
        return ["export", result, "--format", "siemens", "-o", output, *more]

    return spell


def test_active_tables_are_kept_or_a_difference_is_said(command, words, left, tmp_path):
    said = command.refuse(*words(left[0]))
    assert "the control compensated while this was measured" in said
    assert "--active FILE" in said
    assert not (tmp_path / "t").exists()
    basis = command.json(*words(left[0], "--difference"))["basis"]
    assert basis["holds"] == "difference"
    assert "to be added to these" in basis["text"]
    assert "holds difference" in (tmp_path / "t" / "t-lec.ini").read_text()


def test_combined_files_take_errors_away(left, active, combined, volume, rigid_free):
    account = json.loads((combined / "t.json").read_text())
    assert account["basis"]["holds"] == "combined"
    assert any(line.startswith("holds combined") for line in account["stamp"])
    q = volume(machine_from_json(CONTENT))
    each = ([], active, list_files(combined))
    bare, before, after = (find_left_um(left[1], f, q, rigid_free) for f in each)
    assert after < 1.1 * before < 0.2 * bare
    assert after < 1.5 * account["volumetric_error_um"]["after"]["mean"] + 0.3


@pytest.mark.parametrize(
    ("state", "more", "said"),
    [
        ("off", ["--active"], "leave them out"),
        ("mixed", [], "not measured alike"),
        ("on", ["--difference", "--active"], "leave them out"),
    ],
)
def test_tables_that_were_not_active_are_refused(
    command, words, result, active, keep, state, more, said
):
    files, file = more and [*more, active[0]], keep(say_control(result, state))
    assert said in command.refuse(*words(file, *files))
    if state == "off":
        assert command.json(*words(file))["basis"]["holds"] == "as-found"


def test_combined_files_verify_as_what_they_leave(left, combined, record, tmp_path):
    files = list_files(combined)
    tables = LoadedTables.from_paths(files)
    setting = synthetic.Setting(machine_seed=1, compensation=tables)
    write_bundle(record(11, "standstill", setting=setting)[0], tmp_path / "bundle")
    named = [word for file in files for word in ("--compensation", str(file))]
    verify = ["verify", str(left[0]), str(tmp_path / "bundle"), "--format", "siemens"]
    assert run([*verify, *named, "-o", str(tmp_path / "v")]) == 0
    verified = json.loads((tmp_path / "v" / "verification.json").read_text())
    assert verified["compensated"]
    assert any("Measurement and result agree" in one for one in verified["statements"])
