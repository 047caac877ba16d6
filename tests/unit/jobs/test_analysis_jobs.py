"""Jobs that compute: what they are made of, their stages and how they end."""

import json
import threading
from concurrent.futures import CancelledError
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import pytest

from scripted_cell import Explorer, wait_until
from truepath.answers.machine_history import read_difference
from truepath.catalogue.errors import Aborted, QueueFull, TaskFailed
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State, Verb
from truepath.errors import AlignmentError, BundleError, NotFound
from truepath.jobs.dispatch import dispatcher as dispatching
from truepath.jobs.kinds import workflow
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.workers.analysis_tasks import discover_recorded, reanalyse_run
from truepath.jobs.workers.reanalysis import SUMMARY, RunOrder, store_outcome
from truepath.jobs.workers.workers import Workers
from truepath.machines.machine_cells import Machines
from truepath.measurement.run_file.run_loader import open_recorded
from truepath.numerics.adaptive_trials import TrialPlan


@pytest.fixture
def analysing(open_dispatcher):
    return open_dispatcher(machines=Machines())


@pytest.fixture
def analyse(analysing, run):
    def analyse(dispatcher=analysing, **request):
        request = {"run_ids": [run.id], **request}
        return dispatcher.create(RequestedJob(JobKind.ANALYSE, **request))[0]

    return analyse


@pytest.fixture
def other(context, run, bundle):
    bundle.write_bytes(context.runs.file(run.id).read_bytes())
    return context.runs.add_uploaded(bundle, "the other side")


def test_uploaded_runs_are_analysed_together_and_the_stages_are_told(
    analyse, context, run, other, science, event_bus, until, open_dispatcher
):
    heard = []
    event_bus.subscribe(heard.append)
    workers, plan = Workers(count=3), TrialPlan(seed=11, digits=2, interval="shortest")
    dispatcher = open_dispatcher(machines=Machines(), workers=workers)
    ids = [other.id, run.id]
    choices = {"perpendicular_only": True, "monte_carlo": plan}
    ended = until(analyse(dispatcher, run_ids=ids, **choices))
    assert (ended.state, ended.run_id) == ("succeeded", other.id)
    assert (ended.run_ids, ended.monte_carlo) == (tuple(ids), plan)
    files = [str(context.runs.file(i)) for i in ids]
    assert science.calls == [(files, str(context.results / ended.id), True)]
    assert science.trials == [(plan, workers)]
    stages = [n.body["stage"] for n in heard if n.type == "progress"]
    assert set(stages) == {"aligning", "estimating", "reporting"}
    assert (run.samples, run.lost_samples, run.complete) == (10, 3, True)


@pytest.mark.fault_row(26)
@pytest.mark.parametrize("kind", [JobKind.ANALYSE, JobKind.DISCOVER])
def test_a_changed_run_is_refused(analysing, context, run, other, science, until, kind):
    file = context.runs.file(other.id)
    file.write_bytes(file.read_bytes() + b"changed")
    ended = until(analysing.create(RequestedJob(kind, [run.id, other.id]))[0])
    assert (ended.state, ended.failure.family) == ("failed", "BundleError")
    said = f"{file.name}: has been changed since it was catalogued"
    assert ended.failure.detail.startswith(said)
    assert "put the file back from a backup" in ended.failure.detail
    assert not science.calls


def test_an_unknown_stage_leaves_the_stage_as_it_is(analyse, open_dispatcher, until):
    def dreaming(run_files, folder, *_, on_progress):
        on_progress(0.5, "dreaming")

    alone = open_dispatcher(science=dreaming, machines=Machines())
    assert until(analyse(alone)).stage == "aligning"


def test_a_bad_bundle_fails_and_an_end_ends_an_analysis(analyse, science, until):
    science.raises = BundleError("is NaN", file="tracker.csv", row=7, column="x_mm")
    failure = until(analyse(), "failed").failure
    assert failure.family == "BundleError"
    assert failure.detail == "tracker.csv, row 7, column x_mm: is NaN"
    science.raises = Aborted("the service is ending")
    until(analyse(), "aborted")


def test_a_job_too_many_is_refused(analysing, analyse, science, monkeypatch, until):
    monkeypatch.setattr(dispatching, "MAX_WAITING", 2)
    science.hold = threading.Event()
    jobs = [analyse() for _ in range(2)]
    with pytest.raises(QueueFull, match="2 jobs are under way"):
        analyse()
    for job in jobs:
        analysing.abort(job.id)
        until(job)


def test_a_standstill_run_is_packed_only_once(context, dispatcher, begin, cell, until):
    places = (1.0, 2.0, 3.0), (90.0, 2.0, 3.0), (1.0, 90.0, 3.0)
    points = [{"x_mm": x, "y_mm": y, "z_mm": z, "dwell_s": 0.5} for x, y, z in places]
    request = RequestedJob(JobKind.MEASURE_STANDSTILL, rows=points)
    job = begin(dispatcher.create(request)[0])
    assert cell.order.commanded.dwell_s.tolist() == [0.5] * 3
    cell.end()
    assert until(job, "succeeded").kind == "measure-standstill"
    assert context.runs.get(job.id).mode == "standstill"
    packed = context.runs.bundle(job.id)
    again = open_recorded(packed)
    assert len(again.tracker) == 50
    assert again.commanded.position.tolist() == [list(one) for one in places]
    before = packed.stat().st_mtime_ns
    assert context.runs.bundle(job.id).stat().st_mtime_ns == before


def test_what_interrupted_uploads_left_is_swept_away(context, analysing):
    left = context.runs.make_upload_file()
    assert left.is_file()
    analysing.interrupt_unfinished_jobs()
    assert not left.exists()


class _Cancelled:
    """A computation that ends as a future does that somebody has cancelled."""

    def __init__(self, started):
        self._started, self._cancelled = started, threading.Event()

    def result(self):
        self._started()
        assert self._cancelled.wait(5)
        raise CancelledError

    def cancel(self):
        self._cancelled.set()


@pytest.mark.parametrize("verb", ["abort", "close"])
def test_a_cancel_is_no_failure(context, analyse, open_dispatcher, monkeypatch, verb):
    """The future ends before the catalogue has taken the abort."""
    executor = SimpleNamespace(submit=lambda *_, started, **__: _Cancelled(started))
    dispatcher = open_dispatcher(machines=Machines(), executor=executor)
    errors = []
    monkeypatch.setattr(workflow.log, "error", lambda *told, **_: errors.append(told))
    job = analyse(dispatcher)
    wait_until(lambda: context.store.get(job.id).state == "running")
    if verb == "abort":
        dispatcher._active_jobs.require(job.id, Verb.ABORT).abort()
    else:
        dispatcher.close()
    ended = "aborted" if verb == "abort" else "queued"
    wait_until(lambda: context.store.get(job.id).state == ended)
    assert context.store.get(job.id).failure is None
    assert errors == []


def test_a_discovery_is_done_again_and_aborted(context, run, open_dispatcher, until):
    explorer = Explorer()
    explorer.hold = threading.Event()
    parts = {"machines": Machines(), "discoverer": explorer}
    discovering = open_dispatcher(**parts)
    job, _ = discovering.create(RequestedJob(JobKind.DISCOVER, [run.id]))
    wait_until(lambda: context.store.get(job.id).stage == "discovering")
    discovering.close()
    again = open_dispatcher(**parts)
    again.interrupt_unfinished_jobs()
    wait_until(lambda: len(explorer.calls) == 2)
    again.abort(job.id)
    assert not until(job, State.ABORTED).answer
    assert not (context.results / job.id).exists()


def test_the_task_of_a_discovery_writes_what_the_contract_asks(small_run, tmp_path):
    stages = []

    def discover(folder, *model):
        order = [str(small_run)], str(folder), *model
        discover_recorded(*order, on_progress=lambda *told: stages.append(told))

    first, second = tmp_path / "first", tmp_path / "second"
    model = first / "model.json"
    discover(first, None, None)
    discover(second, str(model), "one")
    assert {stage for _, stage in stages} == {"discovering", "reporting"}
    assert all(0.0 <= share <= 1.0 for share, _ in stages)
    content = json.loads((second / "model.json").read_text())
    assert (content["version"], content["parent"]["source"]) == (3, "one")
    assert len(content["parent"]["sha256"]) == 64
    assert read_difference(model, second / "model.json") == content["difference"]
    assert not [p for p in tmp_path.iterdir() if p.suffix == ".part"]


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
def reanalysing(open_dispatcher, analyst):
    return open_dispatcher(machines=Machines(), reanalyser=analyst)


def summary_of(context, job):
    return json.loads((context.results / job.id / SUMMARY).read_text())


@pytest.mark.database
def test_runs_are_analysed_failures_named(context, runs, reanalysing, analyst, until):
    analyst.failing, analyst.defects = {runs[3]}, {runs[4]}
    context.runs.file(runs[5]).unlink()
    job = until(reanalysing.create(RequestedJob(JobKind.REANALYSE, runs))[0])
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
    context, open_dispatcher, runs, reanalysing, analyst, until
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
    reanalysing.interrupt_unfinished_jobs()
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


def test_a_run_that_is_analysed_again_leaves_its_result_figures_and_time(
    small_run, tmp_path
):
    told = []
    order = RunOrder("a", "run a", str(small_run), None, "", str(tmp_path / "a"), "")
    reanalyse_run(order, False, on_progress=lambda *progress: told.append(progress))
    assert all(0.0 <= share <= 1.0 for share, _ in told)
    assert told[-1] == (1.0, "reporting")
    folder = Path(order.folder)
    assert "error_tables" in json.loads((folder / "result.json").read_text())
    outcome = json.loads((folder / "outcome.json").read_text())
    assert outcome["after"]["volumetric_error_um"] > 0.0
    assert outcome["took_s"] > 0.0
    assert "failure" not in outcome or outcome["failure"] is None


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
