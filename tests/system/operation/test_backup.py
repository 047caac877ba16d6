"""Backup and restore of a real data folder, while the service measures."""

import json
import shutil
import zipfile

import pytest
from starlette.testclient import TestClient
from tests.system.operation.conftest import ANALYSED

from truepath.catalogue.data_folder import hold_folder
from truepath.catalogue.errors import InUse
from truepath.cli.command import run
from truepath.errors import BadInput
from truepath.main import open_service
from truepath.operation.archive import check_name
from truepath.operation.backup import restore_backup
from truepath.service.api.application import create_application
from truepath.settings import load_settings


@pytest.fixture(scope="module", autouse=True)
def logged_plainly(plain_log):
    """The commands set the log up; it is put back."""


def list_bytes(folder):
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def test_what_was_kept_under_a_running_measurement_comes_back_whole(
    backups, tmp_path, capsys
):
    folder, kept, measuring = backups
    assert list(kept.left_out) == [f"runs/{measuring}.sqlite"]
    result = folder / "data" / "results" / ANALYSED
    for name in ("one.zip", "folder"):
        target = tmp_path / name
        assert run(["restore", str(folder / name), "--data-dir", str(target)]) == 0
        assert list_bytes(target / "results" / ANALYSED) == list_bytes(result)
        capsys.readouterr()
        assert run(["catalogue", "check", "--data-dir", str(target), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["jobs"], found["runs"]) == (4, 2)
        assert found["runs_without_row"] == found["rows_without_file"] == []
    settings = load_settings(data_dir=target, port=0)
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        jobs = {job["id"]: job for job in client.get("/api/v1/jobs").json()["items"]}
        assert jobs[ANALYSED]["state"] == "succeeded"
        assert jobs[measuring]["state"] == "interrupted"
        answer = client.get(f"/api/v1/jobs/{ANALYSED}/result")
        assert answer.content == (result / "result.json").read_bytes()
        assert [user.name for user in service.access.accounts.list_all()] == ["ada"]


@pytest.fixture
def copy(backups, tmp_path):
    return shutil.copytree(backups.folder / "folder", tmp_path / "copy")


def test_a_flipped_byte_or_a_missing_file_is_refused_by_its_name(copy, tmp_path):
    target = tmp_path / "elsewhere"
    for file in [file for file in sorted(copy.rglob("*")) if file.is_file()]:
        whole = file.read_bytes()
        if not whole:
            continue
        damaged = bytearray(whole)
        damaged[len(whole) // 2] ^= 1
        file.write_bytes(damaged)
        named = file.relative_to(copy).as_posix().removesuffix(".sha256")
        with pytest.raises(BadInput, match=named):
            restore_backup(load_settings(data_dir=target), copy)
        file.write_bytes(whole)
    (gone,) = (copy / "runs").glob("*.zip")
    whole = gone.read_bytes()
    gone.unlink()
    with pytest.raises(BadInput, match=f"{gone.name}: is missing"):
        restore_backup(load_settings(data_dir=target), copy)
    gone.write_bytes(whole)
    assert [one.name for one in target.iterdir()] == [".lock"]
    restore_backup(load_settings(data_dir=target), copy)


def test_a_flipped_byte_of_a_zip_file_is_refused(backups, tmp_path):
    whole = (backups.folder / "one.zip").read_bytes()
    with zipfile.ZipFile(backups.folder / "one.zip") as archive:
        packed = [info for info in archive.infolist() if info.compress_size > 100]
    assert len(packed) > 5
    file = tmp_path / "damaged.zip"
    for info in packed:
        damaged = bytearray(whole)
        damaged[info.header_offset + 30 + len(info.filename.encode()) + 40] ^= 1
        file.write_bytes(damaged)
        with pytest.raises(BadInput, match=r"damaged|SHA-256|differs"):
            restore_backup(load_settings(data_dir=tmp_path / "elsewhere"), file)


def test_data_that_are_there_are_replaced_by_force_only_and_kept(copy, tmp_path):
    target = tmp_path / "elsewhere"
    (target / "runs").mkdir(parents=True)
    (target / "runs" / "old.sqlite").write_text("old")
    settings = load_settings(data_dir=target)
    with hold_folder(target), pytest.raises(InUse):
        restore_backup(settings, copy, force=True)
    with pytest.raises(BadInput, match="--force"):
        restore_backup(settings, copy)
    assert (target / "runs" / "old.sqlite").read_text() == "old"
    restore_backup(settings, copy, force=True)
    (aside,) = target.glob("aside-*")
    assert (aside / "runs" / "old.sqlite").read_text() == "old"
    assert (target / "catalogue.sqlite").is_file()


@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "runs/../../x", "other/x", "runs//x", ""]
)
def test_a_name_that_leads_out_of_the_data_folder_is_refused(name):
    assert check_name("runs", ("runs",))
    with pytest.raises(BadInput):
        check_name(name, ("runs", "results"))


def test_what_cannot_be_kept_or_restored_is_refused_in_one_line(
    tmp_path, backups, capsys
):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("no zip")
    none, data = str(tmp_path / "data"), str(backups.folder / "data")
    taken, inside = backups.folder / "one.zip", backups.folder / "data" / "b"
    for words in (
        ["restore", str(tmp_path / "empty"), "--data-dir", none],
        ["restore", str(tmp_path / "text"), "--data-dir", none],
        ["restore", str(tmp_path / "nowhere"), "--data-dir", none],
        ["backup", "-o", str(tmp_path / "b"), "--data-dir", none],
        ["backup", "-o", str(taken), "--data-dir", data],
        ["backup", "-o", str(inside), "--data-dir", data],
    ):
        assert run(words) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "b").exists()
