"""`export`: files a controller loads, held against the machine's true errors."""

import json

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.compensation.formats.isg_csv import IsgCsv
from truepath.compensation.formats.linuxcnc import LinuxCnc
from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.scenario import load_machine


def exported(analysed, name, output, *more):
    result = str(analysed / "result.json")
    return run(["export", result, "--format", name, "-o", str(output), *more])


def test_a_format_of_one_file_is_written_where_it_is_asked(analysed, tmp_path, capsys):
    assert exported(analysed, "siemens-lec", tmp_path / "axes.ini") == 0
    assert {p.name for p in tmp_path.iterdir()} == {"axes.ini", "axes.json"}
    said = capsys.readouterr()
    assert "carries: positioning of each axis" in said.out
    assert "µm, with these tables" in said.out
    assert "sign is not verified" not in said.err


def test_a_format_of_one_file_keeps_another_suffix(analysed, tmp_path):
    assert exported(analysed, "siemens-lec", tmp_path / "axes.arc") == 0
    assert {p.name for p in tmp_path.iterdir()} == {"axes.arc", "axes.json"}


@pytest.mark.parametrize("output", ["c.json", "c.tables.json", "c"])
def test_tables_and_their_account_are_two_files_where_both_are_json(
    analysed, tmp_path, output
):
    assert exported(analysed, "json", tmp_path / output) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"c.tables.json", "c.json"}
    assert json.loads((tmp_path / "c.json").read_text())["format"] == "json"
    tables = json.loads((tmp_path / "c.tables.json").read_text())
    assert tables["schema"] == "compensation-tables/1"


def test_formats_are_listed_with_what_each_carries(capsys, summary):
    assert run(["formats"]) == 0
    said = capsys.readouterr().out
    assert (
        "siemens-lec: Siemens 840D sl, leadscrew error compensation, 1000 rows\n"
        in said
    )
    assert "isg-csv: ISG kernel, Beckhoff TF5280, 1000 rows; the sign is to be" in said
    assert "carries      positioning of each axis, forward and reverse" in said
    assert run(["formats", "--json"]) == 0
    names = [one["name"] for one in summary()["formats"]]
    assert names == sorted(names)


def test_a_format_of_a_file_an_axis_begins_their_names(analysed, tmp_path, summary):
    assert exported(analysed, "linuxcnc", tmp_path / "new" / "comp.tbl", "--json") == 0
    said = summary()
    names = {"comp-X.tbl", "comp-Y.tbl", "comp-Z.tbl"}
    assert {p.name for p in (tmp_path / "new").iterdir()} == names | {"comp.json"}
    assert {path.rsplit("/", 1)[1] for path in said["files"]} == names
    beside = json.loads((tmp_path / "new" / "comp.json").read_text())
    assert beside == said
    assert said["schema"] == "compensation/1"
    assert said["provenance"]["software"] == "truepath"
    assert len(said["unobservable"]) == 4


def test_a_sign_that_no_manual_states_is_said_to_be_tried_first(
    analysed, tmp_path, capsys
):
    assert exported(analysed, "heidenhain", tmp_path / "comp") == 0
    assert "try one deliberate value before first use" in capsys.readouterr().err


def test_volumetric_tables_take_the_true_errors_away(
    analysed, record, volume, rigid_free, tmp_path
):
    assert exported(analysed, "isg-csv", tmp_path / "comp.csv") == 0
    machine = machine_from_json(load_machine("demo"))
    text = (tmp_path / "comp.csv").read_text()
    correction = IsgCsv().read({"comp.csv": text}, machine)
    q = volume(machine)
    true = record(1, rows=24)[1].deviation_mm(q)
    before, after = (rigid_free(q, e) for e in (true, true + correction(q, 1.0)))
    assert np.sqrt(np.mean(after**2)) < 0.12 * np.sqrt(np.mean(before**2))


def test_an_axis_table_takes_the_true_positioning_away(analysed, record, tmp_path):
    assert exported(analysed, "linuxcnc", tmp_path / "comp.tbl", "--spacing", "20") == 0
    machine = machine_from_json(load_machine("demo"))
    texts = {p.name: p.read_text() for p in tmp_path.glob("*.tbl")}
    correction = LinuxCnc().read(texts, machine)
    truth = record(1, rows=24)[1]
    for column, axis in enumerate(machine.linear_axes):
        q = np.tile([(a.low + a.high) / 2 for a in machine.linear_axes], (97, 1))
        q[:, column] = np.linspace(axis.low, axis.high, 97)
        true = truth.deviation_mm(q)[:, column]
        left = true + correction(q, 1.0)[:, column]
        assert np.ptp(left) < max(0.35 * np.ptp(true), 0.004)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--format", "vcs"], "installed: csv, etalon-exchange, fanuc"),
        (["--format", "fanuc", "--spacing", "0"], "spacing"),
    ],
)
def test_what_cannot_be_written_says_why(
    analysed, tmp_path, capsys, arguments, message
):
    result = str(analysed / "result.json")
    assert run(["export", result, *arguments, "-o", str(tmp_path / "comp")]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_result_is_refused(tmp_path, capsys):
    (tmp_path / "result.json").write_text("{}")
    assert exported(tmp_path, "linuxcnc", tmp_path / "comp") == 2
    assert "schema" in capsys.readouterr().err


def test_lost_motion_that_the_result_states_is_in_both_directions(analysed, tmp_path):
    content = json.loads((analysed / "result.json").read_text())
    table = {"position_mm": [0.0, 500.0], "value_um": [3.0, 5.0]}
    content["direction"] = {"half_difference": {"EXX": table}}
    (tmp_path / "result.json").write_text(json.dumps(content))
    assert exported(tmp_path, "linuxcnc", tmp_path / "comp.tbl") == 0
    lost = {}
    for axis in "XY":
        text = (tmp_path / f"comp-{axis}.tbl").read_text()
        rows = np.array([line.split() for line in text.splitlines()], float)
        lost[axis] = rows[:, 1] - rows[:, 2]
    ends = list(content["measured_range"]["X"].values())  # held from there on
    expected = 2e-3 * np.interp(ends, *table.values())
    np.testing.assert_allclose(lost["X"][[0, -1]], expected, atol=2e-6)
    np.testing.assert_allclose(lost["Y"], 0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["my part.com", "Fräse.com"])
def test_a_name_that_no_control_reads_is_refused(analysed, tmp_path, capsys, name):
    order = ["export", str(analysed / "result.json"), "--format", "heidenhain"]
    assert run([*order, "-o", str(tmp_path / name)]) == 2
    assert "letters A to Z" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["siemens", "siemens-lec", "json"])
@pytest.mark.parametrize("output", ["result.ini", "result.json", "result"])
def test_the_result_itself_is_never_written_over(
    analysed, tmp_path, capsys, name, output
):
    result = tmp_path / "result.json"
    result.write_bytes((analysed / "result.json").read_bytes())
    assert exported(tmp_path, name, tmp_path / output) == 2
    assert {p.name for p in tmp_path.iterdir()} == {"result.json"}
    assert result.read_bytes() == (analysed / "result.json").read_bytes()
    assert "result.json: would be written over" in capsys.readouterr().err


def test_an_account_replaces_an_account_and_no_other_file(analysed, tmp_path, capsys):
    for _ in range(2):
        assert exported(analysed, "siemens-lec", tmp_path / "axes.ini") == 0
    machine = tmp_path / "machine.json"
    for text in ('{"schema": "machine/1"}', "not JSON"):
        machine.write_text(text)
        assert exported(analysed, "siemens-lec", tmp_path / "machine.ini") == 2
        assert machine.read_text() == text
        said = capsys.readouterr().err
        assert "machine.json: the account of the files would be written over it" in said
    assert not (tmp_path / "machine.ini").exists()
