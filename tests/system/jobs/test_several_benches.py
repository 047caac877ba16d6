"""Two simulated machines in one service, over real links."""

from dataclasses import replace

import pytest

from arming import arm_at_once
from job_builders import OTF
from scripted_cell import wait_until
from truepath.main import open_service
from truepath.measurement.run_file.run_loader import open_run
from truepath.settings import load_settings

CORNERS = ((10, 10, 10), (400, 10, 10), (400, 300, 10), (10, 300, 200), (10, 10, 10))


def begin_on_bench(service, machine):
    rows = [
        {"x_mm": x, "y_mm": y, "z_mm": z, "feed_mm_min": 9000.0, "dwell_s": 1.0}
        for x, y, z in CORNERS
    ]
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
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_machines=2, port=0
    )
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
