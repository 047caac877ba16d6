"""Many Runs analysed again as one job: restart, failures, progress, cancelling."""

import json
import threading
from datetime import UTC, datetime
from pathlib import Path

import pytest

from scripted_cell import wait_until
from truepath.catalogue.errors import TaskFailed
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import AlignmentError, NotFound
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.workers.analysis_tasks import reanalyse_run
from truepath.jobs.workers.reanalysis import SUMMARY, RunOrder, store_outcome
from truepath.machines.machine_cells import Machines

COUNT = 9


class Analyst:
    def __init__(self):
        self.calls, self.failing, self.defects = [], set(), set()
        self.let = threading.Event()
        self.let.set()

    def __call__(self, order, perpendicular_only, *, on_progress):
        self.calls.append(order.run_id)
        self.let.wait(20)
        on_progress(0.5, "estimating")  # raises where the job is aborted
        if order.run_id in self.defects:
            raise TaskFailed("ZeroDivisionError", "a defect", "trace")
        if order.run_id in self.failing:
            store_outcome(order, failure=("AlignmentError", "no line is found"))
        else:
            figures = {"volumetric_error_um": 5.0, "uncertainty_um": 0.1}
            store_outcome(order, after={"verdict": "usable"} | figures, took_s=0.1)


@pytest.fixture
def runs(context, small_run):
    made = []
    for number in range(COUNT):
        upload = context.runs.make_upload_file()
        upload.write_bytes(small_run.read_bytes())
        made.append(context.runs.add_uploaded(upload, f"run {number}").id)
    return made


@pytest.fixture
def analyst():
    analyst = Analyst()
    yield analyst
    analyst.let.set()


@pytest.fixture
def dispatcher(open_dispatcher, analyst):
    return open_dispatcher(machines=Machines(), reanalyser=analyst)


def summary_of(context, job):
    return json.loads((context.results / job.id / SUMMARY).read_text())


@pytest.mark.database
def test_runs_are_analysed_failures_named(context, runs, dispatcher, analyst, until):
    analyst.failing, analyst.defects = {runs[3]}, {runs[4]}
    gone = context.runs.file(runs[5])
    gone.unlink()
    job = until(dispatcher.create(RequestedJob(JobKind.REANALYSE, runs))[0])
    assert (job.state, job.failure) == (State.SUCCEEDED, None)
    assert (job.progress.done, job.progress.total) == (COUNT, COUNT)
    assert job.progress.unit == "runs"
    summary = summary_of(context, job)
    assert (summary["total"], summary["analysed"], summary["failed"]) == (9, 6, 3)
    assert [one["run_id"] for one in summary["analyses"]] == runs
    reasons = {o["run_id"]: o["failure"] for o in summary["analyses"] if o["failure"]}
    assert reasons[runs[3]]["detail"] == "no line is found"
    assert reasons[runs[4]] == {"family": "ZeroDivisionError", "detail": "a defect"}
    assert "has gone" in reasons[runs[5]]["detail"]
    assert job.run_ids == (), "a thousand of them in each event would be too many"


def test_a_service_that_starts_again_goes_on_with_what_is_left(
    context, open_dispatcher, runs, dispatcher, analyst, until
):
    def hold_at_the_eighth(order, *rest, on_progress):
        if len(analyst.calls) == 7:
            analyst.let.clear()
        analyst(order, *rest, on_progress=on_progress)

    first = open_dispatcher(machines=Machines(), reanalyser=hold_at_the_eighth)
    job, _ = first.create(RequestedJob(JobKind.REANALYSE, runs))
    wait_until(lambda: len(analyst.calls) == 8, "the eighth")
    releasing = threading.Timer(0.2, analyst.let.set)
    releasing.start()
    first.close()
    releasing.join()
    until(job, State.QUEUED)
    before = list(analyst.calls)
    dispatcher.interrupt_unfinished_jobs()
    until(job, State.SUCCEEDED)
    again = analyst.calls[len(before) :]
    assert set(again) | set(before[:-1]) == set(runs)
    assert not set(again) & set(before[:-1]), "what is done is not done again"
    assert summary_of(context, job)["analysed"] == COUNT


@pytest.mark.database
def test_machine_and_time_choose_runs(context, runs, open_dispatcher, analyst, until):
    assert context.runs.get(runs[0]).machine == context.require_machine().name
    dispatcher = open_dispatcher(reanalyser=analyst)
    since = {"since": datetime(2000, 1, 1, tzinfo=UTC)}
    chosen = {"machine": "default", "plan_request": since}
    job, _ = dispatcher.create(RequestedJob(JobKind.REANALYSE, **chosen))
    until(job, State.SUCCEEDED)
    assert summary_of(context, job)["total"] == COUNT
    for request, said in (
        (
            {"plan_request": {"since": datetime(2999, 1, 1, tzinfo=UTC)}},
            "there is no Run of any machine since 2999",
        ),
        ({"machine": "another"}, "drives no machine another"),
        ({"run_ids": ["nothing"]}, "there is no run nothing"),
    ):
        with pytest.raises(NotFound, match=said):
            dispatcher.create(RequestedJob(JobKind.REANALYSE, **request))


def test_a_run_that_cannot_be_aligned_is_an_outcome_and_no_error(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AlignmentError("no line is found")

    monkeypatch.setattr("truepath.results.analysis.analyse", refuse)
    tasks = "truepath.jobs.workers.analysis_tasks"
    monkeypatch.setattr(f"{tasks}.open_recorded", lambda _: None)
    order = RunOrder("a", "run a", "a.zip", None, "", str(tmp_path / "a"), "")
    reanalyse_run(order, False, on_progress=lambda *_: None)
    outcome = json.loads((Path(order.folder) / "outcome.json").read_text())
    refused = {"family": "AlignmentError", "detail": "no line is found"}
    assert outcome["failure"] == refused
