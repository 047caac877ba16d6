"""The whole service: real processes, simulated devices on real links."""

from __future__ import annotations

import json
import os
import signal
import socket
import sqlite3
import threading
import time

import httpx2
import psutil
import pytest
from described_answers import check_answer
from scripted_cell import wait_until
from service_process import ROWS, SPEED, arm, create, follow, moving, process
from starlette.testclient import TestClient

from truepath.catalogue.errors import InUse, SchemaTooNew
from truepath.errors import BadInput
from truepath.main import open_service, serve
from truepath.measurement.run_file.run_reading import open_run
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath_simulators.scenario import load_machine


@pytest.fixture
def settings(tmp_path):
    return load_settings(
        data_dir=tmp_path / "data",
        simulated=True,
        simulated_speed=SPEED,
        port=0,
    )


def resumed(client, job_id):
    """Press Resume where the job stands, again where it was refused; tell if it runs.

    On a busy computer the stream may be silent at that very moment.
    """
    job = client.get(f"/api/v1/jobs/{job_id}").json()
    if job["state"] == "paused":
        version = {"If-Match": f'"{job["version"]}"'}
        client.post(f"/api/v1/jobs/{job_id}/resume", headers=version)
    return job["state"] == "running"


def kept_state(tmp_path, job_id):
    """Return the state that the catalogue of a service that has ended holds."""
    with sqlite3.connect(tmp_path / "data" / "catalogue.sqlite") as catalogue:
        found = catalogue.execute("SELECT state FROM jobs WHERE id = ?", (job_id,))
        (state,) = found.fetchone()
    catalogue.close()
    return state


@pytest.mark.timeout(240)  # ten seconds, but three programs beside it make a minute
def test_the_main_job_from_the_wire_to_the_error_tables(settings):
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        client.event_hooks["response"].append(check_answer)  # each as it is described
        connected = client.post("/api/v1/machines/current:connect").json()
        assert connected["tracker"]["model"] == "Simulated tracker"
        job = create(client, path=ROWS)
        arm(client, job)
        job = follow(client, job["id"], "succeeded")
        assert job["health"]["samples"] > 5000
        assert job["health"]["crc_errors"] == 0
        result = client.get(job["result"]["result"]).json()
        assert result["schema"] == "result/1"
        assert {"EXX", "EYY", "EZZ"} <= set(result["error_tables"])
        client.get(job["result"]["error_tables_json"])
        client.get("/api/v1/system")
        client.get("/api/v1/machines/current")
        csv = client.get(job["result"]["error_tables_csv"]).text
        assert "EXX" in csv
        report = client.get(job["result"]["report_html"]).text
        assert "</html>" in report

        bundle = client.get(f"/api/v1/runs/{job['run_id']}/bundle").content
        run = client.post("/api/v1/runs", files={"bundle": ("r.zip", bundle)}).json()
        # What a loaded computer loses at this speed is counted, not hidden.
        for count in ("samples", "lost_samples"):
            assert run[count] == job["health"][count]
        order = {"kind": "analyse", "run_id": run["id"]}
        again = client.post("/api/v1/jobs", json=order).json()
        again = follow(client, again["id"], "succeeded")
        same = client.get(again["result"]["result"]).json()
        assert same["error_tables"]["EXX"] == result["error_tables"]["EXX"]


def test_a_short_silence_of_the_tracker_costs_its_samples_and_asks_for_nobody(
    settings,
):
    # Back a tenth of a second after the hold: the machine may brake still.
    fault = f"tracker:silence@12s+{0.6 * SPEED}s"
    silent = settings.model_copy(update={"simulated_faults": (fault,)})
    with (
        open_service(silent) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        job = create(client, path=ROWS)
        arm(client, job)
        job = follow(client, job["id"], "succeeded")
        assert job["health"]["lost_samples"] == pytest.approx(0.6 * SPEED * 500, 0.1)
        assert job["desired_state"] == "running"


def test_pause_resume_and_abort_reach_the_machine(settings):
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        job = create(client)
        arm(client, job)
        moving(client, job["id"])
        client.post(f"/api/v1/jobs/{job['id']}/pause")
        follow(client, job["id"], "paused")
        wait_until(lambda: resumed(client, job["id"]), "motion")
        begun = time.monotonic()
        client.post("/api/v1/stop")
        aborted = follow(client, job["id"], "aborted")
        assert time.monotonic() - begun < 5
        run = client.get(aborted["links"]["run"]).json()
        assert run["samples"] > 500
        assert not run["complete"]


@pytest.mark.fault_row(30)
@pytest.mark.parametrize("for_s", [4.0, pytest.param(10.0, marks=pytest.mark.long)])
def test_a_frozen_service_leaves_a_machine_that_stands(tmp_path, for_s):
    """Nobody could stop it meanwhile; it goes on only when somebody says so."""
    with process(tmp_path) as (running, client):
        job = create(client, path=ROWS)
        arm(client, job)
        moving(client, job["id"])
        os.kill(running.pid, signal.SIGSTOP)
        frozen_s = time.monotonic()
        try:
            time.sleep(for_s)  # so long it stands still
        finally:
            os.kill(running.pid, signal.SIGCONT)
        paused = follow(client, job["id"], "paused")
        assert "service has stood still" in json.dumps(paused)
        client.post("/api/v1/stop")
        follow(client, job["id"], "aborted")
    (file,) = (tmp_path / "data" / "runs").glob("*.sqlite")
    axes = open_run(file).axis_samples
    time_s = axes.host_time_s
    meanwhile = axes.position_mm[
        (time_s > frozen_s + 3.0) & (time_s < frozen_s + for_s)
    ]
    assert len(meanwhile) > 3
    assert (meanwhile == meanwhile[0]).all()


@pytest.mark.fault_row(23)
def test_a_killed_cell_leaves_a_run_and_the_next_one_takes_over(settings):
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        job = create(client)
        arm(client, job)
        moving(client, job["id"])
        (cell,) = [p for p in _children(os.getpid()) if _is_cell(p, settings)]
        os.kill(cell, signal.SIGKILL)
        faulted = follow(client, job["id"], "faulted")
        assert faulted["error"]["code"] == "cell-died"
        run = client.get(faulted["links"]["run"]).json()
        assert run["samples"] > 500
        assert not run["complete"]
        wait_until(lambda: client.get("/api/v1/system").json()["cell"]["restarts"] == 1)
        wait_until(
            lambda: client.post("/api/v1/machines/current:connect").status_code == 200
        )
        client.post(f"/api/v1/jobs/{create(client)['id']}/abort")


@pytest.mark.parametrize(
    "how", ["terminated", pytest.param("Ctrl+C", marks=pytest.mark.long)]
)
@pytest.mark.fault_row(40)
def test_the_end_in_motion_stops_the_machine_first_and_comes_in_time(
    tmp_path, how, measured
):
    with process(tmp_path) as (running, client):
        job = create(client)
        arm(client, job)
        moving(client, job["id"])
        with client.stream("GET", "/api/v1/events") as stream:
            lines = stream.iter_lines()
            next(lines)
            begun = time.monotonic()
            if how == "terminated":
                running.send_signal(signal.SIGTERM)
            else:  # a terminal tells every process
                os.killpg(running.pid, signal.SIGINT)
            for _ in lines:
                pass
        assert running.wait(40) == 0
        # It takes two seconds; a busy computer may need more, and nobody waits longer.
        took_s = time.monotonic() - begun
        assert took_s < 30
        measured(f"{how}: ended after {took_s:.1f} s")
    assert kept_state(tmp_path, job["id"]) == "interrupted"
    said = [json.loads(x) for x in (tmp_path / "service.log").read_text().splitlines()]
    events = [line["event"] for line in said]
    assert events.index("ending: motion first") < events.index("job ended")
    assert events[-1] == "service ended"


@pytest.mark.fault_row(25)
def test_after_a_killed_service_nothing_moves_and_the_run_is_there(tmp_path, measured):
    with process(tmp_path) as (running, client):
        job = create(client)
        arm(client, job)
        moving(client, job["id"])
        children = _children(running.pid)
        assert len(children) >= 4
        running.kill()
        running.wait(10)
    wait_until(lambda: not any(_is_alive(child) for child in children), "their end")
    with process(tmp_path, TRUEPATH_SIMULATED="0") as (_, client):
        found = client.get(f"/api/v1/jobs/{job['id']}").json()
        assert found["state"] == "interrupted"
        assert found["error"]["code"] == "interrupted"
        run = client.get(found["links"]["run"]).json()
        assert run["samples"] > 500
        system = client.get("/api/v1/system").json()
        assert system["current_job"] is None
        assert system["cell"]["connected"] is False
    measured(f"killed in motion: {run['samples']} samples kept, no device opened again")


def test_it_says_where_to_look_and_serves_page_and_documentation(tmp_path):
    with process(tmp_path, TRUEPATH_SIMULATED="0") as (_, client):
        assert "<html" in client.get("/").text
        assert "swagger" in client.get("/docs").text
        assert client.get("/static/js/api.js").status_code == 200
        system = client.get("/api/v1/system").json()
        assert system["machine"] is None
        ready = client.get("/readyz").json()
        assert ready["status"] == "ready"


def test_whoever_waits_for_the_service_is_told_its_address(settings):
    told: list[str] = []
    heard = threading.Event()

    def listening(address):
        told.append(httpx2.get(f"{address}/healthz").json()["status"])
        heard.set()
        os.kill(os.getpid(), signal.SIGINT)

    plain = settings.model_copy(update={"simulated": False})
    serve(plain, listening=listening)
    assert heard.is_set()
    assert told == ["ok"]


def test_a_second_instance_on_the_same_data_is_refused(settings):
    plain = settings.model_copy(update={"simulated": False})
    with (
        open_service(plain),
        pytest.raises(InUse, match="another instance works on"),
        open_service(plain),
    ):
        pass


def test_a_catalogue_of_a_newer_version_is_refused(settings):
    plain = settings.model_copy(update={"simulated": False})
    with open_service(plain) as service, service.database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(SchemaTooNew), open_service(plain):
        pass


def test_a_port_in_use_is_bad_input(settings):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        plain = settings.model_copy(update={"simulated": False, "port": port})
        with pytest.raises(BadInput, match=f"cannot listen on 127.0.0.1 port {port}"):
            serve(plain)


@pytest.mark.parametrize("place", ["file", "file/below"])
def test_a_data_folder_that_cannot_be_made_is_bad_input(settings, tmp_path, place):
    (tmp_path / "file").write_text("in the way")
    wrong = settings.model_copy(update={"data_dir": tmp_path / place})
    with pytest.raises(BadInput, match="setting data_dir"), open_service(wrong):
        pass


def test_a_machine_file_of_ones_own_is_simulated(settings, tmp_path):
    file = tmp_path / "machine.json"
    file.write_text(json.dumps({**load_machine("demo"), "name": "mine"}))
    own = settings.model_copy(update={"machine_file": file})
    with open_service(own) as service:
        assert service.machines.first.machine.name == "mine"


def test_a_fault_of_the_bench_that_nobody_knows_is_bad_input(settings):
    wrong = settings.model_copy(update={"simulated_faults": ("earthquake",)})
    with (
        pytest.raises(BadInput, match=r"simulated devices: .*earthquake"),
        open_service(wrong),
    ):
        pass


def test_a_hidden_effect_of_the_bench_that_nobody_knows_is_bad_input(settings):
    wrong = settings.model_copy(update={"simulated_hidden": ("poltergeist",)})
    with (
        pytest.raises(BadInput, match=r"simulated devices: .*poltergeist"),
        open_service(wrong),
    ):
        pass


def test_a_machine_of_iron_uses_the_drivers_of_the_settings(settings, tmp_path):
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    changes = {
        "simulated": False,
        "machine_file": file,
        "tracker_options": {"port": str(tmp_path / "no-such-port")},
        "motion_driver": "abacus",
    }
    iron = settings.model_copy(update=changes)
    with (
        open_service(iron) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        answer = client.post("/api/v1/machines/current:connect")
        assert answer.status_code == 409
        assert answer.json()["code"] == "device-settings"
        assert "abacus" in answer.json()["detail"]


def _children(process_id):
    """Return the identifiers of all processes below one."""
    return [p.pid for p in psutil.Process(process_id).children(recursive=True)]


def _is_cell(process_id, settings):
    """Tell the cell by what it has open: the Run that it records."""
    files = [f.path for f in psutil.Process(process_id).open_files()]
    return any(str(settings.data_dir / "runs") in name for name in files)


def _is_alive(process_id):
    try:
        return psutil.Process(process_id).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
