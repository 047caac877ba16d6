"""`export`: files a controller loads, held against the machine's true errors."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("few_places")


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
    for name, output in (
        ("siemens", "result.ini"),
        ("siemens-lec", "result.json"),
        ("json", "result.json"),
        ("json", "result"),
    ):
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
