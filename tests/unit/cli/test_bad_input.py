"""Bad input costs one line.

Every cell of every file of a bundle is held in tests/unit/files/test_bad_bundles.py, of
points and of results in tests/unit/results: here stand a few, as a user meets them.
"""

import shutil
from math import nan

import pytest


def missing(bundle):
    (bundle / "tracker.parquet").unlink()


def out_of_travel(bundle):
    file = bundle / "path.csv"
    head, first, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head, f"612.4,{first.partition(',')[2]}", *rows, ""]))


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (missing, "tracker.parquet: is missing from the bundle"),
        (out_of_travel, "path.csv, row 2, column x_mm: is out of travel: X = 612.4 mm"),
    ],
)
def test_a_bad_bundle_is_one_line(spoil, line, command, bundle, tmp_path):
    spoil(bundle)
    said = command.refuse("analyse", bundle, "-o", tmp_path / "out")
    assert said.startswith(line)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("is_beside", [False, True])
def test_a_bad_known_length_is_one_line(is_beside, command, bundle, tmp_path):
    file = bundle.with_name(f"{bundle.name}.known_lengths.csv")
    file.write_text(
        "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,length_mm,u_mm\n"
        "1000,0,0,3000,0,0,2000,0.001\n1000,0,0,3000,0,0,2000,-1\n"
    )
    option = []
    if not is_beside:
        file = file.rename(tmp_path / "bar.csv")
        option = ["--known-length", file]
    said = command.refuse("analyse", bundle, *option, "-o", tmp_path / "out")
    assert said.startswith(f"{file.name}, row 3, column u_mm: is -1; state the")
    assert not (tmp_path / "out").exists()


def test_a_damaged_zip_or_no_bundle_is_one_line(command, bundle, tmp_path):
    archive = tmp_path / "bundle.zip"
    shutil.make_archive(str(tmp_path / "bundle"), "zip", bundle)
    archive.write_bytes(archive.read_bytes()[:-300])
    for place in (archive, tmp_path / "nowhere"):
        said = command.refuse("analyse", place, "-o", tmp_path / "out")
        assert place.name in said


def test_an_output_folder_that_is_a_file_is_one_line(command, recorded, tmp_path):
    (tmp_path / "out").write_text("mine")
    said = command.refuse("analyse", recorded, "-o", tmp_path / "out")
    assert said.endswith("out: is a file; name a folder for the results")
    assert (tmp_path / "out").read_text() == "mine"


@pytest.fixture
def refuse(command, points, tmp_path):
    def ask(result):
        out = tmp_path / "out.csv"
        said = command.refuse("predict", result, "--points", points, "-o", out)
        assert not out.exists()
        return said

    return ask


def test_bad_points_and_a_bad_result_are_one_line(refuse, analysed, points, tmp_path):
    file = tmp_path / "result.json"
    assert "result.json: cannot be read (No such file or directory)" in refuse(file)
    file.write_text('{"schema": ')
    assert "result.json, row 1: is not JSON" in refuse(file)
    points.write_text("x_mm,y_mm,z_mm\n1,nan,3\n")
    line = refuse(analysed / "result.json")
    assert "points.csv, row 2, column y_mm: is empty" in line


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [
        ("length_scale_ppm", "0.6", 'length_scale_ppm is "0.6"; write a number'),
        ("length_scale_ppm", -5.0, "length_scale_ppm is -5; it must be"),
        ("measured_s", nan, "measured_s is not finite; write a finite"),
        ("temperature_degC", {"X": [nan, 20.0]}, "temperature_degC.X[0] is not finite"),
        ("temperature_degC", "warm", 'temperature_degC is "warm"; write an'),
        ("runs", [{"name": "a", "sketch": "123"}], 'runs[0].sketch is "123"'),
        ("runs", "monday", 'runs is "monday"'),
    ],
)
def test_a_result_of_bad_provenance_is_one_line(key, value, line, refuse, result, keep):
    result["provenance"][key] = value
    assert f"result.json: provenance.{line}" in refuse(keep(result))


@pytest.mark.parametrize("value", [1e12, -1e308])
def test_an_error_that_no_machine_has_is_one_line(value, refuse, result, keep):
    effects = result["model"]["effects"]
    place = next(k for k, one in enumerate(effects) if "values_um" in one)
    effects[place]["values_um"][2] = value
    line = refuse(keep(result))
    assert f"result.json: model.effects[{place}].values_um[2] is {value:g}" in line
