"""The application over a scripted cell: no process, no device, real catalogue."""

import io
import json
import pickle
import shutil
import threading
import zipfile

import httpx2
import numpy as np
import pytest
from argon2 import PasswordHasher
from starlette.testclient import TestClient

import scripted_cell
from api_builders import add_calibration, arm_over_http
from serving import serving
from truepath.answers.calibration_report import render_analysis, write_analysis
from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.database import Database
from truepath.catalogue.machine_registry import MachineRegistry
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.compensation import residual_error
from truepath.files.bundle import commanded_file, machine_file
from truepath.jobs.dispatch.deletion import Deletion
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.running.active_job import EventBus
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.plan_requests import plan_measurement
from truepath.jobs.workers.reanalysis import store_outcome
from truepath.kinematics import volumetric_map
from truepath.machines import machine_cells
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import CellSetup, MachineCell, Machines
from truepath.machines.machine_setup import MachineSetup
from truepath.results.analysis import analyse
from truepath.service.api.application import create_application
from truepath.service.api.service import Service
from truepath.users import accounts as passwords
from truepath.users.access import Access, AccessRules
from truepath_drivers.interfaces import records
from truepath_simulators.machine_file import load_machine

LOOPBACK = "127.0.0.1"
QUICK = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)


@pytest.fixture(autouse=True)
def no_thread_is_left_over():
    before = set(threading.enumerate())
    yield
    # The client's portal and the loop's workers end with their client.
    left = {t.name for t in threading.enumerate() if t not in before and not t.daemon}
    assert not [name for name in left if name.startswith(("job-", "cell-"))]


@pytest.fixture
def explorer():
    """Finds backlash and, where a test gives it rows, asks for extra lines."""
    return scripted_cell.Explorer()


@pytest.fixture
def follower():
    return scripted_cell.Follower()


@pytest.fixture
def verifier():
    return scripted_cell.Verifier()


@pytest.fixture
def has_machine():
    """Whether the service drives a machine; overridden by tests without one."""
    return True


@pytest.fixture
def plan_orders():
    return []


@pytest.fixture
def planner(plan_orders):
    """Plans a few lines at once; overridden by tests of real plans."""
    rows = np.array([[10, 10, 10], [400, 300, 200], [100, 350, 50], [20, 20, 290.0]])
    path = records.Path(("X", "Y", "Z"), rows, np.full(4, 6000.0), np.full(4, 0.4))

    def plan(machine, order, *, on_progress):
        plan_orders.append(dict(order))
        on_progress(0.5, "planning")
        document = {"machine": machine_file.machine_to_json(machine)}
        made = commanded_file.encode_commanded_json(path)
        return {**made, "predicted_um": 1.0, "document": document}

    return plan


@pytest.fixture
def estimates():
    return scripted_cell.ScriptedLives()


@pytest.fixture
def board():
    """The conditions of the machine; overridden by tests that look at them."""
    return


@pytest.fixture
def reader():
    """Who reads what is uploaded; overridden where it is hostile."""
    return scripted_cell.ReaderHere()


@pytest.fixture
def tasks(science, explorer, follower, verifier, planner, estimates):
    found = {"follower": follower, "verifier": verifier, "planner": planner}
    return found | {"science": science, "discoverer": explorer, "live": estimates}


@pytest.fixture
def service(
    make_cell, board, tasks, has_machine, catalogue_url, tmp_path, reader, monkeypatch
):
    """Everything behind the routes; machines that are added have scripted cells too."""
    make_added = scripted_cell.CellMaker()
    monkeypatch.setattr(machine_cells, "Cell", lambda _: make_added())
    database = Database(catalogue_url)
    event_bus = EventBus()
    publish = event_bus.publish
    cell = CellSupervisor(make_cell, first_pause_s=0.02) if has_machine else None
    machine = machine_file.machine_from_json(load_machine("demo"))
    machines = Machines([MachineCell("default", machine, cell, board)] if cell else [])
    results = tmp_path / "results"
    results.mkdir()

    registry = MachineRegistry(database)
    context = JobContext(
        store=Store(database, publish),
        runs=RunCatalogue(database, tmp_path / "runs", reader),
        results=results,
        executor=scripted_cell.Inline(),
        machines=machines,
        registry=registry,
        read_loaded_files=lambda machine_id: setup.read_loaded_files(machine_id),
        **tasks,
    )
    dispatcher = Dispatcher(context, event_bus)
    if cell is not None:
        cell.start()
        scripted_cell.wait_until(lambda: cell.status.state == "disconnected")
    store, runs = context.store, context.runs
    calibrations = Calibrations(registry, store, runs, results, publish)
    cells = CellSetup(tmp_path, 0, calibrations)
    setup = MachineSetup(registry, store, cells, calibrations)
    setup.machines = machines
    for one in machines.list_all():
        content = machine_file.machine_to_json(one.machine)
        registry.record_configuration(one.id, "settings", content, {"simulated": True})
    access = Access(database, AccessRules())
    yield Service(
        version="1.2.3",
        simulated=True,
        database=database,
        store=store,
        runs=runs,
        results=results,
        dispatcher=dispatcher,
        event_bus=event_bus,
        machines=machines,
        setup=setup,
        calibrations=calibrations,
        deletion=Deletion(database, runs, results),
        access=access,
        max_upload_bytes=(2 << 20),
        max_streams=2,
    )
    dispatcher.close()
    if cell is not None:
        cell.close()
    access.close()
    database.close()


@pytest.fixture
def client(service):
    app = create_application(service, trusted_hosts=["shop-floor"])
    with TestClient(app, base_url=f"http://{LOOPBACK}:8411") as client:
        yield client


@pytest.fixture
def live(service):
    """A client of the same application over a real socket, for open streams."""
    with (
        serving(service) as (host, port),
        httpx2.Client(base_url=f"http://{host}:{port}", timeout=10.0) as client,
    ):
        yield client


@pytest.fixture
def until(client):
    def wait(job, *states):
        def reached():
            now = client.get(f"/api/v1/jobs/{job['id']}").json()
            return now if now["state"] in states else None

        return scripted_cell.wait_until(reached, f"{states}")

    return wait


@pytest.fixture
def access(service):
    access = Access(service.database, AccessRules(log_in_required=True))
    yield access
    access.close()


@pytest.fixture(autouse=True)
def quick_passwords(monkeypatch):
    """Passwords are hashed in no time: as they have to be it takes a while."""
    monkeypatch.setattr(passwords, "_hasher", QUICK)
    monkeypatch.setattr(passwords, "_NOBODY", QUICK.hash("of nobody"))


@pytest.fixture
def take(client, until):
    def taken(state="succeeded", **order):
        answer = client.post("/api/v1/jobs", json=order)
        assert answer.status_code == 202, answer.text
        return until(answer.json(), state)

    return taken


ROWS = [
    {"x_mm": 10, "y_mm": 10, "z_mm": 10},
    {"x_mm": 400, "y_mm": 300, "z_mm": 200, "feed_mm_min": 1000, "dwell_s": 0.5},
    {"x_mm": 100, "y_mm": 350, "z_mm": 50, "feed_mm_min": 1000, "dwell_s": 0.5},
]


@pytest.fixture
def order():
    return {"kind": "measure-otf", "path": [dict(row) for row in ROWS]}


@pytest.fixture
def ready(take, order):
    return take("ready", **order)


@pytest.fixture
def armed(client, ready, make_cell):
    answer = arm_over_http(client, ready)
    assert answer.status_code == 202, answer.text
    assert make_cell.cell.begun.wait(5)
    return answer.json()


@pytest.fixture
def finished(armed, make_cell, until):
    make_cell.cell.end()
    return until(armed, "succeeded")


@pytest.fixture(scope="session")
def analysed(record, make_once):
    def make(folder):
        recorded, _ = record(1, rows=24)
        write_analysis(render_analysis(analyse(recorded)), folder)

    return make_once("analysed-for-the-api", make)


@pytest.fixture
def with_result(service, finished, analysed):
    shutil.copytree(analysed, service.results / finished["id"], dirs_exist_ok=True)
    return finished["id"]


@pytest.fixture
def bundle():
    """A small measurement bundle, zipped; members can be replaced or left out."""

    def make(**members):
        path = "x_mm,y_mm,z_mm,feed_mm_min,dwell_s\n10,10,10,1000,1\n"
        samples = "".join(f"{n / 500:.3f},{n},0,0\n" for n in range(100))
        content = {
            "machine.json": json.dumps(load_machine("demo")),
            "path.csv": f"{path}400,300,200,1000,1\n",
            "tracker.csv": f"t_s,x_mm,y_mm,z_mm\n{samples}",
        }
        content |= {name.replace("_", "."): text for name, text in members.items()}
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in content.items():
                if text is not None:
                    archive.writestr(name, text)
        return packed.getvalue()

    return make


@pytest.fixture
def upload(client, bundle):
    def taken(name="mill.zip", **members):
        files = {"bundle": (name, bundle(**members))}
        answer = client.post("/api/v1/runs", files=files)
        assert answer.status_code == 201, answer.text
        return answer.json()

    return taken


@pytest.fixture
def run(upload):
    return upload()


@pytest.fixture
def is_problem():
    def check(answer, status, code):
        assert answer.status_code == status, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        content = answer.json()
        assert content["status"] == status
        assert content["code"] == code, content
        assert content["type"] == f"/problems/{code}"
        assert all(content[word] for word in ("title", "detail", "action"))
        assert content["instance"].startswith("/")
        assert content["request_id"] == answer.headers["x-request-id"]
        return content

    return check


SHORT = {"mode": "otf", "minutes": 0.5, "seed": 3}


@pytest.fixture(scope="session")
def short_plan(make_once):
    def make(folder):
        machine = machine_file.machine_from_json(load_machine("demo"))
        made = plan_measurement(machine, SHORT, on_progress=lambda *_: None)
        (folder / "plan").write_bytes(pickle.dumps(made))

    return pickle.loads((make_once("plan-for-the-api", make) / "plan").read_bytes())


@pytest.fixture(autouse=True)
def small_errors_add_up(monkeypatch):
    """Errors as small as here do; to see that takes longer than all the rest."""
    monkeypatch.setattr(volumetric_map, "is_nearly_linear", lambda *_: True)


@pytest.fixture
def few_places(monkeypatch):
    """Look in few places at what compensation files leave."""
    monkeypatch.setattr(residual_error, "CLOSE", 64)
    monkeypatch.setattr(residual_error.sample_travel, "__defaults__", (64,))


@pytest.fixture
def calibrated(service, analysed):
    """Two calibrations of the machine; the second has EXX as the first, and p95 30."""
    content = json.loads((analysed / "result.json").read_text())
    for number in (1, 2):
        job_id = add_calibration(service, number)
        digest = [{"name": job_id, "input_sha256": f"{number:064d}"}]
        content["provenance"]["runs"] = digest
        figure = {"value_um": 10.0 * (number + 1), "uncertainty_um": 0.5}
        content["volumetric_error"]["before"]["p95"] = figure
        (service.results / job_id / "result.json").write_text(json.dumps(content))
    return "job-1", "job-2"


@pytest.fixture
def reanalysed(service, upload):
    def analyse(order, perpendicular_only, *, on_progress):
        after = {"verdict": "usable", "volumetric_error_um": 5, "uncertainty_um": 1}
        store_outcome(order, after=after)
        folder = service.results / order.folder
        (folder / "result.json").write_text('{"schema": "result/1"}')

    object.__setattr__(service.dispatcher._context, "reanalyser", analyse)
    return [upload(f"run-{number}.zip")["id"] for number in range(2)]
