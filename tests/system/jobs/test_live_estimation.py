"""Real services that measure: tables in time and planned by, two machines at once."""

import json
import os
import signal
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from api_builders import rows_at
from job_builders import OTF, arm_at_once
from scripted_cell import wait_until
from truepath.catalogue.errors import StaleVersion
from truepath.catalogue.job import JobKind
from truepath.cli.demo import compare_with_truth
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.running import live_estimation, live_process
from truepath.main import open_service
from truepath.measurement.run_file.run_loader import open_run
from truepath.motion.workspace import check_travel
from truepath.settings import load_settings
from truepath_simulators.bench.bench import Bench
from truepath_simulators.machine_file import load_machine
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture
def run(record):
    return record(31, rows=18, setting=Setting(rate_hz=100.0))[0]


@pytest.fixture
def shown():
    return []


@pytest.fixture
def live(run, shown):
    order = live_process.LiveEstimateOrder(run.machine, run.commanded)
    live = live_estimation.LiveEstimation(order, shown.append)
    yield live
    live.close()
    live.close()


def feed(live, run, until=lambda: False):
    for begin in range(0, len(run.tracker), 200):
        wait_until(lambda: live._queue.qsize() < live_estimation.WAITING_BLOCKS)
        live.offer(run.tracker.select(slice(begin, begin + 200)))
        if until():
            return


def test_a_stream_becomes_tables_and_ends_with_the_last(run, live, shown):
    live.start()
    feed(live, run)
    wait_until(lambda: shown)  # its process has started
    live.finish()
    last = shown[-1]
    assert last["is_last"]
    assert last["done"] == last["total"] == len(run.commanded) - 1
    assert live.dropped_blocks == last["dropped_blocks"] == 0
    assert last["volumetric_uncertainty_um"] < 3.0
    assert live.newest is not None
    assert last == {**live.newest, "age_s": last["age_s"], "dropped_blocks": 0}
    table = last["error_tables"]["EXX"]
    assert set(table) == {"position_mm", "value_um", "uncertainty_um"}
    assert len({len(column) for column in table.values()}) == 1
    assert set(last["squareness_urad"]) == {"C0Y", "B0Z", "A0Z"}
    # Rows about the newest line are told where the tracker sees them.
    rows = len(run.commanded)
    for told in shown:
        first, places = told["commanded"]["first_row"], told["commanded"]["tracker_mm"]
        assert first <= told["done"] < first + len(places) <= rows
        assert len(places) <= 13
    assert first + len(places) == rows
    assert np.allclose(places[-1], run.tracker.position_mm[-1], atol=0.05)


def test_an_estimate_is_told_with_its_age_until_its_process_dies(run, live, shown):
    """Whatever the process does: here it is stopped in the middle of its work."""
    live.start()
    feed(live, run, until=lambda: shown)
    wait_until(lambda: shown)
    os.kill(live._process.process_id, signal.SIGSTOP)
    wait_until(lambda: shown[-1]["age_s"] > 1.0)
    told = [body for body in shown if body["done"] == shown[-1]["done"]]
    ages = [body["age_s"] for body in told]
    assert ages == sorted(ages)
    assert len(told) >= 1.0 / (2 * live_estimation.PERIOD_S)
    assert len({body["volumetric_uncertainty_um"] for body in told}) == 1
    live._process.kill()
    live.finish()
    count = len(shown)
    time.sleep(3 * live_estimation.PERIOD_S)  # silence can only be waited for
    assert len(shown) == count
    assert not shown[-1]["is_last"]


def links_to(bench, folder):
    file = folder / "machine.json"
    file.write_text(json.dumps(bench.machine), encoding="utf-8")
    options = bench.tracker_options, bench.motion_options
    names = ("tracker_options", "motion_options")
    return {"machine_file": file, **dict(zip(names, options, strict=True))}


@contextmanager
def measured(request, folder, **chosen):
    """Measure to the end with the whole service, which is up meanwhile.

    Yield it, the job, its plan before motion, and what it told of each kind and when.
    An operator lets go on whatever is held.
    """
    heard = {"estimate": [], "plan": []}
    settings = load_settings(data_dir=folder / "data", port=0, **chosen)
    with open_service(settings) as service:
        service.event_bus.subscribe(
            lambda n: heard.setdefault(n.type, []).append((time.monotonic(), n.body))
        )
        cell, get = service.machines.first.cell, service.store.get
        wait_until(lambda: cell.status.state == "disconnected", "the cell")
        job, _ = service.dispatcher.create(request)
        wait_until(lambda: get(job.id).state == "ready", "the plan")
        first = service.store.read_plan(job.id)
        arm_at_once(service.dispatcher, job.id, get(job.id).version)

        def has_ended():
            now = get(job.id)
            if now.state == "paused":
                with suppress(StaleVersion):
                    service.dispatcher.resume(job.id, now.version)
            return now.is_final

        wait_until(has_ended, "the end")
        job = get(job.id)
        assert job.state == "succeeded", job.failure
        yield SimpleNamespace(service=service, job=job, first=first, heard=heard)


def read_result(done):
    file = done.service.results / done.job.id / "result.json"
    return json.loads(file.read_text(encoding="utf-8"))


@pytest.mark.long
@pytest.mark.timeout(120)
def test_tables_tighten_live_and_end_at_the_result(tmp_path):
    request = RequestedJob(JobKind.MEASURE_OTF, feed_mm_min=8000.0)
    faster = {"simulated": True, "simulated_speed": 8.0}
    with measured(request, tmp_path, **faster) as done:
        last = done.service.event_bus.estimates.newest(done.job.id)
        result, heard = read_result(done), done.heard["estimate"]
    sigma = [body["volumetric_uncertainty_um"] for _, body in heard]
    assert len(set(sigma)) >= 3
    assert sigma[0] > 1.2 * sigma[-1]  # a busy computer may miss the first lines
    gaps = np.diff([moment for moment, _ in heard])
    assert np.quantile(gaps, 0.95) <= 0.5  # whatever else the computer does
    assert (np.diff([body["elapsed_s"] for _, body in heard]) >= 0).all()
    assert last["is_last"]
    off = []
    for symbol, table in last["error_tables"].items():
        final = result["error_tables"][symbol]
        value = next(key for key in final if key.startswith("value"))
        u = np.array(final[value.replace("value", "uncertainty")])
        away = np.array(table[value]) - np.array(final[value])
        off.append(away / np.maximum(u, 0.05))
    # The final look knows more of the noise; both lie within one standard uncertainty.
    assert np.sqrt(np.mean(np.concatenate(off) ** 2)) < 1.0


@pytest.mark.long
@pytest.mark.timeout(240)
def test_polled_points_tighten_live_and_end_the_job_at_its_target(tmp_path):
    content = load_machine("demo")
    content["tracker"]["rate_hz"] = 2.0
    request = RequestedJob(JobKind.MEASURE_STANDSTILL, target_um=25.0)
    with Bench(content, 7, 20.0, protocol="geocom", tracker="tcp") as bench:
        links = links_to(bench, tmp_path)
        with measured(request, tmp_path, tracker_driver="geocom", **links) as done:
            job, heard = done.job, done.heard["estimate"]
    sigma = [body["volumetric_uncertainty_um"] for _, body in heard]
    assert len(set(sigma)) >= 5
    assert sigma[0] > sigma[-1]
    assert job.early_end is not None
    assert job.early_end.reached_um <= 25.0
    assert job.early_end.done < job.early_end.total


BUDGET_MIN = 10.0


@contextmanager
def adapted(folder, mode, target_um, faults=()):
    """Measure on a bench, planned on the way; yield it, the Run and its parts, too."""
    asked = {"plan_request": {"mode": mode, "minutes": BUDGET_MIN}}
    request = RequestedJob(JobKind.MEASURE_ADAPTIVE, target_um=target_um, **asked)
    with (
        Bench(seed=1, speed=10.0, faults=faults) as bench,
        measured(request, folder, **links_to(bench, folder)) as done,
    ):
        assert done.job.early_end.reached_um <= target_um
        parts = [body for _, body in done.heard["plan"]]
        assert parts
        yield bench, done, open_run(done.service.runs.file(done.job.id)), parts


@pytest.mark.long
@pytest.mark.timeout(120)
def test_lines_lost_with_the_beam_are_planned_anew_until_the_target(tmp_path):
    lost = ("tracker:beam-break@17s+8s",)
    with adapted(tmp_path, "otf", 0.5, lost) as (bench, done, run, parts):
        found = compare_with_truth(read_result(done), bench.truth_at)
        assert done.service.runs.get(done.job.id).complete
    rows = len(done.first["position"]) + sum(part["rows"] for part in parts)
    assert len(run.commanded) == rows
    assert "beam-lost" in {event.kind for event in run.events}
    assert done.job.early_end.done < done.job.early_end.total
    assert float(np.ptp(run.tracker.device_time_s)) < 60.0 * BUDGET_MIN
    check_travel(run.machine, run.commanded)
    assert found.share_left < 0.15
    assert found.covered > 0.8


@pytest.mark.long
@pytest.mark.timeout(120)
def test_standstills_are_chosen_one_by_one(tmp_path):
    with adapted(tmp_path, "standstill", 3.0) as (_, done, run, parts):
        assert {part["rows"] for part in parts} == {1}
    assert run.mode == "standstill"
    assert len(run.commanded) == len(done.first["position"]) + len(parts)
    predicted = [part["predicted_um"] for part in parts]
    assert predicted[-1] < predicted[0] or len(parts) == 1


CORNERS = ((10, 10, 10), (400, 10, 10), (400, 300, 10), (10, 300, 200), (10, 10, 10))


def begin_on_bench(service, machine):
    rows = rows_at(*CORNERS, feed_mm_min=9000.0, dwell_s=1.0)
    job, _ = service.dispatcher.create(replace(OTF, machine=machine, rows=rows))
    wait_until(lambda: service.store.get(job.id).state == "ready", f"{machine} ready")
    arm_at_once(service.dispatcher, job.id, service.store.get(job.id).version)

    def streams():
        now = service.dispatcher.show(service.store.get(job.id))
        assert not now.is_final, now.failure
        return now.state == "running" and now.health.samples > 0

    wait_until(streams, f"{machine} to stream")
    return job


@pytest.mark.long
@pytest.mark.timeout(180)
def test_two_benches_measure_at_once_and_the_death_of_a_cell_leaves_the_other(tmp_path):
    simulated = {"simulated": True, "simulated_machines": 2}
    settings = load_settings(data_dir=tmp_path / "data", port=0, **simulated)
    with open_service(settings) as service:
        first, second = service.machines.list_all()
        assert (first.id, second.id) == ("default", "bench-2")
        tried = service.setup.try_devices(second.id)
        assert tried.samples > 100
        assert tried.lost_samples == 0
        assert tried.distance_mm is not None
        killed = begin_on_bench(service, second.id)
        surviving = begin_on_bench(service, first.id)
        second.cell.kill()
        wait_until(lambda: service.store.get(killed.id).is_final, "the killed job")
        dead, alive = (service.store.get(j.id) for j in (killed, surviving))
        assert dead.state == "faulted"
        assert not alive.is_final
        assert first.cell.status.restarts == 0
        wait_until(lambda: service.runs.find([surviving.id]), "the other's Run")
        run = service.runs.get(surviving.id)
        assert (run.complete, run.lost_samples) == (True, 0)
        provenance = open_run(service.runs.file(run.id)).provenance
        assert provenance["machine_id"] == "default"
        assert provenance["machine_version"] == "1"
