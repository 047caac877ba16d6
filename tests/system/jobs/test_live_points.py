"""Standstill points by a polled tracker, followed live and ended at the target."""

import json
import time

import pytest

from arming import arm_at_once
from truepath.catalogue.job import JobKind
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.main import open_service
from truepath.settings import load_settings
from truepath_simulators.bench.bench import Bench
from truepath_simulators.scenario import load_machine


def wait_until(reached, timeout_s):
    end = time.monotonic() + timeout_s
    while not reached():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


@pytest.mark.long
@pytest.mark.timeout(240)
def test_polled_points_tighten_live_and_end_the_job_at_its_target(tmp_path):
    content = dict(load_machine("demo"))
    content["tracker"] = {**content["tracker"], "rate_hz": 2.0}
    machine = tmp_path / "machine.json"
    machine.write_text(json.dumps(content), encoding="utf-8")
    with Bench(content, 7, 20.0, protocol="geocom", tracker="tcp") as bench:
        settings = load_settings(
            data_dir=tmp_path / "data",
            port=0,
            machine_file=machine,
            tracker_driver="geocom",
            tracker_options=bench.tracker_options,
            motion_driver="modbus",
            motion_options=bench.motion_options,
        )
        heard = []
        with open_service(settings) as service:
            service.event_bus.subscribe(
                lambda n: heard.append(n.body) if n.type == "estimate" else None
            )
            wait_until(
                lambda: service.machines.first.cell.status.state == "disconnected", 30.0
            )
            request = RequestedJob(JobKind.MEASURE_STANDSTILL, target_um=25.0)
            job, _ = service.dispatcher.create(request)
            wait_until(lambda: service.store.get(job.id).state == "ready", 60.0)
            arm_at_once(service.dispatcher, job.id, service.store.get(job.id).version)
            wait_until(lambda: service.store.get(job.id).is_final, 150.0)
            ended = service.store.get(job.id)
    assert ended.state == "succeeded"
    sigma = [body["volumetric_uncertainty_um"] for body in heard]
    assert len(set(sigma)) >= 5
    assert sigma[0] > sigma[-1]
    assert ended.early_end is not None
    assert ended.early_end.reached_um <= 25.0
    assert ended.early_end.done < ended.early_end.total
