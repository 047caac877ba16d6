"""A service over a scripted cell, its catalogue on either database."""

from dataclasses import replace

import pytest

import scripted_cell
from job_builders import OTF, arm_at_once, write_bundle_zip
from measurement_fixtures import no_thread_is_left_over  # noqa: F401
from simulated_clock import simulated_clock
from truepath.catalogue import database as databases
from truepath.catalogue.database import Database
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import FINAL, State
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.running.active_job import EventBus
from truepath.jobs.running.context import JobContext
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.conditions import ConditionLog
from truepath.machines.machine_cells import MachineCell, Machines
from truepath_simulators.machine_file import load_machine


@pytest.fixture
def database(catalogue_url):
    """An empty catalogue on the database of the whole session."""
    database = Database(catalogue_url)
    yield database
    database.close()


@pytest.fixture
def told():
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


@pytest.fixture
def clock(monkeypatch):
    """Let a test live on simulated time, on which SQLite waits for nobody by itself."""
    monkeypatch.setattr(databases, "_PRAGMAS", (*databases._PRAGMAS, "busy_timeout=0"))
    with simulated_clock() as clock:
        yield clock


@pytest.fixture
def machine():
    return machine_from_json(load_machine("demo"))


@pytest.fixture(scope="module")
def scheduler():
    """A real Dask scheduler with two workers, in threads of this process."""
    distributed = pytest.importorskip("distributed")
    how = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    how |= {"protocol": "tcp://", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(**how) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def make_cell():
    return scripted_cell.CellMaker()


@pytest.fixture
def science():
    return scripted_cell.Science()


@pytest.fixture
def context(
    database, event_bus, make_cell, science, machine, resumer, closer, tmp_path
):
    cell = CellSupervisor(make_cell, first_pause_s=0.02)
    cell.start()
    results = tmp_path / "results"
    results.mkdir()
    quick = (State.PAUSING, State.RESUMING, State.ABORTING)
    yield JobContext(
        store=Store(database, event_bus.publish),
        runs=RunCatalogue(database, tmp_path / "runs", scripted_cell.ReaderHere()),
        results=results,
        executor=scripted_cell.Inline(),
        science=science,
        resumer=resumer,
        closer=closer,
        machines=Machines([MachineCell("default", machine, cell)]),
        confirm_s={State.CANCELLING: 30.0, **dict.fromkeys(quick, 0.3)},
    )
    cell.close()


@pytest.fixture
def open_dispatcher(context, event_bus):
    opened = []

    def make(**parts):
        opened.append(Dispatcher(replace(context, **parts), event_bus))
        return opened[-1]

    yield make
    for dispatcher in opened:
        dispatcher.close()


@pytest.fixture
def dispatcher(open_dispatcher):
    return open_dispatcher()


@pytest.fixture
def open_watched(context, open_dispatcher):
    def make(observe, **parts):
        board = ConditionLog(observe)
        watched = replace(context.machines.get("default"), conditions=board)
        return open_dispatcher(machines=Machines([watched]), **parts)

    return make


@pytest.fixture
def until(context):
    def wait(job, *states):
        def reached():
            now = context.store.get(job.id)
            return now if now.state in (states or FINAL) else None

        return scripted_cell.wait_until(
            reached, f"{states}, is {context.store.get(job.id)}"
        )

    return wait


@pytest.fixture
def ready(dispatcher, until):
    return until(dispatcher.create(OTF)[0], "ready")


@pytest.fixture
def begin(dispatcher, until, make_cell):
    def begin(job, dispatcher=dispatcher):
        version = until(job, "ready").version
        make_cell.cell.begun.clear()
        armed = arm_at_once(dispatcher, job.id, version)
        assert make_cell.cell.begun.wait(25)
        return armed

    return begin


@pytest.fixture
def cell(dispatcher, make_cell):
    return make_cell.cell


@pytest.fixture
def end_in_motion(cell, until):
    def end(job):
        cell.fault()
        cell.end("faulted")
        return until(job, "faulted")

    return end


@pytest.fixture
def resumer():
    return scripted_cell.Resumer()


@pytest.fixture
def closer():
    return scripted_cell.Closer()


@pytest.fixture
def bundle(machine, tmp_path):
    sequence = (0, 1, 2, 3, 7, 8, 9, 10, 11, 12)
    return write_bundle_zip(machine, tmp_path / "bundle.zip", sequence)


@pytest.fixture
def run(context, bundle):
    return context.runs.add_uploaded(bundle, "from the shop floor")
