"""Files and catalogue, brought together again after a full disk or a stopped cell."""

import threading
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import pytest

import job_builders
from scripted_cell import wait_until
from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.job_changes import requeue
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition
from truepath.jobs.dispatch import reconciliation as reconciling
from truepath.jobs.dispatch.reconciliation import Reconciliation
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.machines.machine_cells import Machines
from truepath.measurement.run_file import run_file


@pytest.fixture
def begin_run(context, machine):
    return partial(job_builders.begin_run, context.runs, machine)


@pytest.fixture
def ended(context):
    job, _ = context.store.create(Job(JobKind.MEASURE_OTF))
    return context.store.change(job.id, lambda job: replace(job, state=State.FAILED))


@pytest.fixture
def reconciliation(context):
    return Reconciliation(context, lambda: False, every_s=0.01)


@pytest.mark.database
def test_a_run_on_disk_joins_its_job_once(context, ended, begin_run, reconciliation):
    begin_run(ended.id).close("failed")
    reconciliation.start()
    try:
        joined = wait_until(lambda: (job := context.store.get(ended.id)).run_id and job)
    finally:
        reconciliation.close()
    assert (joined.run_id, joined.state) == (ended.id, State.FAILED)
    reconciliation.repair()
    assert context.store.get(ended.id).version == joined.version
    assert len(context.runs.list_page(9)) == 1


@pytest.mark.parametrize("is_catalogued", [True, False])
def test_a_run_that_its_job_does_not_name_is_named_at_the_next_start(
    context, ended, begin_run, open_dispatcher, is_catalogued
):
    """The catalogue took the row of the Run, and then no more, or not even that."""
    begin_run(ended.id).close("failed")
    if is_catalogued:
        context.runs.add_measured(ended.id)
    dispatcher = open_dispatcher()
    dispatcher.interrupt_unfinished_jobs()
    joined = context.store.get(ended.id)
    assert (joined.run_id, joined.state) == (ended.id, State.FAILED)
    dispatcher.interrupt_unfinished_jobs()
    assert context.store.get(ended.id).version == joined.version


def test_nothing_is_touched_in_motion(context, ended, begin_run, dispatcher, until):
    begin_run(ended.id).close("failed")
    reconciliation = Reconciliation(context, lambda: dispatcher.is_measuring)
    job, _ = dispatcher.create(job_builders.OTF)
    reconciliation.repair()
    assert context.runs.list_page(9) == []
    dispatcher.abort(job.id)
    until(job, State.ABORTED)
    wait_until(lambda: not dispatcher.is_measuring)


@pytest.mark.fault_row(27)
def test_a_run_that_a_stopped_cell_held_open_is_catalogued_once_it_is_free(
    context, ended, begin_run, open_dispatcher, monkeypatch
):
    monkeypatch.setattr(run_file, "BUSY_TIMEOUT_MS", 50)
    stopped = begin_run(ended.id)
    stopped.event("note", "the cell stands still and has its file open")
    open_dispatcher().interrupt_unfinished_jobs()
    assert context.store.get(ended.id).run_id is None
    stopped.close("aborted")
    Reconciliation(context, lambda: False).repair()
    assert context.store.get(ended.id).run_id == ended.id


@pytest.mark.database
def test_a_further_stations_run_joins_its_job(context, begin_run, reconciliation):
    plan = {"kind": "path", "stations": [{"run_id": "one"}, {"run_id": "two"}]}
    job, _ = context.store.create(Job(JobKind.MEASURE_OTF), plan=plan)
    context.store.change(job.id, lambda job: replace(job, state=State.FAILED))
    for run_id in ("one", "two", "points"):
        begin_run(run_id, job.id).close("finished")
        reconciliation.repair()
    found = context.store.get(job.id)
    assert (found.run_id, found.further_run_ids) == ("one", ("two",))
    assert context.runs.find(["points"])


def test_a_catalogue_that_does_not_answer_ends_nothing_and_a_foreign_run_stands_alone(
    context, ended, begin_run, reconciliation, monkeypatch
):
    begin_run(ended.id).close("failed")
    begin_run("foreign").close("finished")
    with monkeypatch.context() as locked:
        refuse = Mock(side_effect=StorageUnavailable("locked"))
        locked.setattr(type(context.runs), "list_uncatalogued", refuse)
        reconciliation.repair()
    reconciliation.repair()
    assert context.store.get(ended.id).run_id == ended.id
    assert context.runs.get("foreign").complete


def test_what_is_no_run_is_told_once(context, reconciliation, monkeypatch, hand_clock):
    context.runs.name_run_file("garbage").write_bytes(b"no database at all" * 99)
    told, read = [], Mock(side_effect=context.runs.read_measured)
    monkeypatch.setattr(type(context.runs), "read_measured", read)
    monkeypatch.setattr(reconciling.log, "warning", lambda text, **_: told.append(text))
    patient = Reconciliation(context, lambda: False, every_s=30.0)
    for hand_clock.time_s in range(0, 3600, 30):
        patient.repair()
    assert len(told) == 1
    assert 4 < read.call_count < 12
    assert context.runs.name_run_file("garbage").is_file()


def test_a_pass_reads_few_runs(context, begin_run, reconciliation):
    for number in range(reconciling.MOST_RUNS + 1):
        begin_run(f"r{number}").close("finished")
    reconciliation.repair()
    assert len(context.runs.list_page(99)) == reconciling.MOST_RUNS
    reconciliation.repair()
    assert len(context.runs.list_page(99)) == reconciling.MOST_RUNS + 1


@pytest.fixture
def run_id(begin_run, context):
    begin_run("measured").close("finished")
    return context.runs.add_measured("measured").id


@pytest.fixture
def restart(open_dispatcher):
    def make():
        dispatcher = open_dispatcher(machines=Machines())
        dispatcher.interrupt_unfinished_jobs()
        return dispatcher

    return make


def leave(context, run_id, state, attempts):
    """Leave a job in the catalogue as a killed service does."""
    job, _ = context.store.create(Job(JobKind.ANALYSE, run_id=run_id))
    if state is State.QUEUED:
        return job
    for now in (State.RUNNING, state):
        change = {"state": now, "attempts": attempts}
        job = context.store.change(job.id, lambda job, to=change: replace(job, **to))
    return job


@pytest.mark.database
@pytest.mark.fault_row(25)
def test_what_a_kill_left_is_done_at_restart(context, run_id, restart, science, until):
    aborting = leave(context, run_id, State.ABORTING, 1)
    jobs = [leave(context, run_id, State.QUEUED, 0) for _ in range(2)]
    jobs.append(leave(context, run_id, State.RUNNING, 1))
    restart()
    assert context.store.get(aborting.id).state is State.ABORTED
    assert [until(job, State.SUCCEEDED).attempts for job in jobs] == [1, 1, 2]
    assert len(science.calls) == 3
    for job in jobs:
        assert (context.results / job.id / "result.json").is_file()


def test_queued_again_in_order_is_no_attempt(context, run_id, restart, science, until):
    first = restart()
    science.hold = threading.Event()
    job, _ = first.create(RequestedJob(JobKind.ANALYSE, run_ids=[run_id]))
    for number in range(1, 4):
        wait_until(lambda n=number: len(science.calls) == n)
        first.close()
        queued = context.store.get(job.id)
        assert (queued.state, queued.attempts) == (State.QUEUED, 0)
        first = restart()
    science.hold.set()
    assert until(job, State.SUCCEEDED).attempts == 1


@pytest.mark.fault_row(38)
def test_a_job_that_kills_the_service_is_given_up(context, run_id, restart, science):
    job = leave(context, run_id, State.RUNNING, 2)
    restart()
    given_up = context.store.get(job.id)
    assert given_up.state is State.FAILED
    assert given_up.failure.family == "GivenUp"
    assert "ended 2 times" in given_up.failure.detail
    assert science.calls == []


def test_a_plan_that_stood_already_is_not_planned_again(context, restart, until):
    """Killed between the plan and its end."""
    job, _ = context.store.create(Job(JobKind.PLAN))
    context.store.store_plan(job.id, {"kind": "path", "rows": []})
    begun = {"state": State.RUNNING, "attempts": 1}
    context.store.change(job.id, lambda job: replace(job, **begun))
    restart()
    assert until(job, State.SUCCEEDED).attempts == 2


def test_a_measurement_is_never_queued_again(context):
    job, _ = context.store.create(Job(JobKind.MEASURE_OTF))
    context.store.change(job.id, lambda job: replace(job, state=State.RUNNING))
    with pytest.raises(IllegalTransition, match="measures; it is not begun again"):
        context.store.change(job.id, requeue)
    assert context.store.get(job.id).state is State.RUNNING
