"""Science jobs as they are computed: a real lane, its workers, its files."""

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import psutil
import pytest

from scripted_cell import wait_until
from truepath.catalogue.errors import Aborted
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.jobs.kinds.job_creation import RequestedJob
from truepath.jobs.workers.analysis_tasks import analyse_recorded
from truepath.jobs.workers.executor import ProcessExecutor
from truepath.jobs.workers.reanalysis import SUMMARY, figures_of
from truepath.jobs.workers.workers import Workers
from truepath.machines.machine_cells import Machines
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.progress import ignore_progress

TWO_BLOCKS = TrialPlan(seed=5, most_blocks=2)


@pytest.fixture(scope="module")
def lane():
    lanes = ProcessExecutor(1)
    yield lanes
    lanes.close()


@pytest.fixture(scope="module")
def submit(lane, small_run, tmp_path_factory):
    def submit(plan, workers, on_progress=ignore_progress):
        folder = tmp_path_factory.mktemp("analysed") / "result"
        arguments = [str(small_run)], str(folder), False, plan, workers
        computation = lane.submit(
            analyse_recorded, *arguments, on_progress=on_progress, started=lambda: None
        )
        return computation, folder

    return submit


@pytest.mark.long
def test_a_job_brings_the_same_trials_from_any_workers_or_a_cluster(submit, scheduler):
    def analyse(workers):
        told = []
        job, folder = submit(TWO_BLOCKS, workers, lambda _, stage: told.append(stage))
        job.result()
        stages = list(dict.fromkeys(told))
        assert stages == ["aligning", "estimating", "validating", "reporting"]
        assert "held against trials" in (folder / "report.html").read_text()
        return json.loads((folder / "result.json").read_text())["monte_carlo"]

    by_one = analyse(Workers(count=1))
    assert (by_one["seed"], by_one["trials"]) == (5, 20_000)
    assert analyse(Workers(count=2)) == by_one
    assert analyse(Workers("dask", scheduler=scheduler)) == by_one


def test_an_aborted_job_ends_its_workers_and_leaves_no_result(submit):
    trying = threading.Event()

    def on_progress(_, stage):
        if stage == "validating":
            trying.set()

    before = set(psutil.Process().children(recursive=True))
    endless = TrialPlan(digits=2, most_blocks=10_000)
    job, folder = submit(endless, Workers(count=2), on_progress=on_progress)
    with ThreadPoolExecutor() as pool:
        outcome = pool.submit(job.result)
        assert trying.wait(30.0)
        job.cancel()
        assert isinstance(outcome.exception(10.0), Aborted)
    assert not folder.exists()
    wait_until(
        lambda: not set(psutil.Process().children(recursive=True)) - before,
        "the end of the workers",
    )


@pytest.mark.long
def test_runs_are_held_against_before(lane, small_run, context, open_dispatcher, until):
    runs = []
    for name in "abc":
        upload = context.runs.make_upload_file()
        upload.write_bytes(small_run.read_bytes())
        runs.append(context.runs.add_uploaded(upload, name).id)
    earlier, _ = context.store.create(Job(JobKind.ANALYSE, run_id=runs[0]))
    folder = context.results / earlier.id
    order = [str(context.runs.file(runs[0]))], str(folder), False, None, Workers()
    analyse_recorded(*order, on_progress=ignore_progress)
    for state in (State.RUNNING, State.SUCCEEDED):
        context.store.change(earlier.id, lambda j, to=state: replace(j, state=to))
    context.runs.file(runs[1]).write_bytes(b"garbage")
    dispatcher = open_dispatcher(machines=Machines(), executor=lane)
    job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, runs))
    until(job)
    summary = json.loads((context.results / job.id / SUMMARY).read_text())
    first, broken, third = summary["analyses"]
    result = json.loads((folder / "result.json").read_text())
    assert first["before_job"] == earlier.id
    before, after = dict(first["before"]), dict(first["after"])
    assert before == figures_of(result)
    assert after.pop("verdict") == before.pop("verdict")
    assert after == pytest.approx(before, rel=1e-9)  # whatever threads BLAS has
    assert broken["failure"]["family"] == "BundleError"
    assert "has been changed since it was catalogued" in broken["failure"]["detail"]
    assert (third["before"], third["after"]) == (None, first["after"])
    kept = context.results / job.id / "runs" / runs[0]
    assert json.loads((kept / "result.json").read_text())["verdict"]
    assert (kept / "error_tables.csv").is_file()
    assert not (context.results / job.id / "runs" / runs[1] / "result.json").exists()
