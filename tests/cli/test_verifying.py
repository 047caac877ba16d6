"""`verify`: a result against a measurement that the calibration did not use."""

import json

import pytest

from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle
from truepath_simulators.worlds import synthetic


@pytest.fixture(scope="module")
def held_out(record, tmp_path_factory):
    """The same machine, measured at points from elsewhere."""
    setting = synthetic.Setting(machine_seed=1)
    again, _ = record(101, "standstill", rows=30, feed=6000.0, setting=setting)
    folder = tmp_path_factory.mktemp("held-out") / "again"
    write_bundle(again, folder)
    return folder


@pytest.fixture
def verify(analysed, held_out, tmp_path):
    out = tmp_path / "out"

    def call(*more, bundle=held_out):
        arguments = [str(analysed / "result.json"), str(bundle), "-o", str(out)]
        return run(["verify", *arguments, *map(str, more)]), out

    return call


def test_verify_writes_its_file_and_its_page(verify, summary, capsys):
    status, out = verify("--tolerance-um", "5", "--json")
    assert status == 0
    said = summary()
    assert said["schema"] == "verification-summary/1"
    assert said["conformity"]["deviation"]["conformity"] == "within"
    assert said["agreement"]["consistent"]
    assert {path.name for path in out.iterdir()} == {
        "verification.json",
        "report.html",
    }
    content = json.loads((out / "verification.json").read_text())
    assert content["schema"] == "verification/1"
    assert content["statements"] == said["statements"]
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 1
    assert "ISO 14253-1" in page


def test_a_machine_out_of_tolerance_is_said_aloud(verify, capsys):
    status, _ = verify("--tolerance-um", "5")
    assert status == 0  # it was verified; what it says is another matter
    said = capsys.readouterr()
    assert "The machine as it is fails" in said.out
    assert "measured: outside" in said.err


def test_files_that_were_not_active_are_found_out(verify, analysed, tmp_path, capsys):
    stem = tmp_path / "tables" / "c"
    result = str(analysed / "result.json")
    assert run(["export", result, "--format", "linuxcnc", "-o", str(stem)]) == 0
    files = [x for f in stem.parent.glob("*.tbl") for x in ("--compensation", f)]
    assert verify("--format", "linuxcnc", *files)[0] == 0
    assert "the compensation is not active" in capsys.readouterr().out
    assert verify(*files)[0] == 2
    assert "say its format with --format" in capsys.readouterr().err
    assert verify("--format", "linuxcnc")[0] == 2
    assert "--compensation FILE" in capsys.readouterr().err


def test_the_measurement_behind_the_result_is_refused(verify, recorded, capsys):
    assert verify(bundle=recorded)[0] == 2
    assert "the result was made from this measurement" in capsys.readouterr().err
