"""A catalogue in a file, on SQLite and on PostgreSQL where its programs are there."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.store import Store
from truepath.catalogue.transitions import State
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.event_bus import EventBus
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import MachineCell, Machines
from truepath_simulators.scenario import load_machine

sys.path.append(str(Path(__file__).parent))
from scripted_cell import CellMaker, Inline, Science, wait_until


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request, make_catalogue_url):
    """An empty catalogue of the newest schema, on either."""
    database = Database(make_catalogue_url(request.param))
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


@pytest.fixture(autouse=True, scope="module")
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


@pytest.fixture
def catalogue(catalogue_url):
    """An empty catalogue on the database of the whole session."""
    database = Database(catalogue_url)
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
def context(catalogue, event_bus, make_cell, science, machine, tmp_path, run_reader):
    """Everything a job works with; the cell is not started yet."""
    cell = CellSupervisor(make_cell, first_pause_s=0.02)
    results = tmp_path / "results"
    results.mkdir()
    yield JobContext(
        store=Store(catalogue, event_bus.publish),
        runs=RunCatalogue(catalogue, tmp_path / "runs", run_reader),
        results=results,
        executor=Inline(),
        science=science,
        machines=Machines([MachineCell("default", machine, cell)]),
        confirm_s={
            State.PAUSING: 0.3,
            State.RESUMING: 0.3,
            State.ABORTING: 0.3,
            State.CANCELLING: 30.0,
        },
    )
    cell.close()


@pytest.fixture
def dispatcher(context, event_bus):
    """Jobs can be given; the cell runs."""
    context.require_cell().start()
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
