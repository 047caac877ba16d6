"""`truepath doctor` asks a service and devices, and disturbs neither."""

import json
import socket
from functools import partial

import pytest

from truepath.catalogue.data_dir_lock import hold_folder
from truepath.cli.command import run
from truepath.operation import devices
from truepath.operation.finding import Grade
from truepath.operation.running_service import (
    RunningService,
    check_service,
    find_service,
)
from truepath.settings import load_settings
from truepath_simulators.bench.rig import running_rig
from truepath_simulators.scenario import load_machine

NONE = RunningService(is_there=False)


@pytest.fixture
def settings(tmp_path, free_port):
    return partial(load_settings, data_dir=tmp_path / "data", port=free_port)


def test_an_installation_in_order_is_found_in_order(capsys, tmp_path):
    status = run(["doctor", "--data-dir", str(tmp_path / "data"), "--json"])
    told = json.loads(capsys.readouterr().out)
    grades = {one["subject"]: one["grade"] for one in told["findings"]}
    assert grades["versions"] == grades["disk"] == grades["catalogue"] == "ok"
    wrong = [one for one in told["findings"] if one["grade"] == "wrong"]
    assert (status, told["good"]) == (int(bool(wrong)), not wrong)
    assert not (tmp_path / "data").exists(), "it was to change nothing"


def test_a_port_that_somebody_has_taken_is_wrong_unless_a_service_answers(settings):
    given = settings()
    with socket.create_server(("127.0.0.1", given.port)):
        found = check_service(given, find_service(given))
    assert found.grade is Grade.WRONG
    assert str(given.port) in found.text
    assert check_service(given, find_service(given)).grade is Grade.OK
    for told, words in (({"version": "7.1"}, "version 7.1"), (None, "log-in")):
        found = check_service(given, RunningService(True, True, told))
        assert found.grade is Grade.OK
        assert words in found.text


def test_a_service_that_runs_is_asked_and_keeps_its_devices(settings, monkeypatch):
    given = settings(machine_file=None)
    with hold_folder(given.data_dir):
        running = find_service(given)
        assert running == RunningService(is_there=True)
        assert check_service(given, running).grade is Grade.WARNING
        asked = []
        monkeypatch.setattr(devices, "query_device", lambda *a: [asked.append(a)])
        list(devices.check_devices(given, running))
        assert asked == []


def test_devices_that_answer_are_named_and_those_that_do_not_say_what_to_do(
    settings, tmp_path, free_port
):
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    with running_rig({"tracker": "tcp"}) as rig:
        given = settings(
            machine_file=file,
            tracker_options={"host": "127.0.0.1", "port": free_port},
            motion_options=rig.motion_options,
        )
        before = rig.read_position()["position"]
        found = {f.subject: f for f in devices.check_devices(given, NONE)}
        assert rig.read_position()["position"] == before
    assert found["machine"].grade is Grade.OK
    assert found["motion"].grade is Grade.OK
    assert "serial" in found["motion"].text
    assert found["tracker"].grade is Grade.WRONG
    assert "cable" in found["tracker"].remedy
