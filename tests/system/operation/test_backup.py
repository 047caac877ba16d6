"""Backup and restore of a real data folder, while the service measures."""

import json
import shutil
import zipfile
from contextlib import closing

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.system.operation.conftest import ANALYSED

from real_services import service_of
from service_process import ROWS, arm, create, follow, moving
from truepath.catalogue.data_dir_lock import hold_folder
from truepath.catalogue.errors import InUse
from truepath.catalogue.store.database import Database
from truepath.cli.command import run
from truepath.errors import BadInput
from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk
from truepath.operation.archive import check_name
from truepath.operation.backup import make_backup, restore_backup
from truepath.settings import load_settings


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
    with service_of(load_settings(data_dir=target, port=0)) as (service, client):
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


@pytest.mark.long
@pytest.mark.timeout(240)
def test_a_measurement_under_way_is_counted_and_does_not_hinder_a_backup(tmp_path):
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_speed=4.0, port=0
    )
    with service_of(settings) as (_, client):
        client.post("/api/v1/machines/current:connect")
        job = create(client, path=ROWS)
        arm(client, job)
        moving(client, job["id"])
        metrics = client.get("/metrics").text
        kept = make_backup(settings, tmp_path / "kept")
        assert client.get(f"/api/v1/jobs/{job['id']}").json()["state"] == "running"
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        follow(client, job["id"], "aborted")
    assert list(kept.left_out) == [f"runs/{job['id']}.sqlite"]
    restored = load_settings(data_dir=tmp_path / "elsewhere")
    assert restore_backup(restored, tmp_path / "kept").rows["jobs"] == 1
    # It is counted as Prometheus reads it.
    found = {
        sample.name: sample.value
        for family in text_string_to_metric_families(metrics)
        for sample in family.samples
        if sample.labels.get("machine") == "default"
    }
    assert found["truepath_tracker_samples_total"] > 500
    gaps = found["truepath_tracker_gaps_total"]
    assert gaps <= found["truepath_tracker_samples_total"]
    assert found["truepath_recorder_commit_seconds_count"] > 5
    assert found["truepath_recorder_commit_seconds_sum"] > 0
    assert 0 <= found["truepath_recorder_queue_depth"] < 200
    assert found["truepath_cell_connected"] == 1


def test_a_backup_is_restored_to_an_empty_database_of_postgresql(
    backups, postgres_server, tmp_path
):
    name = postgres_server.make_database()
    url, target = postgres_server.url(name), tmp_path / "elsewhere"
    settings = load_settings(data_dir=target, database_url=url)
    kept = restore_backup(settings, backups.folder / "folder")
    with closing(Database(url)) as database:
        found = check_against_disk(database, target / "runs")
        assert (found["jobs"], found["rows_without_file"]) == (kept.rows["jobs"], [])
    other = load_settings(data_dir=tmp_path / "third", database_url=url)
    with pytest.raises(BadInput, match="not empty"):
        restore_backup(other, backups.folder / "folder")
    assert [one.name for one in (tmp_path / "third").iterdir()] == [".lock"]
    postgres_server.drop_database(name)
