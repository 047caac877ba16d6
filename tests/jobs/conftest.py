"""A catalogue in a file, on SQLite and on PostgreSQL where its programs are there."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from truepath.app.files.machine_file import machine_from_json
from truepath.app.jobs.cell_supervisor import CellSupervisor
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.database import Database
from truepath.app.jobs.dispatcher import Dispatcher
from truepath.app.jobs.event_bus import EventBus
from truepath.app.jobs.runs import RunCatalogue
from truepath.app.jobs.store import Store
from truepath.app.jobs.transitions import State
from truepath.simulators.scenario import load_machine

sys.path.append(str(Path(__file__).parent))
from scripted_cell import CellMaker, Inline, Science, wait_until


def _postgres_programs() -> dict[str, str] | None:
    found = {name: _program(name) for name in ("initdb", "pg_ctl")}
    return {k: v for k, v in found.items() if v} if all(found.values()) else None


def _program(name: str) -> str | None:
    places = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(places[-1]) if places else None)


def _unprivileged() -> str | None:
    """PostgreSQL refuses to run as root: name the account its package has made."""
    if os.geteuid() != 0:
        return None
    return pwd.getpwnam("postgres").pw_name


@pytest.fixture(scope="session")
def postgres_url():
    """Address of a PostgreSQL server on a socket of its own, gone at the end."""
    programs = _postgres_programs()
    if programs is None:
        pytest.skip("PostgreSQL is not installed")
    folder = Path(tempfile.mkdtemp(prefix="pg"))
    user = _unprivileged()
    if user:
        shutil.chown(folder, user)
    data = folder / "data"

    def run(*command):
        subprocess.run(
            command, check=True, user=user, cwd=folder, capture_output=True, timeout=60
        )

    try:
        run(programs["initdb"], "-D", data, "-A", "trust", "-U", "truepath", "-N")
        options = f"-k {folder} -c listen_addresses= -c fsync=off"
        log = folder / "log"
        run(programs["pg_ctl"], "-D", data, "-o", options, "-l", log, "-w", "start")
        try:
            yield f"postgresql+psycopg://truepath@/postgres?host={folder}"
        finally:
            run(programs["pg_ctl"], "-D", data, "-m", "immediate", "-w", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request, tmp_path):
    """An empty catalogue of the newest schema."""
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path / 'catalogue.sqlite'}"
    else:
        url = request.getfixturevalue("postgres_url")
    database = Database(url)
    if request.param == "postgresql":
        with database.engine.begin() as connection:
            connection.exec_driver_sql("DROP SCHEMA public CASCADE")
            connection.exec_driver_sql("CREATE SCHEMA public")
    database.migrate()
    yield database
    database.close()


@pytest.fixture
def told():
    """Every stored event that listeners were told of."""
    return []


@pytest.fixture
def store(database, told):
    return Store(database, told.append)


@pytest.fixture
def event_bus():
    return EventBus()


@pytest.fixture(autouse=True, scope="session")
def logged_plainly(plain_log):
    """The fancy traces of the default take seconds each."""


@pytest.fixture(autouse=True)
def no_thread_is_left_over():
    before = set(threading.enumerate())
    yield
    left = [t.name for t in threading.enumerate() if t not in before and not t.daemon]
    assert not left


@pytest.fixture
def machine():
    return machine_from_json(load_machine("demo"))


@pytest.fixture(scope="module")
def scheduler():
    """A real Dask scheduler with two workers, in threads of this process."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="session")
def empty_catalogue(tmp_path_factory):
    """A migrated catalogue to copy: migrating takes longer than most tests."""
    file = tmp_path_factory.mktemp("catalogue") / "catalogue.sqlite"
    database = Database(f"sqlite:///{file}")
    database.migrate()
    database.close()
    return file


@pytest.fixture
def sqlite_catalogue(empty_catalogue, tmp_path):
    shutil.copyfile(empty_catalogue, tmp_path / "catalogue.sqlite")
    database = Database(f"sqlite:///{tmp_path / 'catalogue.sqlite'}")
    yield database
    database.close()


@pytest.fixture
def make_cell():
    """Makes the cells of the service under test."""
    return CellMaker()


@pytest.fixture
def science():
    return Science()


@pytest.fixture
def context(
    sqlite_catalogue, event_bus, make_cell, science, machine, tmp_path, run_reader
):
    """Everything a job works with; the cell is not started yet."""
    cell = CellSupervisor(make_cell, first_pause_s=0.02)
    results = tmp_path / "results"
    results.mkdir()
    yield JobContext(
        store=Store(sqlite_catalogue, event_bus.publish),
        runs=RunCatalogue(sqlite_catalogue, tmp_path / "runs", run_reader),
        results=results,
        executor=Inline(),
        science=science,
        machine=machine,
        cell=cell,
        confirm_s={
            State.PAUSING: 0.3,
            State.RESUMING: 0.3,
            State.ABORTING: 0.3,
        },
    )
    cell.close()


@pytest.fixture
def dispatcher(context, event_bus):
    """Jobs can be given; the cell runs."""
    context.cell.start()
    dispatcher = Dispatcher(context, event_bus)
    yield dispatcher
    dispatcher.close()


@pytest.fixture
def until(context):
    """Wait until a job is in a state; return it."""

    def wait(job, *states):
        def reached():
            now = context.store.get(job.id)
            return now if now.state in states else None

        return wait_until(reached, f"{states}, is {context.store.get(job.id)}")

    return wait
