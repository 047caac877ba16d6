"""`truepath doctor`: what is wrong is named, with what to do; nothing is disturbed."""

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import pytest

from truepath import errors, settings
from truepath.catalogue.locks import hold_folder
from truepath.operation import doctor
from truepath.operation.doctor import Grade
from truepath.operation.running_service import RunningService


def test_a_library_of_another_version_is_named(monkeypatch):
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy>=99", "nothere>=1"])
    found = doctor.check_versions()
    assert found.grade is Grade.WRONG
    assert "numpy is" in found.text
    assert "nothere is missing" in found.text
    assert "constraints.txt" in found.remedy


@pytest.mark.fault_row(29)
def test_a_clock_that_was_never_set_is_wrong():
    found = doctor.check_clock(datetime(1970, 1, 1, tzinfo=UTC))
    assert found.grade is Grade.WRONG


def test_what_cannot_be_told_has_a_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.shutil, "which", lambda _: None)
    for found in (
        doctor.check_clock(),
        doctor.check_memory(tmp_path / "none"),
        doctor.check_file_system(tmp_path, tmp_path / "none"),
        doctor.read_cell(RunningService(is_there=True, answers=True)),
    ):
        assert (found.grade, bool(found.remedy)) == (Grade.UNTOLD, True)


def test_memory_threads_room_and_rights_of_the_folder_are_graded(tmp_path, monkeypatch):
    file = tmp_path / "meminfo"
    for free_kb, grade in ((500_000, "warning"), (4 << 20, "ok")):
        file.write_text(f"MemTotal:       99 kB\nMemAvailable:   {free_kb} kB\n")
        assert doctor.check_memory(file).grade == grade
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    found = doctor.check_threads()
    assert found.grade is Grade.WARNING
    assert "OMP_NUM_THREADS=8" in found.text
    file = tmp_path / "data"
    file.write_text("")
    assert doctor.check_rights(file, doctor.find_existing(file)).grade is Grade.WRONG
    for free, grade in ((10**8, "wrong"), (2 * 10**9, "warning"), (10**11, "ok")):
        usage = SimpleNamespace(free=free)
        monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _, u=usage: u)
        assert doctor.check_room(tmp_path).grade == grade


@pytest.mark.parametrize("kind", ["nfs4", "cifs", "fuse.sshfs"])
def test_a_data_folder_on_a_network_share_is_wrong_and_refused(tmp_path, kind):
    mounts, folder = tmp_path / "mounts", tmp_path / "data"
    mounts.write_text(f"/dev/sda1 / ext4 rw 0 0\nserver:/x {folder} {kind} rw 0 0\n")
    found = doctor.check_file_system(folder, mounts)
    assert found.grade is Grade.WRONG
    assert kind in found.text
    elsewhere = doctor.check_file_system(Path("/"), mounts)
    assert (elsewhere.grade, elsewhere.text) == (Grade.OK, "ext4")
    refusal = rf"data_dir.*\({kind}\).*give a disk of this comp"
    with pytest.raises(errors.BadInput, match=refusal), hold_folder(folder, mounts):
        pass
    with hold_folder(tmp_path / "elsewhere", mounts):
        pass


@pytest.mark.fault_row(37)
def test_a_damaged_catalogue_is_wrong_and_says_the_way_out(tmp_path):
    given = settings.load_settings(data_dir=tmp_path)
    (tmp_path / "catalogue.sqlite").write_text("no database")
    found = doctor.check_catalogue_file(given)
    assert found.grade is Grade.WRONG
    assert "catalogue rebuild" in found.text


def test_an_option_is_named_and_a_serial_port_looked_at_before_it_is_opened(tmp_path):
    (found,) = doctor.query_device("motion", "modbus", {"hots": "192.0.2.1"})
    assert found.grade is Grade.WRONG
    assert "did you mean host?" in found.text
    gone = {"port": str(tmp_path / "ttyX")}
    (found,) = doctor.check_port("tracker", gone)
    assert found.grade is Grade.WRONG
    assert "not there" in found.text
    port = tmp_path / "tracker"
    port.touch()
    (found,) = doctor.check_port("tracker", {"port": str(port)})
    assert found.grade is Grade.OK
    assert list(doctor.check_port("tracker", {"host": "x", "port": 5000})) == []
