"""`truepath machines` and `truepath reanalyse` at a service over a real socket."""

import json

import pytest

from truepath.cli.command import run
from truepath_simulators.machine_file import load_machine


@pytest.fixture
def machines(live, capsys):
    def call(verb, *words):
        status = run(["machines", verb, *words, "--address", str(live.base_url)])
        printed, said = capsys.readouterr()
        return status, printed, said

    return call


@pytest.fixture
def printed_of(machines):
    def call(*words):
        status, printed, _ = machines(*words)
        assert status == 0
        return printed

    return call


def test_lists_and_histories_state_calibrations(printed_of, calibrated):
    (one,) = json.loads(printed_of("list", "--json"))["machines"]
    newest = one["calibration"]
    assert (one["id"], newest["job_id"]) == ("default", calibrated[-1])
    assert newest["volumetric_error_p95_um"] == 30.0
    assert newest["expanded_uncertainty_um"] == 1.0
    assert newest["age_hours"] > 0.0
    assert one["standing"]["has_changed"] is False
    listed = " ".join(printed_of("list").split())
    assert all(word in listed for word in ("default", "30.0 ±", "unchanged"))
    history = ("history", "default", "--quantity", "EXX")
    found = json.loads(printed_of(*history, "--json"))
    assert [c["job_id"] for c in found["calibrations"]] == list(calibrated)
    position = str(found["entries"][1]["position"])
    assert "EXX of default" in printed_of(*history, "--position", position)
    assert "30.0 ± 1.0" in printed_of("compare")


def test_a_machine_is_added_shown_and_changed(printed_of, tmp_path, service):
    machine, devices = tmp_path / "mill.json", tmp_path / "devices.json"
    machine.write_text(json.dumps(load_machine("demo") | {"name": "mill 3"}))
    tracker, motion = {"port": "/dev/tracker-7"}, {"host": "192.0.2.7"}
    chosen = {"tracker_options": tracker, "motion_options": motion}
    devices.write_text(json.dumps(chosen))
    stated = ("--state", "serial_number=4711", "--state", "place=hall 3")
    printed_of("add", "mill-3", str(machine), *stated)
    shown = printed_of("show", "mill-3")
    assert all(word in shown for word in ("4711", "never"))
    taken = ("--state", "place=", "--state", "tolerance_um=12.5", "--json")
    printed = printed_of("change", "mill-3", *taken, "--devices", str(devices))
    service.machines.get("mill-3").close()
    changed = json.loads(printed)
    assert (changed["place"], changed["tolerance_um"]) == ("", 12.5)
    assert changed["serial_number"] == "4711"
    assert changed["devices"]["tracker_options"] == tracker


def test_what_is_wrong_is_one_line_and_exit_status_2(machines, calibrated, tmp_path):
    wrong = tmp_path / "wrong.json"
    wrong.write_text('{"name": "x"}')
    for words, said in (
        (("show", "press"), "no machine press"),
        (("add", "mill-3", str(wrong)), "wrong.json: schema is missing"),
        (("change", "default"), "nothing to change"),
        (("change", "default", "--state", "colour=red"), "colour=red"),
        (("change", "default", "--state", "tolerance_um=much"), "tolerance_um=much"),
        (("history", "default", "--quantity", "EXX", "--position", "3.3"), "3.3"),
    ):
        status, printed, line = machines(*words)
        assert (status, printed) == (2, ""), words
        assert line.startswith("truepath: ")
        assert line.count("\n") == 1
        assert said in line


def test_a_service_that_is_not_there_is_exit_status_1(capsys, monkeypatch):
    monkeypatch.setattr("truepath.client.requests.REPEATS_S", ())
    assert run(["machines", "list", "--address", "http://127.0.0.1:9"]) == 1
    assert "does not answer" in capsys.readouterr().err
    assert run(["machines", "list", "--address", "mill"]) == 2


def test_the_command_line_says_what_has_changed(live, reanalysed, capsys):
    words = ["--address", str(live.base_url).rstrip("/")]
    assert run(["reanalyse", "--machine", "default", *words]) == 0
    assert "2 of 2 Runs analysed, 0 failed" in capsys.readouterr().out
    assert run(["reanalyse", *reanalysed, *words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["total"] == 2
