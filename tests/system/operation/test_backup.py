"""A data folder is kept while the service measures, restored, opened by a later one."""

import hashlib
import json
import shutil
import sqlite3
import zipfile
from contextlib import closing

import pytest
from alembic.script import ScriptDirectory
from prometheus_client.parser import text_string_to_metric_families
from tests.system.operation.conftest import ANALYSED, unpack

from real_services import service_of
from service_process import ROWS, arm, create, follow, moving
from truepath.catalogue import database as database_module
from truepath.catalogue.database import Database
from truepath.catalogue.errors import InUse, SchemaTooOld
from truepath.catalogue.locks import hold_folder
from truepath.cli.command import run
from truepath.errors import BadInput
from truepath.jobs.dispatch import catalogue_rebuild as rebuilding
from truepath.operation.backup import check_name, make_backup, restore_backup
from truepath.settings import load_settings
from truepath.users.roles import Role


def list_bytes(folder):
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file() and file.name != ".lock"
    }


def test_what_was_kept_in_motion_comes_back_whole(backups, tmp_path, capsys):
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
    files = [f for f in sorted(copy.rglob("*")) if f.is_file() and f.stat().st_size]
    for file in files:
        whole = file.read_bytes()
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


def test_what_cannot_be_kept_or_restored_is_one_line(tmp_path, backups, capsys):
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
    simulated = {"simulated": True, "simulated_speed": 4.0}
    settings = load_settings(data_dir=tmp_path / "data", port=0, **simulated)
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


def test_a_backup_is_restored_to_postgresql(backups, postgres_server, tmp_path):
    name = postgres_server.make_database()
    url, target = postgres_server.url(name), tmp_path / "elsewhere"
    settings = load_settings(data_dir=target, database_url=url)
    kept = restore_backup(settings, backups.folder / "folder")
    with closing(Database(url)) as database:
        found = rebuilding.check_against_disk(database, target / "runs")
        assert (found["jobs"], found["rows_without_file"]) == (kept.rows["jobs"], [])
    other = load_settings(data_dir=tmp_path / "third", database_url=url)
    with pytest.raises(BadInput, match="not empty"):
        restore_backup(other, backups.folder / "folder")
    assert [one.name for one in (tmp_path / "third").iterdir()] == [".lock"]
    postgres_server.drop_database(name)


PASSWORD = "a password of the fixture"  # of .ci/make_data_folder.py
COLUMNS = "SELECT * FROM pragma_table_info(?)"
NEXT = '''
"""The next version."""
import sqlalchemy as sa
from alembic import op

revision, down_revision = "9999", "{head}"
branch_labels = depends_on = None


def upgrade() -> None:
    op.create_table("notes", sa.Column("id", sa.Integer, primary_key=True))
    with op.batch_alter_table("jobs") as jobs:
        jobs.add_column(sa.Column("remark", sa.String(10), nullable=True))
    op.execute("DELETE FROM events")
    {then}


def downgrade() -> None:
    raise NotImplementedError
'''


@pytest.fixture
def folder(tmp_path):
    return unpack(tmp_path / "data")


@pytest.fixture
def next_version(tmp_path, monkeypatch):
    """Let the code have one more migration, which ends as a test says."""

    def make(then="pass"):
        migrations = tmp_path / "migrations"
        shutil.copytree(database_module._MIGRATIONS, migrations)
        head = ScriptDirectory(str(migrations)).get_current_head()
        text = NEXT.format(head=head, then=then)
        (migrations / "versions" / "v9999_next.py").write_text(text)
        monkeypatch.setattr(database_module, "_MIGRATIONS", migrations)

    return make


def dump(file):
    with closing(sqlite3.connect(file)) as database:
        return list(database.iterdump())


def read_revision(file):
    with closing(sqlite3.connect(file)) as database:
        (revision,) = database.execute("SELECT version_num FROM alembic_version")
        return revision[0]


def require_all(folder):
    with service_of(load_settings(data_dir=folder, port=0)) as (service, client):
        items = client.get("/api/v1/jobs").json()["items"]
        jobs = {job["kind"]: job for job in items}
        ends = {"analyse": "succeeded", "measure-standstill": "aborted"}
        ends["plan"] = "failed"
        assert {kind: job["state"] for kind, job in jobs.items()} == ends
        assert jobs["plan"]["error"]["detail"] == "no time"
        result = client.get(jobs["analyse"]["result"]["result"]).json()
        assert result["schema"] == "result/1"
        tables = client.get(jobs["analyse"]["result"]["error_tables_json"]).json()
        assert "EXX" in tables["error_tables"]
        runs = client.get("/api/v1/runs").json()["items"]
        assert {run["origin"] for run in runs} == {"measured", "uploaded"}
        for run in runs:
            packed = client.get(f"/api/v1/runs/{run['id']}/bundle")
            assert packed.headers["content-type"] == "application/zip"
        assert client.get("/api/v1/users").json()["items"][0]["name"] == "ada"
        assert client.get("/api/v1/keys").json()["items"][0]["name"] == "gauge-7"
        audit = client.get("/api/v1/audit").json()["items"]
        assert {row["request_id"] for row in audit} >= {"r0", "r1", "r2"}
        token, actor = service.access.log_in("ada", PASSWORD, "127.0.0.1")
        assert token
        assert actor.role is Role.ADMINISTRATOR
        assert service.access.audit_log.verify() == []


def read_schema(file):
    """Tables with columns whatever their order, indexes and triggers."""
    with closing(sqlite3.connect(file)) as database:
        rows = database.execute("SELECT type, name, tbl_name, sql FROM sqlite_master")
        return {
            (kind, name): {row[1:] for row in database.execute(COLUMNS, [name])}
            if kind == "table"
            else (table, sql)
            for kind, name, table, sql in rows
        }


def test_a_new_catalogue_is_made_like_one_of_the_first_release(folder, tmp_path):
    """Else a table was changed without a migration."""
    new = tmp_path / "new.sqlite"
    with closing(Database(f"sqlite:///{new}")) as database:
        database.migrate()
    with closing(Database(f"sqlite:///{folder / 'catalogue.sqlite'}")) as database:
        database.migrate()
    assert read_schema(new) == read_schema(folder / "catalogue.sqlite")


def test_a_folder_of_an_older_schema_is_refused_and_left_as_it_is(tmp_path):
    old_folder = unpack(tmp_path / "old", "0009")
    before = list_bytes(old_folder)
    with pytest.raises(SchemaTooOld) as refusal:
        require_all(old_folder)
    file = old_folder / "catalogue.sqlite"
    assert str(refusal.value) == (
        f"{file} has schema 0009, older than 0014, the first that this version opens; "
        "it is left as it is. Open it once with the version of Truepath before this "
        "one, which brings it to 0014, then with this one"
    )
    # Nor is it made anew from what is on disk.
    folders = old_folder / "runs", old_folder / "results"
    with closing(Database(f"sqlite:///{file}")) as old, pytest.raises(SchemaTooOld):
        rebuilding.rebuild_catalogue(old, *folders)
    assert list_bytes(old_folder) == before


def test_schema_0014_is_migrated_and_restored_later(folder, next_version, tmp_path):
    require_all(folder)
    assert list(folder.glob("catalogue.before-*")) == []
    before = dump(folder / "catalogue.sqlite")
    make_backup(load_settings(data_dir=folder, port=0), tmp_path / "kept")
    next_version()
    require_all(folder)
    assert read_revision(folder / "catalogue.sqlite") == "9999"
    (copy,) = folder.glob("catalogue.before-0014-*.sqlite")
    assert dump(copy) == before
    target = tmp_path / "elsewhere"
    kept = restore_backup(load_settings(data_dir=target), tmp_path / "kept")
    assert kept.revision == "0014"
    assert read_revision(target / "catalogue.sqlite") == "9999"
    require_all(target)


def test_a_migration_that_fails_leaves_the_old_file(folder, next_version, monkeypatch):
    before = dump(folder / "catalogue.sqlite")
    own = database_module._MIGRATIONS
    next_version('raise RuntimeError("midway")')
    with pytest.raises(RuntimeError, match="midway"):
        require_all(folder)
    assert dump(folder / "catalogue.sqlite") == before
    assert read_revision(folder / "catalogue.sqlite") == "0014"
    monkeypatch.setattr(database_module, "_MIGRATIONS", own)
    require_all(folder)


def test_a_backup_of_an_older_schema_is_refused_and_nothing_changed(folder, tmp_path):
    make_backup(load_settings(data_dir=folder, port=0), tmp_path / "kept")
    manifest = tmp_path / "kept" / "manifest.json"
    text = manifest.read_text("utf-8").replace('"0014"', '"0009"')
    manifest.write_text(text, "utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    manifest.with_suffix(".sha256").write_text(digest, "ascii")
    before = list_bytes(folder)
    settings = load_settings(data_dir=folder)
    with pytest.raises(SchemaTooOld, match=r"the backup has schema 0009, older than"):
        restore_backup(settings, tmp_path / "kept", force=True)
    assert list_bytes(folder) == before
