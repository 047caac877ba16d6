"""What a person sees: progress, and every failure as one line and an exit status.

Every cell of every file of a bundle is held in tests/unit/files/test_bad_bundles.py, of
points and of results in tests/unit/results: here stand a few, as a user meets them.
"""

import errno
import shutil
from importlib.metadata import version
from math import nan

import pytest

from truepath.cli.command import run, run_command
from truepath.cli.terminal import print_table, show_progress
from truepath.errors import AlignmentError, BadInput, BundleError
from truepath_drivers.interfaces.errors import DeviceTimeout


def failing(error):
    def call():
        raise error

    return call


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (BadInput("no such thing"), 2, "truepath: no such thing"),
        (
            BundleError("is not a number", file="path.csv", row=3, column="x_mm"),
            2,
            "truepath: path.csv, row 3, column x_mm: is not a number",
        ),
        (AlignmentError("paths\n differ"), 1, "truepath: paths differ"),
        (DeviceTimeout("the tracker is silent"), 1, "truepath: the tracker is silent"),
        (FileNotFoundError(errno.ENOENT, "lost", "a.csv"), 2, "truepath: a.csv: lost"),
        (OSError(errno.ENOSPC, "full", "out"), 1, "truepath: out: full"),
        (KeyboardInterrupt(), 1, "truepath: interrupted"),
    ],
)
def test_a_failure_is_one_line_and_a_status(error, status, line, capsys):
    assert run_command(failing(error)) == status
    captured = capsys.readouterr()
    assert (captured.err, captured.out) == (line + "\n", "")


def test_a_fault_of_the_program_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        run_command(failing(ZeroDivisionError()))
    with pytest.raises(OSError, match="nameless"):
        run_command(failing(OSError("nameless")))


@pytest.mark.parametrize(("answer", "status"), [(None, 0), (1, 1), (3, 1), (130, 1)])
def test_success_is_zero_and_any_other_status_a_one(answer, status):
    assert run_command(lambda: answer) == status


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["calibrate"], "calibrate"),
        (["analyse"], "BUNDLE"),
        (["analyse", "bundle"], "--output"),
        (["analyse", "bundle", "-o"], "-o"),
        (["predict", "result.json", "-o", "out.csv"], "--points"),
        (["serve", "--port", "many"], "--port"),
        (["serve", "--port", "70000"], "--port"),
        (["demo", "--speed", "0"], "--speed"),
        (["demo", "--everything"], "--everything"),
        (["demo", "-o", "out", "--fault", "cnc:boredom"], "'cnc:boredom': unknown"),
    ],
)
def test_a_wrong_command_line_is_bad_input_in_one_line(arguments, said, capsys):
    assert run(arguments) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert said in line


def test_each_command_explains_itself_and_has_the_distributions_version(command):
    for name in ("serve", "demo", "analyse", "predict"):
        assert "Usage: " in command.run(name, "--help").out
    assert "Calibrates machine tools" in command.run().out
    assert command.run("--version").out.strip() == version("truepath")


def test_a_log_gets_a_line_a_stage(capsys):
    with show_progress("measure") as report:
        for share in (0.0, 0.2, 0.5):
            report(share, "measuring", f"{share} lost")
        report(1.0, "closing")
        report(1.0, "")
    said = capsys.readouterr()
    assert said.err.splitlines() == ["measure: measuring", "measure: closing"]
    assert said.out == ""


def test_a_terminal_gets_a_bar_and_tables_keep_columns(monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with show_progress("measure") as report:
        report(0.25, "measuring", "8000 samples, 0 lost")
    said = capsys.readouterr()
    for word in ("measuring", "25%", "8000 samples, 0 lost"):
        assert word in said.err
    assert said.out == ""
    print_table("Errors", ("error", "value"), [("EXX", "1.5"), ("C0Y", "-20.0")])
    lines = capsys.readouterr().out.splitlines()
    assert any("EXX" in line and line.rstrip().endswith("1.5 │") for line in lines)


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
        assert place.name in command.refuse("analyse", place, "-o", tmp_path / "out")


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
