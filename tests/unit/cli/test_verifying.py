"""`verify`: a result against a measurement that the calibration did not use."""

import json

import pytest

from truepath.files.bundle.bundle import write_bundle
from truepath_simulators.worlds import synthetic


@pytest.fixture(scope="module")
def held_out(record, tmp_path_factory):
    setting = synthetic.Setting(machine_seed=1)
    again, _ = record(101, "standstill", rows=30, feed=6000.0, setting=setting)
    folder = tmp_path_factory.mktemp("held-out") / "again"
    write_bundle(again, folder)
    return folder


@pytest.fixture
def words(analysed, held_out, tmp_path):
    def spell(*more):
        result = analysed / "result.json"
        return ["verify", result, held_out, "-o", tmp_path / "out", *more]

    return spell


def test_verify_writes_file_and_page_and_says_what_fails(command, words, tmp_path):
    order = words("--tolerance-um", "10")
    said = command.json(*order)
    assert said["schema"] == "verification-summary/1"
    assert said["conformity"]["deviation"]["conformity"] == "within"
    assert said["agreement"]["consistent"]
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {"verification.json", "report.html"}
    content = json.loads((out / "verification.json").read_text())
    assert content["schema"] == "verification/1"
    assert content["statements"] == said["statements"]
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 1
    assert "ISO 14253-1" in page
    # It was verified; what it says of the machine is another matter.
    told = command.run(*order)
    assert "The machine as it is fails" in told.out
    assert "measured: outside" in told.err


def test_inactive_files_are_found_out(few_places, command, words, analysed, tmp_path):
    stem = tmp_path / "tables" / "c"
    result = analysed / "result.json"
    command.run("export", result, "--format", "linuxcnc", "-o", stem)
    files = [x for f in stem.parent.glob("*.tbl") for x in ("--compensation", f)]
    said = command.run(*words("--format", "linuxcnc", *files))
    assert "the compensation is not active" in said.out
    assert "say its format with --format" in command.refuse(*words(*files))
    said = command.refuse(*words("--format", "linuxcnc"))
    assert "--compensation FILE" in said
