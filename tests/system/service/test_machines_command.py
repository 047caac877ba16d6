"""`truepath machines` and `truepath reanalyse` at a service over a real socket."""

import json

import pytest

from truepath.cli.command import run
from truepath_simulators.scenario import load_machine


@pytest.fixture
def machines(live, capsys):
    """The command at the service: exit status, what it printed, what it said."""

    def call(verb, *words):
        status = run(["machines", verb, *words, "--address", str(live.base_url)])
        printed, said = capsys.readouterr()
        return status, printed, said

    return call


@pytest.fixture
def files(tmp_path):
    machine, devices = tmp_path / "mill.json", tmp_path / "devices.json"
    machine.write_text(json.dumps(load_machine("demo") | {"name": "mill 3"}))
    chosen = {
        "tracker_options": {"port": "/dev/tracker-7"},
        "motion_options": {"host": "192.0.2.7"},
    }
    devices.write_text(json.dumps(chosen))
    return str(machine), str(devices)


def test_list_history_and_comparison_state_calibrations_and_standing(
    machines, calibrated
):
    status, printed, _ = machines("list", "--json")
    assert status == 0
    (one,) = json.loads(printed)["machines"]
    newest = one["calibration"]
    assert (one["id"], newest["job_id"]) == ("default", calibrated[-1])
    assert newest["volumetric_error_p95_um"] == 30.0
    assert newest["expanded_uncertainty_um"] == 1.0
    assert newest["age_hours"] > 0.0
    assert one["standing"]["has_changed"] is False
    status, printed, _ = machines("list")
    assert "default" in printed
    assert "30.0 ±" in " ".join(printed.split())
    assert "unchanged" in printed
    status, printed, _ = machines("history", "default", "--quantity", "EXX", "--json")
    assert status == 0
    found = json.loads(printed)
    assert [c["job_id"] for c in found["calibrations"]] == list(calibrated)
    position = str(found["entries"][1]["position"])
    at = ("--quantity", "EXX", "--position", position)
    assert "EXX of default" in machines("history", "default", *at)[1]
    status, printed, _ = machines("compare")
    assert status == 0
    assert "30.0 ± 1.0" in printed


def test_a_machine_is_added_shown_and_changed(machines, files, service):
    machine, devices = files
    stated = ("--state", "serial_number=4711", "--state", "place=hall 3")
    assert machines("add", "mill-3", machine, *stated)[0] == 0
    status, printed, _ = machines("show", "mill-3")
    assert status == 0
    assert "4711" in printed
    assert "never" in printed
    taken = ("--state", "place=", "--state", "tolerance_um=12.5")
    status, printed, _ = machines(
        "change", "mill-3", *taken, "--devices", devices, "--json"
    )
    service.machines.get("mill-3").close()
    assert status == 0
    changed = json.loads(printed)
    assert (changed["place"], changed["tolerance_um"]) == ("", 12.5)
    assert changed["serial_number"] == "4711"
    assert changed["devices"]["tracker_options"] == {"port": "/dev/tracker-7"}


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
    monkeypatch.setattr("truepath.client.steps.REPEATS_S", ())
    assert run(["machines", "list", "--address", "http://127.0.0.1:9"]) == 1
    assert "does not answer" in capsys.readouterr().err
    assert run(["machines", "list", "--address", "mill"]) == 2


def test_the_command_line_says_what_has_changed(live, reanalysed, capsys):
    words = ["--address", str(live.base_url).rstrip("/")]
    assert run(["reanalyse", "--machine", "default", *words]) == 0
    assert "2 of 2 Runs analysed, 0 failed" in capsys.readouterr().out
    assert run(["reanalyse", *reanalysed, *words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["total"] == 2
