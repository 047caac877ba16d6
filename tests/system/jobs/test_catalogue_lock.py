"""A catalogue in PostgreSQL: two services on it, a server that restarts or is away."""

import threading

import pytest
from sqlalchemy import text

from postgres_server import PostgresServer
from scripted_cell import wait_until
from truepath.catalogue.database import Database
from truepath.catalogue.errors import InUse, StorageUnavailable
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.locks import hold_catalogue
from truepath.catalogue.store import Store


@pytest.fixture
def make_database(postgres_server):
    opened, names = [], []

    def make(name=None):
        if name is None:
            name = postgres_server.make_database()
            names.append(name)
        opened.append(Database(postgres_server.url(name)))
        return name, opened[-1]

    yield make
    for database in opened:
        database.close()
    for name in names:
        postgres_server.drop_database(name)


def is_free(database):
    try:
        with hold_catalogue(database, patience_s=0.0):
            return True
    except InUse:
        return False


@pytest.mark.long
def test_a_second_service_is_refused_until_the_first_has_ended(make_database):
    name, first = make_database()
    _, second = make_database(name)
    _, elsewhere = make_database()
    with hold_catalogue(first):
        with pytest.raises(InUse, match=r"another instance .* database_url"):
            hold_catalogue(second, patience_s=0.0).__enter__()
        assert is_free(elsewhere), "another catalogue of the same server"
    wait_until(lambda: is_free(second), "the lock is free")
    # One that a restart of the server has lost is taken again.
    with hold_catalogue(first, look_every_s=0.1):
        before = find_holder(second)
        with second.engine.connect() as connection:
            others = "datname = current_database() AND pid <> pg_backend_pid()"
            ending = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE"
            connection.execute(text(f"{ending} {others}"))
        wait_until(lambda: find_holder(second) not in (None, before), "another")
        assert not is_free(second)


def find_holder(database):
    query = (
        "SELECT pid FROM pg_locks JOIN pg_database d ON d.oid = database "
        "WHERE locktype = 'advisory' AND granted AND datname = current_database()"
    )
    with database.engine.connect() as connection:
        return connection.execute(text(query)).scalar()


def test_a_server_that_is_away_is_unavailable(tmp_path):
    url = f"postgresql+psycopg://truepath@/postgres?host={tmp_path}"
    database = Database(url, patience_s=0.1)
    assert not database.ready()
    with pytest.raises(StorageUnavailable, match="does not answer"):
        database.migrate()
    database.close()


@pytest.fixture(scope="module")
def server():
    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture
def store(server):
    database = Database(server.url(server.make_database()))
    database.migrate()
    yield Store(database, lambda _: None)
    database.close()


@pytest.mark.long
@pytest.mark.fault_row(37)
@pytest.mark.parametrize("mode", ["fast", "immediate"])
def test_writers_go_on_after_a_restart_and_nothing_written_is_lost(server, store, mode):
    written, enough = [], threading.Event()

    def write():
        while not enough.is_set():
            written.append(store.create(Job(JobKind.ANALYSE))[0].id)

    writers = [threading.Thread(target=write) for _ in range(3)]
    for writer in writers:
        writer.start()
    wait_until(lambda: len(written) >= 20, "writes")
    server.stop(mode)
    server.start()
    goal = len(written) + 20
    wait_until(lambda: len(written) >= goal, "more writes")
    enough.set()
    for writer in writers:
        writer.join(20)
        assert not writer.is_alive()
    kept = [job.id for job in store.list_page(100_000)]
    assert len(set(kept)) == len(kept)
    assert set(written) <= set(kept)
