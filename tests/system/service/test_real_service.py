"""The whole service: real processes, simulated devices on real links."""

import json
import os
import signal
import sqlite3
import time
from contextlib import closing

import psutil
import pytest

import service_process
from api_builders import edited
from described_answers import check_answer
from processes import runs
from real_services import process, service_of, write_machine
from scripted_cell import wait_until
from service_process import ROWS, SPEED, arm, begin_moving, create, follow
from serving import end_while_it_starts, hang_at_the_end
from truepath.catalogue.errors import InUse
from truepath.errors import BadInput
from truepath.main import open_service
from truepath.measurement.run_file.run_loader import open_run
from truepath.settings import load_settings

LONG = 3 * ROWS  # ten seconds
FROZEN_S = 4.0
ONE_EACH = ("feed_mm_min", "dwell_s")


@pytest.fixture
def settings(tmp_path):
    simulated = {"simulated": True, "simulated_speed": SPEED}
    return load_settings(data_dir=tmp_path / "data", port=0, **simulated)


@pytest.mark.timeout(240)  # ten seconds, but three programs beside it make a minute
def test_the_main_job_from_the_wire_to_the_error_tables(settings, tmp_path):
    """The tracker is silent for a while: that costs its samples and asks for nobody."""
    with edited(write_machine(tmp_path / "machine.json")) as content:
        content["name"] = "mine"
        for axis in content["axes"].values():  # half of it: less to compute
            axis["max_mm"] /= 2
    rows = [{k: v if k in ONE_EACH else v / 2 for k, v in row.items()} for row in ROWS]
    # Back a tenth of a second after the hold: the machine may brake still.
    fault = f"tracker:silence@12s+{0.6 * SPEED}s"
    changes = {"simulated_faults": (fault,), "machine_file": tmp_path / "machine.json"}
    with service_of(settings.model_copy(update=changes)) as (service, client):
        assert service.machines.first.machine.name == "mine"
        # The answers of each path are checked once in a while.
        checked_s: dict[str, float] = {}

        def check(response):
            path, now_s = response.request.url.path, time.monotonic()
            if now_s > checked_s.get(path, 0.0) + 0.3:
                check_answer(response)
                checked_s[path] = now_s

        client.event_hooks["response"].append(check)
        connected = client.post("/api/v1/machines/current:connect").json()
        assert connected["tracker"]["model"] == "Simulated tracker"
        job = create(client, path=rows)
        arm(client, job)
        job = follow(client, job["id"], "succeeded")
        assert job["health"]["samples"] > 1000
        assert job["health"]["crc_errors"] == 0
        assert job["health"]["lost_samples"] == pytest.approx(0.6 * SPEED * 100, 0.1)
        assert job["desired_state"] == "running"
        result = client.get(job["result"]["result"]).json()
        assert result["schema"] == "result/1"
        assert {"EXX", "EYY", "EZZ"} <= set(result["error_tables"])
        client.get(job["result"]["error_tables_json"])
        client.get("/api/v1/system")
        client.get("/api/v1/machines/current")
        assert "EXX" in client.get(job["result"]["error_tables_csv"]).text
        assert "</html>" in client.get(job["result"]["report_html"]).text

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


@pytest.mark.fault_row(30)
def test_a_frozen_service_leaves_a_machine_that_stands(tmp_path):
    """Nobody could stop it meanwhile; it goes on only when somebody says so."""
    with process(tmp_path) as (running, client):
        job = begin_moving(client, LONG)
        os.kill(running.pid, signal.SIGSTOP)
        frozen_s = time.monotonic()
        try:
            time.sleep(FROZEN_S)  # so long it stands still
        finally:
            os.kill(running.pid, signal.SIGCONT)
        paused = follow(client, job, "paused")
        assert "service has stood still" in json.dumps(paused)
        client.post("/api/v1/stop")
        run_id = follow(client, job, "aborted")["run_id"]
    axes = open_run(tmp_path / "data" / "runs" / f"{run_id}.sqlite").axis_samples
    time_s = axes.host_time_s
    is_meanwhile = (time_s > frozen_s + 3.0) & (time_s < frozen_s + FROZEN_S)
    meanwhile = axes.position_mm[is_meanwhile]
    assert len(meanwhile) > 3
    assert (meanwhile == meanwhile[0]).all()


@pytest.mark.parametrize(
    "how", ["terminated", pytest.param("Ctrl+C", marks=pytest.mark.long)]
)
@pytest.mark.fault_row(40)
def test_the_end_in_motion_stops_the_machine_first_in_time(tmp_path, how, measured):
    with process(tmp_path) as (running, client):
        begin_moving(client, LONG)
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
    with closing(sqlite3.connect(tmp_path / "data" / "catalogue.sqlite")) as kept:
        assert kept.execute("SELECT state FROM jobs").fetchall() == [("interrupted",)]
    said = [json.loads(x) for x in (tmp_path / "service.log").read_text().splitlines()]
    events = [line["event"] for line in said]
    assert events.index("ending: motion first") < events.index("job ended")
    assert events[-1] == "service ended"


def test_an_end_that_comes_while_it_starts_is_not_lost(tmp_path):
    process = service_process.process(tmp_path, prepare=end_while_it_starts)
    with process as (running, _):
        assert running.wait(40) == 0


def test_an_end_that_hangs_is_forced_and_says_where_it_stood(tmp_path):
    process = service_process.process(tmp_path, prepare=hang_at_the_end)
    with process as (running, client):
        client.get("/api/v1/system")  # it has begun to answer
        children = _children(running.pid)
        running.send_signal(signal.SIGTERM)
        assert running.wait(40) == 1
        wait_until(lambda: not any(map(runs, children)), "their end")
    assert "<lambda>" in (tmp_path / "service.log").read_text()


@pytest.mark.fault_row(25)
def test_after_a_killed_service_nothing_moves_and_the_run_is_there(tmp_path, measured):
    with process(tmp_path) as (running, client):
        job = begin_moving(client, LONG)
        children = _children(running.pid)
        assert len(children) >= 4
        running.kill()
        running.wait(10)
    wait_until(lambda: not any(map(runs, children)), "their end")
    with process(tmp_path, TRUEPATH_SIMULATED="0") as (_, client):
        found = client.get(f"/api/v1/jobs/{job}").json()
        assert found["state"] == "interrupted"
        assert found["error"]["code"] == "interrupted"
        run = client.get(found["links"]["run"]).json()
        assert run["samples"] > 500
        system = client.get("/api/v1/system").json()
        assert system["current_job"] is None
        assert system["cell"]["connected"] is False
    measured(f"killed in motion: {run['samples']} samples kept, no device opened again")


def test_a_service_that_cannot_be_as_it_is_set_says_why(settings, tmp_path):
    plain = settings.model_copy(update={"simulated": False})
    with open_service(plain), pytest.raises(InUse, match="another instance works on"):
        open_service(plain).__enter__()
    (tmp_path / "file").write_text("in the way")
    for change, said in (
        ({"data_dir": tmp_path / "file"}, "setting data_dir"),
        ({"data_dir": tmp_path / "file" / "below"}, "setting data_dir"),
        ({"simulated_faults": ("earthquake",)}, "simulated devices: .*earthquake"),
    ):
        wrong = settings.model_copy(update=change)
        with pytest.raises(BadInput, match=said), open_service(wrong):
            pass


def _children(process_id):
    return [p.pid for p in psutil.Process(process_id).children(recursive=True)]
