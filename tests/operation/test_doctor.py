"""`truepath doctor`: what is wrong is named, with what to do; nothing is disturbed."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import pytest

from truepath.catalogue.data_folder import hold_folder
from truepath.cli.command import run
from truepath.errors import BadInput
from truepath.operation import computer, devices, storage
from truepath.operation.finding import Grade
from truepath.operation.running_service import (
    RunningService,
    find_service,
    look_at_service,
)
from truepath.settings import load_settings
from truepath_simulators.bench.rig import running_rig
from truepath_simulators.scenario import load_machine

NONE = RunningService(is_there=False)


@pytest.fixture
def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


@pytest.fixture
def settings(tmp_path, free_port):
    def make(**given):
        return load_settings(None, data_dir=tmp_path / "data", port=free_port, **given)

    return make


def test_an_installation_in_order_is_found_in_order(settings, capsys, tmp_path):
    settings()
    status = run(["doctor", "--data-dir", str(tmp_path / "data"), "--json"])
    told = json.loads(capsys.readouterr().out)
    grades = {one["subject"]: one["grade"] for one in told["findings"]}
    assert grades["versions"] == grades["disk"] == grades["catalogue"] == "ok"
    wrong = [one for one in told["findings"] if one["grade"] == "wrong"]
    assert (status, told["good"]) == (int(bool(wrong)), not wrong)
    assert not (tmp_path / "data").exists(), "it was to change nothing"


def test_a_library_of_another_version_is_named(monkeypatch):
    monkeypatch.setattr(computer, "requires", lambda _: ["numpy>=99", "nothere>=1"])
    found = computer.look_at_versions()
    assert found.grade is Grade.WRONG
    assert "numpy is" in found.text
    assert "nothere is missing" in found.text
    assert "constraints.txt" in found.remedy


@pytest.mark.fault_row(29)
def test_a_clock_that_was_never_set_is_wrong():
    found = computer.look_at_clock(datetime(1970, 1, 1, tzinfo=UTC))
    assert found.grade is Grade.WRONG


@pytest.mark.parametrize(("free_kb", "grade"), [(500_000, "warning"), (4 << 20, "ok")])
def test_little_memory_is_told(tmp_path, free_kb, grade):
    file = tmp_path / "meminfo"
    file.write_text(f"MemTotal:       99 kB\nMemAvailable:   {free_kb} kB\n")
    assert computer.look_at_memory(file).grade == grade


def test_several_threads_of_linear_algebra_are_told(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    found = computer.look_at_threads()
    assert found.grade is Grade.WARNING
    assert "OMP_NUM_THREADS=8" in found.text


@pytest.mark.parametrize("kind", ["nfs4", "cifs", "fuse.sshfs"])
def test_a_data_folder_on_a_network_share_is_wrong(tmp_path, kind):
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/sda1 / ext4 rw 0 0\nserver:/x {tmp_path} {kind} rw 0 0\n")
    found = storage.look_at_file_system(tmp_path, mounts)
    assert found.grade is Grade.WRONG
    assert kind in found.text
    elsewhere = storage.look_at_file_system(Path("/"), mounts)
    assert (elsewhere.grade, elsewhere.text) == (Grade.OK, "ext4")


def test_no_service_starts_in_a_data_folder_on_a_network_share(tmp_path):
    mounts, folder = tmp_path / "mounts", tmp_path / "data"
    mounts.write_text(f"/dev/sda1 / ext4 rw 0 0\nserver:/x {folder} nfs4 rw 0 0\n")
    with (
        pytest.raises(BadInput, match=r"data_dir.*\(nfs4\).*give a disk of this comp"),
        hold_folder(folder, mounts),
    ):
        pass
    with hold_folder(tmp_path / "elsewhere", mounts):
        pass


def test_a_file_in_place_of_the_data_folder_is_wrong(tmp_path):
    file = tmp_path / "data"
    file.write_text("")
    found = storage.look_at_rights(file, storage.find_existing(file))
    assert found.grade is Grade.WRONG


@pytest.mark.parametrize(
    ("free", "grade"), [(10**8, "wrong"), (2 * 10**9, "warning"), (10**11, "ok")]
)
def test_room_on_the_disk_is_graded(monkeypatch, tmp_path, free, grade):
    usage = SimpleNamespace(free=free)
    monkeypatch.setattr(storage.shutil, "disk_usage", lambda _: usage)
    assert storage.look_at_room(tmp_path).grade == grade


@pytest.mark.fault_row(37)
def test_a_damaged_catalogue_is_wrong_and_says_the_way_out(settings):
    given = settings()
    given.data_dir.mkdir()
    (given.data_dir / "catalogue.sqlite").write_text("no database")
    found = storage.look_at_catalogue(given)
    assert found.grade is Grade.WRONG
    assert "catalogue rebuild" in found.text


def test_a_port_that_somebody_has_taken_is_wrong(settings):
    given = settings()
    with socket.create_server(("127.0.0.1", given.port)):
        found = look_at_service(given, find_service(given))
    assert found.grade is Grade.WRONG
    assert str(given.port) in found.text
    assert look_at_service(given, find_service(given)).grade is Grade.OK


def test_a_service_that_runs_is_asked_and_keeps_its_devices(settings, monkeypatch):
    given = settings(machine_file=None)
    given.data_dir.mkdir()
    hold = (
        "import sys; from pathlib import Path\n"
        "from truepath.catalogue.data_folder import hold_folder\n"
        "with hold_folder(Path(sys.argv[1])):\n"
        "    print('held', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, given.data_dir],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout.readline() == "held\n"
        running = find_service(given)
        assert running == RunningService(is_there=True)
        assert look_at_service(given, running).grade is Grade.WARNING
        asked = []
        monkeypatch.setattr(devices, "ask_device", lambda *a: [asked.append(a)])
        list(devices.look_at_devices(given, running))
        assert asked == []
        holder.stdin.close()


@pytest.mark.parametrize(
    ("running", "words"),
    [
        (RunningService(True, True, {"version": "7.1"}), "version 7.1"),
        (RunningService(True, True), "log-in"),
    ],
)
def test_a_service_that_answers_is_in_order(settings, running, words):
    found = look_at_service(settings(), running)
    assert found.grade is Grade.OK
    assert words in found.text


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
        found = {f.subject: f for f in devices.look_at_devices(given, NONE)}
        assert rig.read_position()["position"] == before
    assert found["machine"].grade is Grade.OK
    assert found["motion"].grade is Grade.OK
    assert "serial" in found["motion"].text
    assert found["tracker"].grade is Grade.WRONG
    assert "cable" in found["tracker"].remedy


def test_an_option_that_no_driver_takes_is_named(settings, tmp_path):
    (found,) = devices.ask_device("motion", "modbus", {"hots": "192.0.2.1"})
    assert found.grade is Grade.WRONG
    assert "did you mean host?" in found.text


def test_a_serial_port_is_looked_at_before_it_is_opened(tmp_path):
    gone = {"port": str(tmp_path / "ttyX")}
    (found,) = devices.look_at_port("tracker", gone)
    assert found.grade is Grade.WRONG
    assert "not there" in found.text
    port = tmp_path / "tracker"
    port.touch()
    (found,) = devices.look_at_port("tracker", {"port": str(port)})
    assert found.grade is Grade.OK
    assert list(devices.look_at_port("tracker", {"host": "x", "port": 5000})) == []
