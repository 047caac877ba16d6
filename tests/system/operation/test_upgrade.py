"""A data folder of today, opened by this version and the next; an older one refused."""

import hashlib
import shutil
import sqlite3
from contextlib import closing

import pytest
from alembic.script import ScriptDirectory
from tests.system.operation.conftest import unpack

from real_services import service_of
from truepath.catalogue.errors import SchemaTooOld
from truepath.catalogue.store import database as database_module
from truepath.catalogue.store.database import Database
from truepath.jobs.dispatch.catalogue_rebuild import rebuild_catalogue
from truepath.operation.backup import make_backup, restore_backup
from truepath.settings import load_settings
from truepath.users.roles import Role

PASSWORD = "a password of the fixture"  # of make_data_folder.py
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
    """Read everything that the folder holds over REST."""
    with service_of(load_settings(data_dir=folder, port=0)) as (service, client):
        items = client.get("/api/v1/jobs").json()["items"]
        jobs = {job["kind"]: job for job in items}
        ends = {
            "analyse": "succeeded",
            "measure-standstill": "aborted",
            "plan": "failed",
        }
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


def read_files(folder):
    files = [f for f in folder.rglob("*") if f.is_file() and f.name != ".lock"]
    return {str(file): file.read_bytes() for file in files}


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
    before = read_files(old_folder)
    with pytest.raises(SchemaTooOld) as refusal:
        require_all(old_folder)
    file = old_folder / "catalogue.sqlite"
    assert str(refusal.value) == (
        f"{file} has schema 0009, older than 0014, the first that this version opens; "
        "it is left as it is. Open it once with the version of Truepath before this "
        "one, which brings it to 0014, then with this one"
    )
    # Nor is it made anew from what is on disk.
    with (
        closing(Database(f"sqlite:///{file}")) as database,
        pytest.raises(SchemaTooOld),
    ):
        rebuild_catalogue(database, old_folder / "runs", old_folder / "results")
    assert read_files(old_folder) == before


def test_schema_0014_is_read_by_this_version_and_migrated_by_the_next_with_a_copy(
    folder, next_version
):
    require_all(folder)
    assert list(folder.glob("catalogue.before-*")) == []
    before = dump(folder / "catalogue.sqlite")
    next_version()
    require_all(folder)
    assert read_revision(folder / "catalogue.sqlite") == "9999"
    (copy,) = folder.glob("catalogue.before-0014-*.sqlite")
    assert dump(copy) == before


def test_a_migration_that_fails_midway_leaves_the_old_file_as_it_was(
    folder, next_version, monkeypatch
):
    before = dump(folder / "catalogue.sqlite")
    own = database_module._MIGRATIONS
    next_version('raise RuntimeError("midway")')
    with pytest.raises(RuntimeError, match="midway"):
        require_all(folder)
    assert dump(folder / "catalogue.sqlite") == before
    assert read_revision(folder / "catalogue.sqlite") == "0014"
    monkeypatch.setattr(database_module, "_MIGRATIONS", own)
    require_all(folder)


def test_a_backup_of_schema_0014_is_restored_by_the_next_version(
    folder, next_version, tmp_path
):
    make_backup(load_settings(data_dir=folder, port=0), tmp_path / "kept")
    next_version()
    target = tmp_path / "elsewhere"
    kept = restore_backup(load_settings(data_dir=target), tmp_path / "kept")
    assert kept.revision == "0014"
    assert read_revision(target / "catalogue.sqlite") == "9999"
    require_all(target)


def test_a_backup_of_an_older_schema_is_refused_and_nothing_changed(folder, tmp_path):
    make_backup(load_settings(data_dir=folder, port=0), tmp_path / "kept")
    manifest = tmp_path / "kept" / "manifest.json"
    text = manifest.read_text("utf-8").replace('"0014"', '"0009"')
    manifest.write_text(text, "utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    manifest.with_suffix(".sha256").write_text(digest, "ascii")
    before = read_files(folder)
    settings = load_settings(data_dir=folder)
    with pytest.raises(SchemaTooOld, match=r"the backup has schema 0009, older than"):
        restore_backup(settings, tmp_path / "kept", force=True)
    assert read_files(folder) == before
