"""A PostgreSQL server that restarts, crashes or freezes under the catalogue."""

import threading
import time

import pytest

from postgres_server import PostgresServer
from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.store import Store

pytestmark = [pytest.mark.long]


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


@pytest.mark.fault_row(37)
@pytest.mark.parametrize("mode", ["fast", "immediate"])
def test_writers_go_on_after_a_restart_and_nothing_written_is_lost(server, store, mode):
    """Writes wait for the server; each that was confirmed stands once."""
    written: list[str] = []
    enough = threading.Event()

    def write() -> None:
        while not enough.is_set():
            written.append(store.create(Job(JobKind.ANALYSE))[0].id)

    writers = [threading.Thread(target=write) for _ in range(3)]
    for writer in writers:
        writer.start()
    _wait_for_more(written)
    server.stop(mode)
    server.start()
    _wait_for_more(written)
    enough.set()
    for writer in writers:
        writer.join(20)
        assert not writer.is_alive()
    kept = [job.id for job in store.list_page(100_000)]
    assert len(set(kept)) == len(kept)
    assert set(written) <= set(kept)


@pytest.mark.fault_row(37)
def test_a_frozen_server_is_unavailable_in_bounded_time(server, store):
    job, _ = store.create(Job(JobKind.ANALYSE))
    server.freeze()
    try:
        begun = time.monotonic()
        with pytest.raises(StorageUnavailable, match="does not answer"):
            store.get(job.id)
        assert time.monotonic() - begun < 10.0
    finally:
        server.thaw()
    assert store.get(job.id).id == job.id


def _wait_for_more(written: list[str]) -> None:
    goal, end = len(written) + 20, time.monotonic() + 30.0
    while len(written) < goal:
        assert time.monotonic() < end, f"{len(written)} written"
        time.sleep(0.01)
