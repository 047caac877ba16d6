"""Every failure is one line on standard error and one of three exit statuses."""

import errno
from importlib.metadata import version

import pytest

from truepath.cli.command import run, run_command
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
    assert captured.err == line + "\n"
    assert captured.out == ""


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
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert said in captured.err


def test_each_command_explains_itself_and_has_the_distributions_version(command):
    for name in ("serve", "demo", "analyse", "predict"):
        assert "Usage: " in command.run(name, "--help").out
    assert "Calibrates machine tools" in command.run().out
    assert command.run("--version").out.strip() == version("truepath")
