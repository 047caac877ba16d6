"""Adaptive jobs on simulated devices: planned on the way, from what was told so far."""

import json

import numpy as np
import pytest
from tests.system.jobs.conftest import measured

from truepath.catalogue.job import JobKind
from truepath.cli.demo import compare_with_truth
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.measurement.run_file.run_reading import open_run
from truepath.motion.workspace.travel import check_travel
from truepath_simulators.bench.bench import Bench
from truepath_simulators.scenario import load_machine

SPEED, BUDGET_MIN = 10.0, 10.0


def measure(bench, folder, mode, target_um):
    plan = {"mode": mode, "minutes": BUDGET_MIN}
    asked = {"target_um": target_um, "plan_request": plan}
    request = RequestedJob(JobKind.MEASURE_ADAPTIVE, **asked)
    return measured(request, folder, bench, load_machine("demo"))


@pytest.mark.long
@pytest.mark.timeout(120)
def test_lines_lost_with_the_beam_are_planned_anew_until_the_target(tmp_path):
    with (
        Bench(seed=1, speed=SPEED, faults=("tracker:beam-break@17s+8s",)) as bench,
        measure(bench, tmp_path, "otf", 0.5) as done,
    ):
        job, service = done.job, done.service
        run = open_run(service.runs.file(job.id))
        assert service.runs.get(job.id).complete
        result = json.loads((service.results / job.id / "result.json").read_text())
        found = compare_with_truth(result, bench.truth_at)
    assert job.early_end.reached_um <= 0.5
    lines = len(run.commanded) - 1
    parts = [part for _, part in done.list_notices("plan")]
    assert parts
    first = len(done.first_plan["position"]) - 1
    assert lines == first + sum(part["rows"] for part in parts)
    assert "beam-lost" in {event.kind for event in run.events}
    assert job.early_end.done < job.early_end.total
    assert float(np.ptp(run.tracker.device_time_s)) < 60.0 * BUDGET_MIN
    check_travel(run.machine, run.commanded)
    assert found.share_left < 0.15
    assert found.covered > 0.8


@pytest.mark.long
@pytest.mark.timeout(120)
def test_standstills_are_chosen_one_by_one(tmp_path):
    with (
        Bench(seed=1, speed=SPEED) as bench,
        measure(bench, tmp_path, "standstill", 3.0) as done,
    ):
        run = open_run(done.service.runs.file(done.job.id))
    assert done.job.early_end.reached_um <= 3.0
    parts = [part for _, part in done.list_notices("plan")]
    assert parts
    assert {part["rows"] for part in parts} == {1}
    assert run.mode == "standstill"
    assert len(run.commanded) == len(done.first_plan["position"]) + len(parts)
    predicted = [part["predicted_um"] for part in parts]
    assert predicted[-1] < predicted[0] or len(parts) == 1
