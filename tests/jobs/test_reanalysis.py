"""Many Runs analysed again as one job: restart, failures, progress, cancelling."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from scripted_cell import wait_until

from truepath.catalogue.errors import TaskFailed
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.errors import AlignmentError, NotFound
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.workers.executor import ProcessExecutor
from truepath.jobs.workers.reanalysis import SUMMARY, figures_of, keep_outcome
from truepath.jobs.workers.science import analyse_recorded, reanalyse_run
from truepath.jobs.workers.workers import Workers
from truepath.machines.machine_cells import Machines

COUNT = 20


def figures(um):
    return {"verdict": "usable", "volumetric_error_um": um, "uncertainty_um": 0.1}


class Analyst:
    """Analyses a Run in no time; some fail, and it can be held."""

    def __init__(self):
        self.calls, self.failing, self.defects = [], set(), set()
        self.let, self.begun = threading.Event(), threading.Event()
        self.let.set()
        self.dies_at = None

    def __call__(self, order, perpendicular_only, *, on_progress):
        self.calls.append(order.run_id)
        self.begun.set()
        self.let.wait(20)
        on_progress(0.5, "estimating")  # raises where the job is aborted
        if order.run_id in self.defects:
            raise TaskFailed("ZeroDivisionError", "a defect", "trace")
        if order.run_id in self.failing:
            keep_outcome(order, failure=("AlignmentError", "no line is found"))
        else:
            keep_outcome(order, after=figures(5.0), took_s=0.1)


@pytest.fixture
def runs(context, small_run, monkeypatch):
    """Twenty tiny Runs."""
    made = []
    for number in range(COUNT):
        upload = context.runs.make_upload_file()
        upload.write_bytes(small_run.read_bytes())
        made.append(context.runs.add_uploaded(upload, f"run {number}").id)
    return made


@pytest.fixture
def analyst():
    return Analyst()


@pytest.fixture
def dispatcher(context, event_bus, analyst):
    """A dispatcher of a service without a machine."""
    bare = replace(context, machines=Machines(), reanalyser=analyst)
    dispatcher = Dispatcher(bare, event_bus)
    yield dispatcher
    analyst.let.set()
    dispatcher.close()


def ended(context, job):
    wait_until(lambda: context.store.get(job.id).is_final, "the end")
    return context.store.get(job.id)


def summary_of(context, job):
    return json.loads((context.results / job.id / SUMMARY).read_text())


def test_every_run_is_analysed_and_those_that_fail_are_named(
    context, runs, dispatcher, analyst
):
    analyst.failing, analyst.defects = {runs[3]}, {runs[4]}
    gone = context.runs.file(runs[5])
    gone.unlink()
    job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, runs))
    job = ended(context, job)
    assert (job.state, job.failure) == (State.SUCCEEDED, None)
    assert (job.progress.done, job.progress.total) == (COUNT, COUNT)
    assert job.progress.unit == "runs"
    summary = summary_of(context, job)
    assert (summary["total"], summary["analysed"], summary["failed"]) == (20, 17, 3)
    assert [one["run_id"] for one in summary["analyses"]] == runs
    reasons = {o["run_id"]: o["failure"] for o in summary["analyses"] if o["failure"]}
    assert reasons[runs[3]]["detail"] == "no line is found"
    assert reasons[runs[4]] == {"family": "ZeroDivisionError", "detail": "a defect"}
    assert "has gone" in reasons[runs[5]]["detail"]
    assert job.run_ids == (), "a thousand of them in each event would be too many"


def test_a_service_that_starts_again_goes_on_with_what_is_left(
    context, event_bus, runs, dispatcher, analyst
):
    def hold_at_the_eighth(order, *rest, on_progress):
        if len(analyst.calls) == 7:
            analyst.let.clear()
        analyst(order, *rest, on_progress=on_progress)

    held = replace(context, machines=Machines(), reanalyser=hold_at_the_eighth)
    first = Dispatcher(held, event_bus)
    job, _ = first.create(RequestedJob(JobKind.REANALYSE, runs))
    wait_until(lambda: len(analyst.calls) == 8, "the eighth")
    releasing = threading.Timer(0.2, analyst.let.set)
    releasing.start()
    first.close()
    releasing.join()
    wait_until(lambda: context.store.get(job.id).state is State.QUEUED, "queued")
    before = list(analyst.calls)
    dispatcher.interrupt_unfinished_jobs()
    assert ended(context, job).state is State.SUCCEEDED
    again = analyst.calls[len(before) :]
    assert set(again) | set(before[:-1]) == set(runs)
    assert not set(again) & set(before[:-1]), "what is done is not done again"
    assert summary_of(context, job)["analysed"] == COUNT


def test_an_abort_ends_it_and_keeps_what_is_done(context, runs, dispatcher, analyst):
    job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, runs))
    analyst.begun.wait(20)
    analyst.let.clear()
    dispatcher.abort(job.id)
    analyst.let.set()
    assert ended(context, job).state in (State.ABORTED, State.SUCCEEDED)
    assert len(analyst.calls) <= COUNT


def since(year):
    return {"since": datetime(year, 1, 1, tzinfo=UTC)}


def test_runs_are_chosen_by_machine_and_time(context, runs, event_bus, analyst):
    assert context.runs.get(runs[0]).machine == context.require_machine().name
    dispatcher = Dispatcher(replace(context, reanalyser=analyst), event_bus)
    chosen = {"machine": "default", "plan_request": since(2000)}
    job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, **chosen))
    assert ended(context, job).state is State.SUCCEEDED
    assert summary_of(context, job)["total"] == COUNT
    late = RequestedJob(JobKind.REANALYSE, plan_request=since(2999))
    with pytest.raises(NotFound, match="there is no Run of any machine since 2999"):
        dispatcher.create(late)
    with pytest.raises(NotFound, match="drives no machine another"):
        dispatcher.create(RequestedJob(JobKind.REANALYSE, machine="another"))
    with pytest.raises(NotFound, match="there is no run nothing"):
        dispatcher.create(RequestedJob(JobKind.REANALYSE, ["nothing"]))


@pytest.mark.timeout(180)
def test_the_present_code_is_held_against_the_result_of_before(
    context, event_bus, runs, small_run
):
    """With real analyses, two at a time in worker processes."""
    earlier, _ = context.store.create(Job(JobKind.ANALYSE, run_id=runs[0]))
    folder = context.results / earlier.id
    analyse_recorded(
        [str(context.runs.file(runs[0]))],
        str(folder),
        False,
        None,
        Workers(),
        on_progress=lambda *_: None,
    )
    done = {"state": State.SUCCEEDED}
    context.store.change(earlier.id, lambda j: replace(j, state=State.RUNNING))
    context.store.change(earlier.id, lambda j: replace(j, **done))
    context.runs.file(runs[1]).write_bytes(b"garbage")
    executor = ProcessExecutor(2)
    real = replace(context, machines=Machines(), executor=executor)
    dispatcher = Dispatcher(real, event_bus)
    try:
        job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, runs[:3]))
        wait_until_long(lambda: context.store.get(job.id).is_final)
    finally:
        dispatcher.close()
        executor.close()
    first, broken, third = summary_of(context, job)["analyses"]
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


def wait_until_long(reached):
    for _ in range(6):
        try:
            return wait_until(reached)
        except AssertionError:
            continue
    raise AssertionError("waited in vain")


def test_a_run_that_cannot_be_aligned_is_an_outcome_and_no_error(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AlignmentError("no line is found")

    monkeypatch.setattr("truepath.results.analysis.analyse", refuse)
    monkeypatch.setattr("truepath.jobs.workers.science.open_recorded", lambda _: None)
    from truepath.jobs.workers.reanalysis import RunOrder

    order = RunOrder("a", "run a", "a.zip", None, "", str(tmp_path / "a"), "")
    reanalyse_run(order, False, on_progress=lambda *_: None)
    outcome = json.loads((Path(order.folder) / "outcome.json").read_text())
    assert outcome["failure"] == {
        "family": "AlignmentError",
        "detail": "no line is found",
    }
