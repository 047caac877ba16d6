"""Backup and restore of a real data folder, while the service measures."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient

from truepath.catalogue.data_folder import hold_folder
from truepath.catalogue.errors import InUse
from truepath.catalogue.store.database import Database
from truepath.cli.command import run
from truepath.errors import BadInput
from truepath.files.bundle.bundle import zip_bundle
from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk
from truepath.main import open_service
from truepath.operation.archive import check_name
from truepath.operation.backup import Kept, make_backup, restore_backup
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath.users.roles import Role

sys.path.append(str(Path(__file__).parents[1] / "jobs"))
from service_process import ROWS, arm, create, follow, moving


@pytest.fixture(scope="module", autouse=True)
def logged_plainly(plain_log):
    """The commands set the log up; it is put back."""


class Backups(NamedTuple):
    folder: Path
    kept: Kept
    analysed: str
    measuring: str
    metrics: str


@pytest.fixture(scope="module")
def backups(tmp_path_factory, record):
    """A service with a result and a user, kept while it measures; its data folder."""
    folder = tmp_path_factory.mktemp("backup")
    settings = load_settings(
        data_dir=folder / "data", simulated=True, simulated_speed=4.0, port=0
    )
    bundle = zip_bundle(record(1, rows=24)[0])
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        service.access.accounts.add("ada", Role.OPERATOR, "a long enough password")
        sent = client.post("/api/v1/runs", files={"bundle": ("run.zip", bundle)})
        assert sent.status_code in (200, 201), sent.text
        order = {"kind": "analyse", "run_id": sent.json()["id"]}
        analysed = client.post("/api/v1/jobs", json=order).json()
        follow(client, analysed["id"], "succeeded")
        client.post("/api/v1/machines/current:connect")
        job = create(client, path=ROWS)
        arm(client, job)
        moving(client, job["id"])
        scraped = client.get("/metrics").text
        kept = make_backup(settings, folder / "folder")
        make_backup(settings, folder / "one.zip")
        assert client.get(f"/api/v1/jobs/{job['id']}").json()["state"] == "running"
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        follow(client, job["id"], "aborted")
    return Backups(folder, kept, analysed["id"], job["id"], scraped)


@pytest.mark.timeout(240)
def test_a_measurement_under_way_is_counted_as_prometheus_reads_it(backups):
    found = {
        sample.name: sample.value
        for family in text_string_to_metric_families(backups.metrics)
        for sample in family.samples
        if sample.labels.get("machine") == "default"
    }
    assert found["truepath_tracker_samples_total"] > 500
    assert (
        found["truepath_tracker_gaps_total"] <= found["truepath_tracker_samples_total"]
    )
    assert found["truepath_recorder_commit_seconds_count"] > 5
    assert found["truepath_recorder_commit_seconds_sum"] > 0
    assert 0 <= found["truepath_recorder_queue_depth"] < 200
    assert found["truepath_cell_connected"] == 1


def list_bytes(folder):
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


@pytest.mark.timeout(240)
@pytest.mark.parametrize("name", ["folder", "one.zip"])
def test_what_was_kept_under_a_running_measurement_comes_back_whole(
    backups, tmp_path, name, capsys
):
    folder, kept, analysed, measuring, _ = backups
    assert list(kept.left_out) == [f"runs/{measuring}.sqlite"]
    target = tmp_path / "elsewhere"
    assert run(["restore", str(folder / name), "--data-dir", str(target)]) == 0
    result = folder / "data" / "results" / analysed
    assert list_bytes(target / "results" / analysed) == list_bytes(result)
    capsys.readouterr()
    assert run(["catalogue", "check", "--data-dir", str(target), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["jobs"], found["runs"]) == (2, 1)
    assert found["runs_without_row"] == found["rows_without_file"] == []
    settings = load_settings(data_dir=target, port=0)
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        jobs = {job["id"]: job for job in client.get("/api/v1/jobs").json()["items"]}
        assert jobs[analysed]["state"] == "succeeded"
        assert jobs[measuring]["state"] == "interrupted"
        answer = client.get(f"/api/v1/jobs/{analysed}/result")
        assert answer.content == (result / "result.json").read_bytes()
        assert [user.name for user in service.access.accounts.list_all()] == ["ada"]


def test_a_backup_is_restored_to_an_empty_database_of_postgresql(
    backups, postgres_server, tmp_path
):
    name = postgres_server.make_database()
    url = postgres_server.url(name)
    target = tmp_path / "elsewhere"
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


def flip(file, place=0.5):
    data = bytearray(file.read_bytes())
    data[int(len(data) * place)] ^= 1
    file.write_bytes(data)


@pytest.fixture
def copy(backups, tmp_path):
    return shutil.copytree(backups.folder / "folder", tmp_path / "copy")


def test_a_flipped_byte_is_refused_by_the_name_of_its_file(copy, tmp_path):
    target = tmp_path / "elsewhere"
    files = [file for file in sorted(copy.rglob("*")) if file.stat().st_size]
    for file in (one for one in files if one.is_file()):
        whole = file.read_bytes()
        flip(file)
        named = file.relative_to(copy).as_posix().removesuffix(".sha256")
        with pytest.raises(BadInput, match=named):
            restore_backup(load_settings(data_dir=target), copy)
        file.write_bytes(whole)
    assert [one.name for one in target.iterdir()] == [".lock"]
    restore_backup(load_settings(data_dir=target), copy)


def test_a_flipped_byte_of_a_zip_file_is_refused(backups, tmp_path):
    target = tmp_path / "elsewhere"
    whole = (backups.folder / "one.zip").read_bytes()
    with zipfile.ZipFile(backups.folder / "one.zip") as archive:
        names = {
            info.filename: info.header_offset
            for info in archive.infolist()
            if info.compress_size > 100
        }
    assert len(names) > 5
    for name, offset in names.items():
        damaged = bytearray(whole)
        damaged[offset + 30 + len(name.encode()) + 40] ^= 1
        file = tmp_path / "damaged.zip"
        file.write_bytes(damaged)
        with pytest.raises(BadInput, match=r"damaged|SHA-256|differs"):
            restore_backup(load_settings(data_dir=target), file)


def test_a_missing_file_is_named(copy, tmp_path):
    (gone,) = (copy / "runs").glob("*.zip")
    gone.unlink()
    with pytest.raises(BadInput, match=f"{gone.name}: is missing"):
        restore_backup(load_settings(data_dir=tmp_path / "elsewhere"), copy)


def test_data_that_are_there_are_replaced_by_force_only_and_kept(copy, tmp_path):
    target = tmp_path / "elsewhere"
    (target / "runs").mkdir(parents=True)
    (target / "runs" / "old.sqlite").write_text("old")
    settings = load_settings(data_dir=target)
    with pytest.raises(BadInput, match="--force"):
        restore_backup(settings, copy)
    assert (target / "runs" / "old.sqlite").read_text() == "old"
    restore_backup(settings, copy, force=True)
    (aside,) = target.glob("aside-*")
    assert (aside / "runs" / "old.sqlite").read_text() == "old"
    assert (target / "catalogue.sqlite").is_file()


def test_nothing_is_restored_under_a_running_service(copy, tmp_path):
    target = tmp_path / "elsewhere"
    with hold_folder(target), pytest.raises(InUse):
        restore_backup(load_settings(data_dir=target), copy)


@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "runs/../../x", "runs", "other/x", "runs//x", ""]
)
def test_a_name_that_leads_out_of_the_data_folder_is_refused(name):
    if name == "runs":
        assert check_name(name, ("runs",))
        return
    with pytest.raises(BadInput):
        check_name(name, ("runs", "results"))


def test_what_is_no_backup_is_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("no zip")
    for name in ("empty", "text", "nowhere"):
        words = ["restore", str(tmp_path / name), "--data-dir", str(tmp_path / "d")]
        assert run(words) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_folder_without_a_catalogue_and_a_place_that_is_taken_are_refused(
    tmp_path, backups, capsys
):
    words = ["backup", "-o", str(tmp_path / "b"), "--data-dir", str(tmp_path / "data")]
    assert run(words) == 2
    assert not (tmp_path / "b").exists()
    folder = backups.folder
    words = ["--data-dir", str(folder / "data")]
    assert run(["backup", "-o", str(folder / "one.zip"), *words]) == 2
    assert run(["backup", "-o", str(folder / "data" / "b"), *words]) == 2
