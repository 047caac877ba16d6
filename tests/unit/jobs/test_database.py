"""The catalogue: writes that wait, files that are damaged, tables as lines."""

import json
import os
import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import select, text
from sqlalchemy.event import listen
from sqlalchemy.exc import DBAPIError, OperationalError

from truepath.catalogue import database as databases
from truepath.catalogue import errors, schema
from truepath.catalogue.database import Database, check_catalogue
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.store import IdempotencyKey, Store
from truepath.catalogue.table_transfer import import_tables, open_export
from truepath.errors import BadInput
from truepath.users import audit, roles
from truepath.users.accounts import Accounts
from truepath_drivers import host_clock


@pytest.fixture
def sqlite_file(tmp_path, empty_catalogue):
    return Path(shutil.copyfile(empty_catalogue, tmp_path / "catalogue.sqlite"))


@pytest.fixture
def sqlite_database(sqlite_file):
    """A catalogue whose connections wait for nobody by themselves."""
    database = Database(f"sqlite:///{sqlite_file}", patience_s=0.3)
    listen(database.engine, "connect", lambda c, _: c.execute("PRAGMA busy_timeout=0"))
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
        assert compare_metadata(context, schema.metadata) == []


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
    newer = text("UPDATE alembic_version SET version_num='9999'")
    sqlite_database.write(lambda c: c.execute(newer))
    with pytest.raises(errors.SchemaTooNew, match="schema 9999, newer than this"):
        sqlite_database.migrate()


def test_a_write_waits_for_another_program(sqlite_database, lock, monkeypatch):
    waits = []

    def wait_s(duration_s):
        waits.append(duration_s)
        if len(waits) == 3:
            lock.execute("COMMIT")

    monkeypatch.setattr(host_clock, "sleep_s", wait_s)
    sqlite_database.write(lambda c: c.execute(text("DELETE FROM events")).rowcount)
    assert len(waits) == 3


@pytest.mark.fault_row(37)
def test_a_locked_catalogue_says_so(sqlite_database, lock, hand_clock, monkeypatch):
    def wait_s(duration_s):
        hand_clock.time_s += duration_s

    monkeypatch.setattr(host_clock, "sleep_s", wait_s)
    with pytest.raises(errors.StorageUnavailable, match=r"does not answer: .*locked"):
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
    with pytest.raises(errors.StorageUnavailable):
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
    with pytest.raises(errors.StorageFull, match=r"cannot be written: .*disk is full"):
        sqlite_database.write(refuse)
    assert len(tries) == 1


@pytest.mark.database
@pytest.mark.parametrize("verb", ["UPDATE audit SET who = 'ben'", "DELETE FROM audit"])
def test_a_row_of_the_audit_log_is_never_changed(database, verb):
    log = audit.AuditLog(database)
    for outcome in ("202", "403"):
        log.append(audit.Entry("anna", "operator", "", "", "POST /stop", outcome))
    refused = pytest.raises(DBAPIError, match="never changed")
    with refused, database.engine.begin() as connection:
        connection.execute(text(verb))
    assert log.verify() == []
    assert [row.entry.outcome for row in log.read()] == ["202", "403"]


@pytest.fixture
def file(sqlite_file):
    with closing(Database(f"sqlite:///{sqlite_file}")) as database:
        store = Store(database, lambda _: None)
        for _ in range(20):
            store.create(Job(JobKind.ANALYSE), plan={"long": "x" * 2000})
    return sqlite_file


def open_catalogue(file):
    with closing(Database(f"sqlite:///{file}")) as database:
        database.migrate()


def flip(file):
    content = bytearray(file.read_bytes())
    content[4096 * 3 : 4096 * 5] = b"\xa5" * 8192
    file.write_bytes(content)


def execute(file, query):
    with closing(sqlite3.connect(file)) as other:
        other.execute(query)
        other.commit()


def replace_by_folder(file):
    file.unlink()
    file.mkdir()
    (file / "kept").write_text("by somebody")


def replace_by_other(file):
    file.unlink()
    execute(file, "CREATE TABLE shopping (item TEXT)")


DROP = "ALTER TABLE jobs DROP COLUMN attempts"
DAMAGES = [
    (lambda file: file.write_bytes(b""), "is empty"),
    (lambda file: file.write_bytes(b"no database " * 99), "is not a SQLite file"),
    (lambda file: os.truncate(file, file.stat().st_size // 2), "is damaged"),
    (flip, "is damaged"),
    (replace_by_folder, "is a folder where the catalogue should be"),
    (lambda file: execute(file, DROP), "has no jobs.attempts although it is of schema"),
    (replace_by_other, "is a SQLite file of something else"),
]


def content_of(place):
    files = place.rglob("*") if place.is_dir() else [place]
    return {str(f): f.read_bytes() for f in files if f.is_file()}


@pytest.mark.parametrize(("damage", "said"), DAMAGES)
@pytest.mark.fault_row(37)
def test_a_damaged_catalogue_is_told_and_left_as_it_is(file, damage, said):
    damage(file)
    before = content_of(file.parent)
    with pytest.raises(errors.CatalogueDamaged, match=said) as told:
        open_catalogue(file)
    assert str(told.value).startswith(f"{file}: ")
    assert "truepath catalogue rebuild" in str(told.value)
    after = content_of(file.parent).items()
    assert {k: v for k, v in after if not k.endswith(("-wal", "-shm"))} == before


def test_a_catalogue_with_a_log_left_behind_is_in_order(file):
    """As a killed service leaves it."""
    with closing(sqlite3.connect(file)) as writer:
        writer.execute("UPDATE jobs SET version = 7")
        writer.commit()
        copy = file.with_name("copy.sqlite")
        for end in ("", "-wal"):
            shutil.copyfile(f"{file}{end}", f"{copy}{end}")
    database = Database(f"sqlite:///{copy}")
    database.migrate()
    with database.read() as connection:
        assert connection.execute(text("SELECT max(version) FROM jobs")).scalar() == 7
    database.close()


def test_a_catalogue_that_cannot_be_written_says_so(file):
    account = os.geteuid()
    with tempfile.TemporaryDirectory(prefix="catalogue") as public:
        Path(public).chmod(0o755)
        here = shutil.copyfile(file, Path(public) / "catalogue.sqlite")
        here.chmod(0o444)
        os.seteuid(account or 65534)  # an account without rights
        try:
            with pytest.raises(errors.CatalogueReadOnly, match=r"written .*; give its"):
                open_catalogue(here)
        finally:
            os.seteuid(account)


def test_a_catalogue_that_another_program_holds_is_not_called_damaged(file):
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("PRAGMA journal_mode=DELETE")
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(errors.StorageUnavailable, match="in use"):
            check_catalogue(file, "0001", patience_s=0.05)
        other.execute("ROLLBACK")


@pytest.mark.fault_row(37)
def test_a_catalogue_that_is_damaged_under_the_service_says_what_to_do(file):
    database = Database(f"sqlite:///{file}")
    store = Store(database, lambda _: None)
    content = file.read_bytes()
    file.write_bytes(content[:4096] + b"\xa5" * (len(content) - 4096))
    job = Job(JobKind.ANALYSE)
    for use in (lambda: store.list_page(99), lambda: store.create(job)):
        with pytest.raises(errors.StorageUnavailable, match="catalogue rebuild"):
            use()
    database.close()


def pytest_generate_tests(metafunc):
    """From and to SQLite, and the database of the session if that is another."""
    if "other_kind" in metafunc.fixturenames:
        kinds = sorted({"sqlite", metafunc.config.getoption("--database")})
        metafunc.parametrize("database_kind", kinds)
        metafunc.parametrize("other_kind", kinds)


def read_all(database):
    with open_export(database) as export:
        return {name: list(export.read(name)) for name in export.tables}


@pytest.fixture
def filled(database):
    """A catalogue with something in most tables; JSON that a parser would change."""
    store = Store(database, lambda _: None)
    plan = {"request": {"µm": 1.0}}
    job, _ = store.create(Job(JobKind.PLAN), IdempotencyKey("k", b"{}"), plan)
    store.create(Job(JobKind.PLAN))
    odd = '{"b": 1.50, "a": [1e3, "\\u00b5"]}'
    value = ":odd" if database.engine.dialect.name == "sqlite" else "CAST(:odd AS JSON)"
    with database.engine.begin() as connection:
        query = text(f"UPDATE jobs SET plan = {value} WHERE id = :id")
        connection.execute(query, {"odd": odd, "id": job.id})
        connection.execute(text("UPDATE jobs SET failure = NULL"))
    Accounts(database).add("ada", roles.Role.OPERATOR, "a long enough password")
    return database


@pytest.fixture
def other(request, other_kind, tmp_path):
    if other_kind == "sqlite":
        url = f"sqlite:///{tmp_path / 'other.sqlite'}"
    else:
        server = request.getfixturevalue("postgres_server")
        url = server.url(name := server.make_database())
    database = Database(url)
    yield database
    database.close()
    if other_kind == "postgresql":
        server.drop_database(name)


@pytest.mark.database
def test_what_comes_back_is_what_was_there_and_rows_are_counted_on(filled, other):
    before = read_all(filled)
    assert (len(before["jobs"]), len(before["users"])) == (2, 1)
    assert json.loads(before["jobs"][0])["plan"] == '{"b": 1.50, "a": [1e3, "\\u00b5"]}'
    with pytest.raises(errors.SchemaTooNew):
        import_tables(other, "v9999", {})
    with open_export(filled) as export:
        import_tables(other, export.revision, before)
    assert read_all(other) == before
    again, is_new = Store(other, lambda _: None).create(Job(JobKind.PLAN))
    assert (again.seq, is_new) == (3, True)
    with other.read() as connection:
        nulls = select(schema.jobs.c.id).where(schema.jobs.c.failure.is_(None))
        assert len(connection.execute(nulls).all()) >= 2, "NULL stays NULL"


@pytest.mark.database
def test_the_export_is_one_view_and_goes_to_an_empty_catalogue_alone(filled):
    before = read_all(filled)
    with pytest.raises(BadInput, match="not empty"):
        import_tables(filled, "v0009", before)
    assert read_all(filled) == before
    with open_export(filled) as export:
        assert len(list(export.read("jobs"))) == 2
        Store(filled, lambda _: None).create(Job(JobKind.PLAN))
        assert len(list(export.read("jobs"))) == 2
        assert len(list(export.read("events"))) == 2
