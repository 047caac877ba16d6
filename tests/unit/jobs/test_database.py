import shutil
import sqlite3
from pathlib import Path as FilePath

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import text
from sqlalchemy.event import listen
from sqlalchemy.exc import DBAPIError, OperationalError

from truepath.catalogue.errors import SchemaTooNew, StorageFull, StorageUnavailable
from truepath.catalogue.schema import metadata
from truepath.catalogue.store import database as databases
from truepath.catalogue.store.database import Database
from truepath.errors import BadInput
from truepath.users.audit import AuditLog, Entry
from truepath_drivers import host_clock


@pytest.fixture
def sqlite_file(tmp_path, empty_catalogue):
    return FilePath(shutil.copyfile(empty_catalogue, tmp_path / "catalogue.sqlite"))


@pytest.fixture
def sqlite_database(sqlite_file):
    """A catalogue whose connections wait for nobody by themselves."""
    database = Database(f"sqlite:///{sqlite_file}", patience_s=0.3)
    listen(
        database.engine, "connect", lambda raw, _: raw.execute("PRAGMA busy_timeout=0")
    )
    yield database
    database.close()


@pytest.fixture
def lock(sqlite_file):
    other = sqlite3.connect(sqlite_file, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    yield other
    other.close()


@pytest.mark.database
def test_migrations_make_the_tables_that_the_code_expects_however_often(database):
    database.migrate()
    assert database.ready()
    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, metadata) == []


def test_sqlite_is_set_for_safety_on_each_connection(sqlite_database):
    expected = {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}
    with sqlite_database.read() as one, sqlite_database.read() as two:
        for connection in (one, two):
            assert expected == {
                pragma: connection.execute(text(f"PRAGMA {pragma}")).scalar()
                for pragma in expected
            }


@pytest.mark.fault_row(37)
def test_a_newer_schema_is_refused(sqlite_database):
    sqlite_database.write(
        lambda c: c.execute(text("UPDATE alembic_version SET version_num='9999'"))
    )
    with pytest.raises(SchemaTooNew, match="schema 9999, newer than this version"):
        sqlite_database.migrate()


def test_a_write_waits_for_another_program_and_then_succeeds(
    sqlite_database, lock, monkeypatch
):
    waits = []

    def wait_s(duration_s):
        waits.append(duration_s)
        if len(waits) == 3:
            lock.execute("COMMIT")

    monkeypatch.setattr(host_clock, "sleep_s", wait_s)
    sqlite_database.write(lambda c: c.execute(text("DELETE FROM events")).rowcount)
    assert len(waits) == 3


@pytest.mark.fault_row(37)
def test_a_catalogue_locked_for_too_long_says_so(
    sqlite_database, lock, hand_clock, monkeypatch
):
    def wait_s(duration_s):
        hand_clock.time_s += duration_s

    monkeypatch.setattr(host_clock, "sleep_s", wait_s)
    with pytest.raises(StorageUnavailable, match=r"does not answer: .*locked"):
        sqlite_database.write(lambda c: c.execute(text("DELETE FROM events")))
    assert 0.3 < hand_clock.time_s < 0.6


@pytest.mark.database
def test_a_change_that_fails_leaves_nothing_behind(database):
    def half(connection):
        connection.execute(text("DELETE FROM alembic_version"))
        raise KeyError("half way")

    with pytest.raises(KeyError):
        database.write(half)
    with database.read() as connection:
        query = text("SELECT count(*) FROM alembic_version")
        assert connection.execute(query).scalar() == 1


@pytest.mark.parametrize("url", ["nonsense", "nosuchdatabase://here"])
def test_an_address_that_is_none_is_bad_input(url):
    with pytest.raises(BadInput, match="setting database_url"):
        Database(url)


@pytest.mark.fault_row(37)
def test_a_busy_catalogue_is_logged_once_in_a_while(sqlite_database, monkeypatch):
    lines, tries = [], []
    monkeypatch.setattr(databases.log, "warning", lambda *told, **_: lines.append(told))

    def refuse(_):
        tries.append(1)
        raise OperationalError("", {}, sqlite3.OperationalError("database is locked"))

    monkeypatch.setattr(host_clock, "sleep_s", lambda _: None)
    with pytest.raises(StorageUnavailable):
        sqlite_database.write(refuse)
    assert len(tries) > 20
    assert len(lines) == 1


@pytest.mark.fault_row(27)
def test_a_full_disk_is_told_at_once(sqlite_database):
    def refuse(_):
        tries.append(1)
        full = sqlite3.OperationalError("database or disk is full")
        raise OperationalError("", {}, full)

    tries = []
    with pytest.raises(StorageFull, match=r"cannot be written: .*disk is full"):
        sqlite_database.write(refuse)
    assert len(tries) == 1


@pytest.mark.database
@pytest.mark.parametrize("verb", ["UPDATE audit SET who = 'ben'", "DELETE FROM audit"])
def test_a_row_of_the_audit_log_is_never_changed(database, verb):
    log = AuditLog(database)
    for outcome in ("202", "403"):
        log.append(Entry("anna", "operator", "", "", "POST /stop", outcome))
    with (
        pytest.raises(DBAPIError, match="never changed"),
        database.engine.begin() as connection,
    ):
        connection.execute(text(verb))
    assert log.verify() == []
    assert [row.entry.outcome for row in log.read()] == ["202", "403"]
