"""Discovery as a job: stages, abort, restart, the model that it is held against."""

from __future__ import annotations

import json
import threading
from dataclasses import replace

import numpy as np
import pytest
from scripted_cell import Explorer, wait_until

from truepath.answers.history.model_history import (
    find_model_file,
    read_difference,
    read_versions,
)
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import EstimationError, NotFound
from truepath.files.bundle.bundle import write_bundle, zip_bundle
from truepath.files.bundle.run import Run
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.workers.science import discover_recorded
from truepath.machines.machine_cells import Machines
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import TrackerSamples


@pytest.fixture
def explorer():
    return Explorer()


@pytest.fixture
def run(context, machine, tmp_path):
    samples = TrackerSamples(
        np.arange(10), np.arange(10) / 500.0, np.ones((10, 3)), np.zeros(10, np.int64)
    )
    points = Configurations(
        machine.axis_names, np.array([[1.0, 2.0, 3.0]]), np.array([1.0])
    )
    whole = Run("b", machine, points, samples)
    write_bundle(whole, tmp_path / "bundle")
    packed = tmp_path / "bundle.zip"
    packed.write_bytes(zip_bundle(whole))
    return context.runs.add_uploaded(packed, "from the shop floor")


@pytest.fixture
def discovering(context, event_bus, explorer):
    """A dispatcher of a service without a machine."""
    bare = replace(context, machines=Machines(), discoverer=explorer)
    dispatcher = Dispatcher(bare, event_bus)
    yield dispatcher
    dispatcher.close()


def ended(context, job):
    wait_until(lambda: context.store.get(job.id).is_final)
    return context.store.get(job.id)


def test_a_discovery_ends_with_its_files_and_no_error_tables(context, run, discovering):
    job, _ = discovering.create(RequestedJob(JobKind.DISCOVER, [run.id]))
    job = ended(context, job)
    assert (job.state, job.stage) == (State.SUCCEEDED, "reporting")
    assert job.has_discovery
    assert not job.has_result
    names = {f.name for f in (context.results / job.id).iterdir()}
    assert names == {"discovery.json", "model.json", "report.html"}


def test_it_tells_its_stage_and_can_be_aborted(context, run, discovering, explorer):
    explorer.hold = threading.Event()
    job, _ = discovering.create(RequestedJob(JobKind.DISCOVER, [run.id]))
    wait_until(lambda: context.store.get(job.id).stage == "discovering")
    discovering.abort(job.id)
    job = ended(context, job)
    assert job.state is State.ABORTED
    assert not job.has_discovery
    assert not (context.results / job.id).exists()


def test_after_a_restart_it_is_done_again(
    context, event_bus, run, discovering, explorer
):
    explorer.hold = threading.Event()
    job, _ = discovering.create(RequestedJob(JobKind.DISCOVER, [run.id]))
    wait_until(lambda: explorer.calls)
    discovering.close()
    explorer.hold = None
    bare = replace(context, machines=Machines(), discoverer=explorer)
    later = Dispatcher(bare, event_bus)
    later.interrupt_unfinished_jobs()
    assert ended(context, job).has_discovery
    assert len(explorer.calls) == 2
    later.close()


def test_a_run_that_cannot_be_fitted_fails_with_the_reason(
    context, run, discovering, explorer
):
    explorer.raises = EstimationError("too few lines")
    job, _ = discovering.create(RequestedJob(JobKind.DISCOVER, [run.id]))
    job = ended(context, job)
    assert job.state is State.FAILED
    assert "too few lines" in job.failure.detail


def test_it_is_held_against_the_model_of_another_job(
    context, run, discovering, explorer
):
    first, _ = discovering.create(RequestedJob(JobKind.DISCOVER, [run.id]))
    ended(context, first)
    second, _ = discovering.create(
        RequestedJob(JobKind.DISCOVER, [run.id], model_id=first.id)
    )
    ended(context, second)
    _, model, model_id = explorer.calls[-1]
    assert model == str(context.results / first.id / "model.json")
    assert model_id == first.id
    chain = read_versions(context.results, second.id)
    assert [(one, grown["version"]) for one, grown in chain] == [
        (second.id, 3),
        (first.id, 2),
    ]


def test_a_model_that_is_not_there_is_refused_before_the_job_is_made(
    context, run, discovering
):
    with pytest.raises(NotFound, match="no job nowhere"):
        discovering.create(RequestedJob(JobKind.DISCOVER, [run.id], model_id="nowhere"))
    analysed, _ = discovering.create(RequestedJob(JobKind.ANALYSE, [run.id]))
    ended(context, analysed)
    found = find_model_file(context.results, analysed.id)
    assert found.name == "result.json"
    assert len(context.store.list_page(10)) == 1


def test_the_task_writes_what_the_contract_asks_and_models_compare(small_run, tmp_path):
    stages = []

    def told(share, stage):
        stages.append((share, stage))

    first, second = tmp_path / "first", tmp_path / "second"
    discover_recorded([str(small_run)], str(first), None, None, on_progress=told)
    model = first / "model.json"
    discover_recorded(
        [str(small_run)], str(second), str(model), "one", on_progress=told
    )
    assert {s for _, s in stages} == {"discovering", "reporting"}
    shares = [share for share, _ in stages]
    assert min(shares) >= 0.0
    assert max(shares) <= 1.0
    content = json.loads((second / "model.json").read_text())
    assert (content["version"], content["parent"]["source"]) == (3, "one")
    assert len(content["parent"]["sha256"]) == 64
    changes = read_difference(model, second / "model.json")
    assert changes == content["difference"]
    assert not [p for p in tmp_path.iterdir() if p.suffix == ".part"]
