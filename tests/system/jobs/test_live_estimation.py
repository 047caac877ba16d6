"""Tables while the machine moves: published in time, never in anybody's way."""

import json
import os
import signal
import time

import numpy as np
import pytest

from arming import arm_at_once
from scripted_cell import wait_until
from truepath.catalogue.job import JobKind
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.running.live_estimation import (
    PERIOD_S,
    WAITING_BLOCKS,
    LiveEstimation,
)
from truepath.jobs.running.live_process import LiveEstimateOrder
from truepath.main import open_service
from truepath.settings import load_settings
from truepath_simulators.worlds.synthetic import Setting

SPEED = 8.0


@pytest.fixture
def run(record):
    return record(31, rows=18, setting=Setting(rate_hz=100.0))[0]


@pytest.fixture
def shown():
    """The estimates that were told."""
    return []


@pytest.fixture
def live(run, shown):
    live = LiveEstimation(LiveEstimateOrder(run.machine, run.commanded), shown.append)
    yield live
    live.close()
    live.close()


def feed(live, run, until=lambda: False):
    """Offer a Run block by block, as fast as it is taken."""
    for begin in range(0, len(run.tracker), 200):
        wait_until(lambda: live._queue.qsize() < WAITING_BLOCKS)
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


def test_an_estimate_is_told_again_with_its_age_until_its_process_dies(
    run, live, shown
):
    """Whatever the process does: here it is stopped in the middle of its work."""
    live.start()
    feed(live, run, until=lambda: shown)
    wait_until(lambda: shown)
    os.kill(live._process.process_id, signal.SIGSTOP)
    wait_until(lambda: shown[-1]["age_s"] > 1.0)
    told = [body for body in shown if body["done"] == shown[-1]["done"]]
    ages = [body["age_s"] for body in told]
    assert ages == sorted(ages)
    assert len(told) >= 1.0 / (2 * PERIOD_S)
    assert len({body["volumetric_uncertainty_um"] for body in told}) == 1
    live._process.kill()
    live.finish()
    count = len(shown)
    time.sleep(3 * PERIOD_S)  # silence can only be waited for
    assert len(shown) == count
    assert not shown[-1]["is_last"]


@pytest.mark.long
@pytest.mark.timeout(120)
def test_a_measurement_ends_early_and_in_order_at_its_target(tmp_path):
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_speed=SPEED, port=0
    )
    with open_service(settings) as service:
        wait_until(lambda: service.machines.first.cell.status.state == "disconnected")
        request = RequestedJob(JobKind.MEASURE_OTF, feed_mm_min=6000.0, target_um=20.0)
        job, _ = service.dispatcher.create(request)
        wait_until(lambda: service.store.get(job.id).state == "ready")
        arm_at_once(service.dispatcher, job.id, service.store.get(job.id).version)
        wait_until(lambda: service.store.get(job.id).is_final, 100.0)
        ended = service.store.get(job.id)
        assert ended.state == "succeeded"
        assert ended.early_end is not None
        assert ended.early_end.reached_um <= ended.target_um == 20.0
        last = service.event_bus.estimates.newest(job.id)
        run = service.runs.get(ended.run_id)
        assert service.results.joinpath(job.id, "result.json").is_file()
    assert 4 <= last["done"] < last["total"]
    assert last["volumetric_uncertainty_um"] <= 25.0
    assert run.lost_samples == 0


@pytest.mark.long
@pytest.mark.timeout(120)
def test_tables_tighten_live_and_end_at_the_result(tmp_path):
    """The whole service on simulated devices, faster than real."""
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_speed=SPEED, port=0
    )
    heard = []
    with open_service(settings) as service:
        service.event_bus.subscribe(
            lambda n: (
                heard.append((time.monotonic(), n.body))
                if n.type == "estimate"
                else None
            )
        )
        wait_until(lambda: service.machines.first.cell.status.state == "disconnected")
        job, _ = service.dispatcher.create(
            RequestedJob(JobKind.MEASURE_OTF, feed_mm_min=8000.0)
        )
        wait_until(lambda: service.store.get(job.id).state == "ready")
        arm_at_once(service.dispatcher, job.id, service.store.get(job.id).version)
        wait_until(lambda: service.store.get(job.id).is_final, 100.0)
        assert service.store.get(job.id).state == "succeeded"
        last = service.event_bus.estimates.newest(job.id)
        file = service.results / job.id / "result.json"
        result = json.loads(file.read_text(encoding="utf-8"))
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
