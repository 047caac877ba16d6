"""The table of bad input: what is wrong, the exit status, and the one line it costs.

Every cell of every file of a bundle is held in tests/measurement/test_bad_bundles.py;
here stands one row of each kind, as a user of the command line meets it.
"""

import json
import shutil

import pytest

from truepath.cli.command import run


def without(name):
    return lambda folder: (folder / name).unlink()


def holding(name, content):
    return lambda folder: (folder / name).write_bytes(content)


def cut(name):
    def edit(folder):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: len(data) // 2])

    return edit


def cell(name, row, column, text):
    """Change one cell of a CSV file; row 1 is the header."""

    def edit(folder):
        lines = (folder / name).read_text().splitlines()
        cells = lines[row - 1].split(",")
        cells[lines[0].split(",").index(column)] = text
        lines[row - 1] = ",".join(cells)
        (folder / name).write_text("\n".join(lines) + "\n")

    return edit


def start_equals_end(folder):
    lines = (folder / "path.csv").read_text().splitlines()
    lines[4] = lines[3]
    (folder / "path.csv").write_text("\n".join(lines) + "\n")


def axes_left_out(folder):
    machine = json.loads((folder / "machine.json").read_text())
    del machine["axes"]
    (folder / "machine.json").write_text(json.dumps(machine))


BAD_BUNDLES = {
    "missing file": (
        without("tracker.parquet"),
        "tracker.parquet: is missing from the bundle",
    ),
    "wrong column": (
        cell("path.csv", 1, "y_mm", "why"),
        "path.csv, column y_mm: is missing; the file has",
    ),
    "NaN": (
        cell("path.csv", 3, "z_mm", "NaN"),
        "path.csv, row 3, column z_mm: is empty or NaN",
    ),
    "path out of travel": (
        cell("path.csv", 4, "x_mm", "612.4"),
        "path.csv, row 4, column x_mm: is out of travel: X = 612.4 mm exceeds 500 mm",
    ),
    "truncated parquet": (
        cut("tracker.parquet"),
        "tracker.parquet: is truncated",
    ),
    "start equals end": (
        start_equals_end,
        "path.csv, row 5: the line starts where it ends",
    ),
    "no axes": (axes_left_out, "machine.json: axes is missing"),
    "machine not JSON": (
        holding("machine.json", b"{"),
        "machine.json, row 1: is not JSON",
    ),
}


def refused(arguments, capsys, status=2):
    """Run a command line; return the one line that it says."""
    assert run([str(word) for word in arguments]) == status
    said = capsys.readouterr()
    assert said.out == ""
    last = said.err.splitlines()[-1]
    assert sum(line.startswith("truepath: ") for line in said.err.splitlines()) == 1
    return last.removeprefix("truepath: ")


@pytest.mark.parametrize("name", BAD_BUNDLES)
def test_a_bad_bundle_is_one_line(name, bundle, tmp_path, capsys):
    edit, line = BAD_BUNDLES[name]
    edit(bundle)
    said = refused(["analyse", bundle, "-o", tmp_path / "out"], capsys)
    assert said.startswith(line)
    assert not (tmp_path / "out").exists()


def test_no_bundle_is_one_line(tmp_path, capsys):
    said = refused(["analyse", tmp_path / "nowhere", "-o", tmp_path / "out"], capsys)
    assert "nowhere" in said


def test_a_damaged_zip_is_one_line(bundle, tmp_path, capsys):
    archive = tmp_path / "bundle.zip"
    shutil.make_archive(str(tmp_path / "bundle"), "zip", bundle)
    archive.write_bytes(archive.read_bytes()[:-300])
    said = refused(["analyse", archive, "-o", tmp_path / "out"], capsys)
    assert "bundle.zip" in said


def test_an_output_folder_that_is_a_file_is_one_line(recorded, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    said = refused(["analyse", recorded, "-o", tmp_path / "out"], capsys)
    assert said.endswith("out: is a file; name a folder for the results")
    assert (tmp_path / "out").read_text() == "mine"


BAD_POINTS = {
    "missing file": (None, "points.csv: cannot be read (No such file or directory)"),
    "wrong column": ("x,y,z\n1,2,3\n", "points.csv, column x_mm: is missing"),
    "NaN": ("x_mm,y_mm,z_mm\n1,nan,3\n", "points.csv, row 2, column y_mm: is empty"),
    "text": ("x_mm,y_mm,z_mm\n1,2,up\n", "points.csv, row 2, column z_mm: is 'up'"),
    "no rows": ("x_mm,y_mm,z_mm\n", "points.csv: has no rows"),
}


@pytest.mark.parametrize("name", BAD_POINTS)
def test_bad_points_are_one_line(name, analysed, tmp_path, capsys):
    content, line = BAD_POINTS[name]
    file, out = tmp_path / "points.csv", tmp_path / "out.csv"
    if content is not None:
        file.write_text(content)
    arguments = [analysed / "result.json", "--points", file, "-o", out]
    assert line in refused(["predict", *arguments], capsys)
    assert not out.exists()


BAD_RESULTS = {
    "missing file": (None, "result.json: cannot be read (No such file or directory)"),
    "not JSON": ('{"schema": ', "result.json, row 1: is not JSON"),
    "another schema": ('{"schema": "machine/1"}', "result.json: schema is not that of"),
    "incomplete": ('{"schema": "result/1"}', "result.json: "),
}


@pytest.mark.parametrize("name", BAD_RESULTS)
def test_a_bad_result_is_one_line(name, points, tmp_path, capsys):
    content, line = BAD_RESULTS[name]
    file, out = tmp_path / "result.json", tmp_path / "out.csv"
    if content is not None:
        file.write_text(content)
    assert line in refused(["predict", file, "--points", points, "-o", out], capsys)
    assert not out.exists()


BAD_PROVENANCE = {
    "scale": ("length_scale_ppm", "0.6", 'length_scale_ppm is "0.6"; write a number'),
    "negative scale": ("length_scale_ppm", -5.0, "length_scale_ppm is -5; it must be"),
    "NaN": ("measured_s", float("nan"), "measured_s is not finite; write a finite"),
    "NaN deeper": (
        "temperature_degC",
        {"X": [float("nan"), 20.0]},
        "temperature_degC.X[0] is not finite; write a finite number",
    ),
    "temperature": ("temperature_degC", "warm", 'temperature_degC is "warm"; write an'),
    "sketch": ("runs", [{"name": "a", "sketch": "123"}], 'runs[0].sketch is "123"'),
    "runs": ("runs", "monday", 'runs is "monday"'),
}


@pytest.mark.parametrize("name", BAD_PROVENANCE)
def test_a_result_of_bad_provenance_is_one_line(
    name, analysed, points, tmp_path, capsys
):
    key, value, line = BAD_PROVENANCE[name]
    result = json.loads((analysed / "result.json").read_text())
    result["provenance"][key] = value
    file, out = tmp_path / "result.json", tmp_path / "out.csv"
    file.write_text(json.dumps(result))
    said = refused(["predict", file, "--points", points, "-o", out], capsys)
    assert f"result.json: provenance.{line}" in said
    assert not out.exists()


@pytest.mark.parametrize("value", [1e12, -1e308])
def test_an_error_that_no_machine_has_is_one_line(
    value, analysed, points, tmp_path, capsys
):
    result = json.loads((analysed / "result.json").read_text())
    place, effect = next(
        (number, one)
        for number, one in enumerate(result["model"]["effects"])
        if "values_um" in one
    )
    effect["values_um"][2] = value
    file, out = tmp_path / "result.json", tmp_path / "out.csv"
    file.write_text(json.dumps(result))
    line = refused(["predict", file, "--points", points, "-o", out], capsys)
    assert f"result.json: model.effects[{place}].values_um[2] is {value:g}" in line
    assert not out.exists()


def test_a_result_with_an_unknown_effect_is_one_line(
    analysed, points, tmp_path, capsys
):
    result = json.loads((analysed / "result.json").read_text())
    result["model"]["effects"][3]["effect"] = "moon-phase"
    file, out = tmp_path / "result.json", tmp_path / "out.csv"
    file.write_text(json.dumps(result))
    line = refused(["predict", file, "--points", points, "-o", out], capsys)
    assert "result.json: model.effects" in line
    assert "moon-phase" in line
    assert not out.exists()
