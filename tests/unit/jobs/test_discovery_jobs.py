"""Discovery as a job: stages, abort, restart, the model that it is held against."""

import json
import threading
from dataclasses import replace

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
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.workers.science import discover_recorded
from truepath.machines.machine_cells import Machines


@pytest.fixture
def explorer():
    return Explorer()


@pytest.fixture
def context(context, explorer):
    """A service without a machine."""
    return replace(context, machines=Machines(), discoverer=explorer)


@pytest.fixture
def discovering(open_dispatcher):
    return open_dispatcher()


@pytest.fixture
def discover(discovering, run):
    def discover(**request):
        return discovering.create(RequestedJob(JobKind.DISCOVER, [run.id], **request))[
            0
        ]

    return discover


def test_a_discovery_ends_with_its_files_and_no_error_tables(context, discover, until):
    job = until(discover())
    assert (job.state, job.stage) == (State.SUCCEEDED, "reporting")
    assert job.has_discovery
    assert not job.has_result
    names = {f.name for f in (context.results / job.id).iterdir()}
    assert names == {"discovery.json", "model.json", "report.html"}


def test_it_tells_its_stage_is_done_again_after_a_restart_and_can_be_aborted(
    context, discover, discovering, explorer, open_dispatcher, until
):
    explorer.hold = threading.Event()
    job = discover()
    wait_until(lambda: context.store.get(job.id).stage == "discovering")
    discovering.close()
    again = open_dispatcher()
    again.interrupt_unfinished_jobs()
    wait_until(lambda: len(explorer.calls) == 2)
    again.abort(job.id)
    assert not until(job, State.ABORTED).has_discovery
    assert not (context.results / job.id).exists()


def test_a_run_that_cannot_be_fitted_fails_with_the_reason(discover, explorer, until):
    explorer.raises = EstimationError("too few lines")
    assert "too few lines" in until(discover(), State.FAILED).failure.detail


def test_it_is_held_against_the_model_of_another_job(
    context, discover, explorer, until
):
    first = until(discover())
    second = until(discover(model_id=first.id))
    _, model, model_id = explorer.calls[-1]
    assert model == str(context.results / first.id / "model.json")
    assert model_id == first.id
    chain = read_versions(context.results, second.id)
    assert [(one, grown["version"]) for one, grown in chain] == [
        (second.id, 3),
        (first.id, 2),
    ]


def test_a_model_that_is_not_there_is_refused_before_the_job_is_made(
    context, run, discovering, discover, until
):
    with pytest.raises(NotFound, match="no job nowhere"):
        discover(model_id="nowhere")
    analysed = until(discovering.create(RequestedJob(JobKind.ANALYSE, [run.id]))[0])
    found = find_model_file(context.results, analysed.id)
    assert found.name == "result.json"
    assert len(context.store.list_page(10)) == 1


def test_the_task_writes_what_the_contract_asks_and_models_compare(small_run, tmp_path):
    stages = []

    def discover(folder, *model):
        discover_recorded(
            [str(small_run)],
            str(folder),
            *model,
            on_progress=lambda *told: stages.append(told),
        )

    first, second = tmp_path / "first", tmp_path / "second"
    model = first / "model.json"
    discover(first, None, None)
    discover(second, str(model), "one")
    assert {stage for _, stage in stages} == {"discovering", "reporting"}
    assert all(0.0 <= share <= 1.0 for share, _ in stages)
    content = json.loads((second / "model.json").read_text())
    assert (content["version"], content["parent"]["source"]) == (3, "one")
    assert len(content["parent"]["sha256"]) == 64
    changes = read_difference(model, second / "model.json")
    assert changes == content["difference"]
    assert not [p for p in tmp_path.iterdir() if p.suffix == ".part"]
