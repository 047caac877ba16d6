from __future__ import annotations

import threading
import zipfile
from concurrent.futures import CancelledError
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arming import arm_at_once
from scripted_cell import wait_until

from truepath.catalogue.errors import Aborted, QueueFull
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import Verb
from truepath.errors import BundleError, NotFound
from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.run import Run
from truepath.jobs.dispatch import dispatcher as dispatching
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds import workflow
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.workers.workers import Workers
from truepath.machines.machine_cells import Machines
from truepath.measurement.run_file.run_reading import open_recorded
from truepath.motion.configurations import Configurations
from truepath.numerics.adaptive_trials import TrialPlan
from truepath_drivers.interfaces.records import TrackerSamples


@pytest.fixture
def bundle(machine, tmp_path):
    """A zipped bundle of a Run that has lost three samples."""
    sequence = np.array([0, 1, 2, 3, 7, 8, 9, 10, 11, 12])
    samples = TrackerSamples(
        sequence, sequence / 500.0, np.ones((10, 3)), np.zeros(10, np.int64)
    )
    points = Configurations(
        machine.axis_names, np.array([[1.0, 2.0, 3.0]]), np.array([1.0])
    )
    write_bundle(Run("b", machine, points, samples), tmp_path / "bundle")
    packed = tmp_path / "bundle.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for file in (tmp_path / "bundle").iterdir():
            archive.write(file, file.name)
    return packed


@pytest.fixture
def run(context, bundle):
    return context.runs.add_uploaded(bundle, "from the shop floor")


@pytest.fixture
def analysing(context, event_bus):
    """A dispatcher of a service without a machine."""
    dispatcher = Dispatcher(replace(context, machines=Machines()), event_bus)
    yield dispatcher
    dispatcher.close()


def test_an_uploaded_run_is_catalogued_with_what_it_holds(context, run, bundle):
    assert (run.name, run.origin, run.mode) == (
        "from the shop floor",
        "uploaded",
        "standstill",
    )
    assert (run.samples, run.lost_samples, run.complete) == (10, 3, True)
    assert run.plan["kind"] == "points"
    assert not bundle.exists()
    assert context.runs.bundle(run.id) == context.runs.file(run.id)
    assert len(open_recorded(context.runs.file(run.id)).tracker) == 10


def test_runs_come_newest_first_in_pages(context, bundle, tmp_path):
    kept = bundle.read_bytes()
    made = []
    for number in range(3):
        copy = tmp_path / f"copy{number}.zip"
        copy.write_bytes(kept)
        made.append(context.runs.add_uploaded(copy, str(number)))
    first = context.runs.list_page(2)
    rest = context.runs.list_page(2, before_seq=first[-1].seq)
    assert [run.id for run in first + rest] == [run.id for run in reversed(made)]


def test_a_run_whose_file_was_removed_is_not_found(context, run):
    context.runs.file(run.id).unlink()
    with pytest.raises(NotFound, match="has gone from the folder"):
        context.runs.file(run.id)


def test_an_uploaded_run_is_analysed(analysing, context, run, science):
    request = RequestedJob(JobKind.ANALYSE, run_ids=[run.id], perpendicular_only=True)
    job, _ = analysing.create(request)
    wait_until(lambda: context.store.get(job.id).is_final)
    ended = context.store.get(job.id)
    assert (ended.state, ended.run_id) == ("succeeded", run.id)
    assert science.calls == [
        ([str(context.runs.file(run.id))], str(context.results / job.id), True)
    ]


def test_several_runs_are_analysed_together(analysing, context, run, science, bundle):
    bundle.write_bytes(context.runs.file(run.id).read_bytes())
    other = context.runs.add_uploaded(bundle, "the other side")
    job, _ = analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[other.id, run.id]))
    wait_until(lambda: context.store.get(job.id).is_final)
    ended = context.store.get(job.id)
    assert (ended.run_id, ended.run_ids) == (other.id, (other.id, run.id))
    files = [str(context.runs.file(i)) for i in (other.id, run.id)]
    assert science.calls[0][0] == files


@pytest.mark.fault_row(26)
@pytest.mark.parametrize("kind", [JobKind.ANALYSE, JobKind.DISCOVER])
def test_a_run_whose_file_was_changed_is_not_analysed(
    analysing, context, run, science, bundle, kind
):
    bundle.write_bytes(context.runs.file(run.id).read_bytes())
    other = context.runs.add_uploaded(bundle, "the other side")
    file = context.runs.file(other.id)
    file.write_bytes(file.read_bytes() + b"changed")
    ids = [run.id, other.id]
    job, _ = analysing.create(RequestedJob(kind, run_ids=ids))
    wait_until(lambda: context.store.get(job.id).is_final)
    ended = context.store.get(job.id)
    assert ended.state == "failed"
    assert ended.failure.family == "BundleError"
    said = f"{file.name}: has been changed since it was catalogued"
    assert ended.failure.detail.startswith(said)
    assert "put the file back from a backup" in ended.failure.detail
    assert not science.calls


def test_one_unknown_run_of_several_is_refused(analysing, run):
    with pytest.raises(NotFound, match="no run nowhere"):
        analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id, "nowhere"]))


def test_trials_reach_the_science_with_who_computes_them(
    context, run, science, event_bus
):
    many = replace(context, machines=Machines(), workers=Workers(count=3))
    dispatcher = Dispatcher(many, event_bus)
    plan = TrialPlan(seed=11, digits=2, interval="shortest")
    job, _ = dispatcher.create(
        RequestedJob(JobKind.ANALYSE, run_ids=[run.id], monte_carlo=plan)
    )
    wait_until(lambda: context.store.get(job.id).is_final)
    assert context.store.get(job.id).monte_carlo == plan
    assert science.trials == [(plan, Workers(count=3))]
    dispatcher.close()


def test_an_analysis_of_an_unknown_run_is_refused(analysing):
    with pytest.raises(NotFound, match="no run nowhere"):
        analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=["nowhere"]))


def test_an_analysis_reports_its_stages(analysing, context, run, event_bus):
    heard = []
    event_bus.subscribe(heard.append)
    job, _ = analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    wait_until(lambda: context.store.get(job.id).is_final)
    stages = [n.body["stage"] for n in heard if n.type == "progress"]
    assert set(stages) == {"aligning", "estimating", "reporting"}


def test_a_stage_nobody_knows_leaves_the_stage_as_it_is(context, run, event_bus):
    def dreaming(run_files, folder, *_, on_progress):
        on_progress(0.5, "dreaming")

    alone = replace(context, science=dreaming, machines=Machines())
    dispatcher = Dispatcher(alone, event_bus)
    job, _ = dispatcher.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    wait_until(lambda: context.store.get(job.id).is_final)
    assert context.store.get(job.id).stage == "aligning"
    dispatcher.close()


def test_a_bad_bundle_fails_the_analysis_with_its_place(
    analysing, context, run, science
):
    science.raises = BundleError("is NaN", file="tracker.csv", row=7, column="x_mm")
    job, _ = analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    wait_until(lambda: context.store.get(job.id).is_final)
    failure = context.store.get(job.id).failure
    assert failure.family == "BundleError"
    assert failure.detail == "tracker.csv, row 7, column x_mm: is NaN"


def test_closing_queues_an_analysis_again(analysing, context, run, science):
    science.hold = threading.Event()
    job, _ = analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    wait_until(lambda: science.calls)
    analysing.close()
    queued = context.store.get(job.id)
    assert (queued.state, queued.attempts) == ("queued", 0)


def test_an_executor_that_ends_ends_the_job(analysing, context, run, science):
    science.raises = Aborted("the service is ending")
    job, _ = analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    wait_until(lambda: context.store.get(job.id).is_final)
    assert context.store.get(job.id).state == "aborted"


def test_more_jobs_than_can_wait_are_refused(
    analysing, run, science, monkeypatch, context
):
    monkeypatch.setattr(dispatching, "MAX_WAITING", 2)
    science.hold = threading.Event()
    jobs = [
        analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))[0]
        for _ in range(2)
    ]
    with pytest.raises(QueueFull, match="2 jobs are under way"):
        analysing.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    for job in jobs:
        analysing.abort(job.id)
    wait_until(lambda: all(context.store.get(job.id).is_final for job in jobs))


def test_a_measured_run_is_packed_once_as_a_bundle(context, run, dispatcher, make_cell):
    places = (1.0, 2.0, 3.0), (90.0, 2.0, 3.0), (1.0, 90.0, 3.0)
    rows = [dict(zip(("x_mm", "y_mm", "z_mm"), one, strict=True)) for one in places]
    job, _ = dispatcher.create(RequestedJob(JobKind.MEASURE_STANDSTILL, rows=rows))
    ready = wait_until(
        lambda: (now := context.store.get(job.id)).state == "ready" and now
    )
    arm_at_once(dispatcher, job.id, ready.version)
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    wait_until(lambda: context.store.get(job.id).is_final)
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


class _CancelledFuture:
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
def test_what_a_cancelled_job_trips_over_is_no_failure(
    context, run, event_bus, monkeypatch, verb
):
    """The future ends before the catalogue has taken the abort."""
    executor = SimpleNamespace(
        submit=lambda *_, started, **__: _CancelledFuture(started)
    )
    bare = replace(context, machines=Machines(), executor=executor)
    dispatcher, errors = Dispatcher(bare, event_bus), []
    monkeypatch.setattr(workflow.log, "error", lambda *told, **_: errors.append(told))
    job, _ = dispatcher.create(RequestedJob(JobKind.ANALYSE, run_ids=[run.id]))
    wait_until(lambda: context.store.get(job.id).state == "running")
    if verb == "abort":
        dispatcher._under_way.require(job.id, Verb.ABORT).abort()
    else:
        dispatcher.close()
    ended = "aborted" if verb == "abort" else "queued"
    wait_until(lambda: context.store.get(job.id).state == ended)
    assert context.store.get(job.id).failure is None
    assert errors == []
    dispatcher.close()
