"""Tables as lines: what comes back is what was there, on either database."""

import json

import pytest
from sqlalchemy import select, text

from truepath.catalogue import schema
from truepath.catalogue.errors import SchemaTooNew
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.idempotency import IdempotencyKey
from truepath.catalogue.store.store import Store
from truepath.catalogue.table_transfer import import_tables, open_export
from truepath.errors import BadInput
from truepath.users.accounts import Accounts
from truepath.users.roles import Role


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
    job, _ = store.create(
        Job(JobKind.PLAN), IdempotencyKey("k", b"{}"), {"request": {"µm": 1.0}}
    )
    store.create(Job(JobKind.PLAN))
    odd = '{"b": 1.50, "a": [1e3, "\\u00b5"]}'
    value = ":odd" if database.engine.dialect.name == "sqlite" else "CAST(:odd AS JSON)"
    with database.engine.begin() as connection:
        query = text(f"UPDATE jobs SET plan = {value} WHERE id = :id")
        connection.execute(query, {"odd": odd, "id": job.id})
        connection.execute(text("UPDATE jobs SET failure = NULL"))
    Accounts(database).add("ada", Role.OPERATOR, "a long enough password")
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
    assert len(before["jobs"]) == 2
    assert len(before["users"]) == 1
    assert json.loads(before["jobs"][0])["plan"] == '{"b": 1.50, "a": [1e3, "\\u00b5"]}'
    with pytest.raises(SchemaTooNew):
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
def test_the_export_is_one_view_whoever_writes_meanwhile(filled):
    with open_export(filled) as export:
        assert len(list(export.read("jobs"))) == 2
        Store(filled, lambda _: None).create(Job(JobKind.PLAN))
        assert len(list(export.read("jobs"))) == 2
        assert len(list(export.read("events"))) == 2


@pytest.mark.database
def test_a_catalogue_that_is_not_empty_is_left_alone(filled):
    before = read_all(filled)
    with pytest.raises(BadInput, match="not empty"):
        import_tables(filled, "v0009", before)
    assert read_all(filled) == before
