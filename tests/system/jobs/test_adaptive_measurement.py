"""Adaptive jobs on simulated devices: planned on the way, from what was told so far."""

import json

import numpy as np
import pytest

from arming import arm_at_once
from scripted_cell import Inline, wait_until
from truepath.catalogue.errors import StaleVersion
from truepath.catalogue.job import JobKind
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store.store import Store
from truepath.catalogue.transitions import State
from truepath.cli.demo import compare_with_truth
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.job_creation import RequestedJob
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.live_estimation import LiveEstimation
from truepath.jobs.workers.analysis_tasks import analyse_recorded
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import MachineCell, Machines
from truepath.measurement.messages import CellConfig
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_loader import open_run
from truepath.motion.workspace.travel import check_travel
from truepath_simulators.bench.bench import Bench

SPEED = 10.0
BUDGET_MIN = 10.0


class Followed:
    """An adaptive job on a bench, with what was told on the way."""

    def __init__(self, bench, context, dispatcher, told):
        self.bench, self.context, self.dispatcher = bench, context, dispatcher
        self.told = told

    def run(self, mode, target_um):
        asked = {"plan_request": {"mode": mode, "minutes": BUDGET_MIN}}
        asked["target_um"] = target_um
        request = RequestedJob(JobKind.MEASURE_ADAPTIVE, **asked)
        job, _ = self.dispatcher.create(request)
        ready = wait_until(lambda: self._in(job.id, State.READY), "the first part")
        self.first = self.context.store.read_plan(job.id)
        arm_at_once(self.dispatcher, job.id, ready.version)
        return wait_until(lambda: self._ended(job.id), "the end")

    def notices(self, kind):
        return [notice.body for notice in self.told if notice.type == kind]

    def _in(self, job_id, state):
        job = self.context.store.get(job_id)
        assert not job.is_final, job.failure
        return job if job.state is state else None

    def _ended(self, job_id):
        """The operator locks the beam again and presses Resume until it goes on."""
        job = self.context.store.get(job_id)
        if job.state is State.PAUSED:
            try:
                self.dispatcher.resume(job_id, job.version)
            except StaleVersion:
                return None
        return job if job.is_final else None


@pytest.fixture
def faults():
    return ()


@pytest.fixture
def followed(faults, machine, database, event_bus, tmp_path, run_reader):
    told = []
    event_bus.subscribe(told.append)
    with Bench(seed=1, speed=SPEED, faults=faults) as bench:
        links = bench.tracker_options, "modbus", bench.motion_options
        config = CellConfig("streaming", *links)
        cell = CellSupervisor(lambda: Cell(config))
        results = tmp_path / "results"
        results.mkdir()
        context = JobContext(
            store=Store(database, event_bus.publish),
            runs=RunCatalogue(database, tmp_path / "runs", run_reader),
            results=results,
            executor=Inline(),
            science=analyse_recorded,
            machines=Machines([MachineCell("default", machine, cell)]),
            live=LiveEstimation,
        )
        cell.start()
        dispatcher = Dispatcher(context, event_bus)
        yield Followed(bench, context, dispatcher, told)
        dispatcher.close()
        cell.close()


@pytest.mark.long
@pytest.mark.timeout(120)
@pytest.mark.parametrize("faults", [("tracker:beam-break@17s+8s",)])
def test_lines_lost_with_the_beam_are_planned_anew_until_the_target(followed):
    job = followed.run("otf", target_um=0.5)
    assert job.state is State.SUCCEEDED, job.failure
    assert job.early_end.reached_um <= 0.5
    run = open_run(followed.context.runs.file(job.id))
    lines = len(run.commanded) - 1
    parts = followed.notices("plan")
    assert parts
    assert lines == len(followed.first["position"]) - 1 + sum(p["rows"] for p in parts)
    assert "beam-lost" in {event.kind for event in run.events}
    assert job.early_end.done < job.early_end.total
    assert float(np.ptp(run.tracker.device_time_s)) < 60.0 * BUDGET_MIN
    check_travel(run.machine, run.commanded)
    assert followed.context.runs.get(job.id).complete
    file = followed.context.results / job.id / "result.json"
    found = compare_with_truth(json.loads(file.read_text()), followed.bench.truth_at)
    assert found.share_left < 0.15
    assert found.covered > 0.8


@pytest.mark.long
@pytest.mark.timeout(120)
def test_standstills_are_chosen_one_by_one(followed):
    job = followed.run("standstill", target_um=3.0)
    assert job.state is State.SUCCEEDED, job.failure
    assert job.early_end.reached_um <= 3.0
    parts = followed.notices("plan")
    assert parts
    assert {part["rows"] for part in parts} == {1}
    run = open_run(followed.context.runs.file(job.id))
    assert run.mode == "standstill"
    assert len(run.commanded) == len(followed.first["position"]) + len(parts)
    predicted = [part["predicted_um"] for part in parts]
    assert predicted[-1] < predicted[0] or len(parts) == 1
