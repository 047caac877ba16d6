"""`export`: files a controller loads, held against the machine's true errors."""

import json

import numpy as np
import pytest

from api_builders import edited
from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.worlds import synthetic

CONTENT = load_machine("demo")
pytestmark = [
    pytest.mark.timeout(240),  # two measurements are analysed
    pytest.mark.usefixtures("few_places"),
]


@pytest.fixture
def words(analysed, tmp_path):
    def spell(name, output, *more, result=analysed / "result.json"):
        return ["export", result, "--format", name, "-o", tmp_path / output, *more]

    return spell


@pytest.fixture
def names(tmp_path):
    return lambda folder=".": {p.name for p in (tmp_path / folder).iterdir()}


def test_a_format_of_one_file_is_written_where_it_is_asked(command, words, names):
    said = command.run(*words("siemens-lec", "axes.ini"))
    assert names() == {"axes.ini", "axes.json"}
    assert "carries: positioning of each axis" in said.out
    assert "µm, with these tables" in said.out
    assert "evenly, each direction\n" in said.out
    assert "sign is not verified" not in said.err
    for output in ("axes.ini", "other.arc"):
        command.run(*words("siemens-lec", output))
    assert names() == {"axes.ini", "axes.json", "other.arc", "other.json"}


@pytest.mark.parametrize("output", ["c.json", "c"])
def test_tables_and_account_in_json_are_two(command, words, names, tmp_path, output):
    command.run(*words("json", output))
    assert names() == {"c.tables.json", "c.json"}
    assert json.loads((tmp_path / "c.json").read_text())["format"] == "json"
    tables = json.loads((tmp_path / "c.tables.json").read_text())
    assert tables["schema"] == "compensation-tables/1"


def test_formats_say_what_each_carries_and_whose_sign_is_to_be_tried(command, words):
    said = command.run("formats").out
    title = "Siemens 840D sl, leadscrew error compensation, 1000 rows\n"
    assert f"siemens-lec: {title}" in said
    assert "isg-csv: ISG kernel, Beckhoff TF5280, 1000 rows; the sign is to be" in said
    assert "carries      positioning of each axis, forward and reverse" in said
    said = command.run(*words("heidenhain", "comp"))
    assert "try one deliberate value before first use" in said.err
    listed = [one["name"] for one in command.json("formats")["formats"]]
    assert listed == sorted(listed)


def test_a_format_of_a_file_an_axis_begins_their_names(command, words, names, tmp_path):
    said = command.json(*words("linuxcnc", "new/comp.tbl"))
    files = {"comp-X.tbl", "comp-Y.tbl", "comp-Z.tbl"}
    assert names("new") == files | {"comp.json"}
    assert {path.rsplit("/", 1)[1] for path in said["files"]} == files
    assert json.loads((tmp_path / "new" / "comp.json").read_text()) == said
    assert said["schema"] == "compensation/1"
    assert said["provenance"]["software"] == "truepath"
    assert len(said["unobservable"]) == 4


@pytest.mark.parametrize(
    ("name", "output", "more", "said"),
    [
        ("vcs", "comp", [], "installed: csv, etalon-exchange, fanuc"),
        ("fanuc", "comp", ["--spacing", "0"], "spacing"),
        ("heidenhain", "my part.com", [], "letters A to Z"),
        ("heidenhain", "Fräse.com", [], "letters A to Z"),
    ],
)
def test_what_is_not_written_says_why(command, words, names, name, output, more, said):
    assert said in command.refuse(*words(name, output, *more))
    assert not names()


def test_stated_lost_motion_is_for_both_ways(command, words, result, keep, tmp_path):
    table = {"position_mm": [0.0, 500.0], "value_um": [3.0, 5.0]}
    result["direction"] = {"half_difference": {"EXX": table}}
    command.run(*words("linuxcnc", "comp.tbl", result=keep(result)))
    lost = {}
    for axis in "XY":
        text = (tmp_path / f"comp-{axis}.tbl").read_text()
        rows = np.array([line.split() for line in text.splitlines()], float)
        lost[axis] = rows[:, 1] - rows[:, 2]
    ends = list(result["measured_range"]["X"].values())  # held from there on
    expected = 2e-3 * np.interp(ends, *table.values())
    np.testing.assert_allclose(lost["X"][[0, -1]], expected, atol=2e-6)
    np.testing.assert_allclose(lost["Y"], 0.0, atol=1e-9)


def test_the_result_itself_is_never_written_over(command, words, result, keep, names):
    file = keep(result)
    before = file.read_bytes()
    own = ("siemens-lec", "result.json"), ("json", "result.json"), ("json", "result")
    for name, output in (("siemens", "result.ini"), *own):
        said = command.refuse(*words(name, output, result=file))
        assert "result.json: would be written over" in said
        assert names() == {"result.json"}
        assert file.read_bytes() == before


def test_an_account_replaces_nothing_but_accounts(command, words, names, tmp_path):
    machine = tmp_path / "machine.json"
    for text in ('{"schema": "machine/1"}', "not JSON"):
        machine.write_text(text)
        said = command.refuse(*words("siemens-lec", "machine.ini"))
        assert "machine.json: the account of the files would be written over it" in said
        assert machine.read_text() == text
    assert "machine.ini" not in names()


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
def combined(left, active, tmp_path_factory):
    folder = tmp_path_factory.mktemp("combined")
    given = [word for file in active for word in ("--active", str(file))]
    export(left[0], folder / "t", *given)
    return folder


def find_left_um(truth, files, q, rigid_free):
    """What a control with these files, or with none, leaves of the errors, µm."""
    left = truth.deviation_mm(q)
    if files:
        control = LoadedTables.from_paths(files).correct(parse_machine(CONTENT))
        left = left + control.added(q, np.ones_like(q))[:, :3]
    return 1e3 * np.sqrt(np.mean(np.sum(rigid_free(q, left) ** 2, axis=1)))


def test_active_tables_are_kept_or_a_difference_is_said(command, words, left, tmp_path):
    said = command.refuse(*words("siemens", "t/t", result=left[0]))
    assert "the control compensated while this was measured" in said
    assert "--active FILE" in said
    assert not (tmp_path / "t").exists()
    order = words("siemens", "t/t", "--difference", result=left[0])
    basis = command.json(*order)["basis"]
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
    assert said in command.refuse(*words("siemens", "t/t", *files, result=file))
    if state == "off":
        basis = command.json(*words("siemens", "t/t", result=file))["basis"]
        assert basis["holds"] == "as-found"


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
