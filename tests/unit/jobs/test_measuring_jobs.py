"""A measuring job from its creation to its end, over a cell that the test plays."""

import random
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from sqlalchemy import event, text

from job_builders import OBSERVED, OFF_THE_LINE, OTF, ROWS, arm_at_once
from scripted_cell import ScriptedLives, wait_until
from truepath.catalogue import database as databases
from truepath.catalogue import errors, transitions
from truepath.catalogue.job import EarlyEnd, Job, JobKind, decode_job
from truepath.catalogue.store import read_job
from truepath.errors import IllegalTransition, OutOfTravel, PlanningError
from truepath.files.bundle import commanded_file as files
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.jobs.kinds import workflow
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.running import active_job, cell_measurement
from truepath.jobs.running.live_estimation import LiveSteering
from truepath.kinematics.machine.machine import Target
from truepath.machines.conditions import NotInOrder
from truepath.measurement import messages
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost


@pytest.fixture
def running(begin, ready):
    return begin(ready)


@pytest.fixture
def paused(dispatcher, running, until):
    dispatcher.pause(running.id)
    return until(running, "paused")


def read_states(context):
    return [event.body["state"] for event in context.store.read_events_after(0)]


@pytest.mark.database
def test_a_target_ends_a_measurement_with_a_reason(
    open_dispatcher, begin, make_cell, until, context
):
    estimates = ScriptedLives()
    dispatcher = open_dispatcher(live=estimates)

    def followed(request):
        return begin(dispatcher.create(request)[0], dispatcher), estimates[-1]

    job, live = followed(replace(OTF, target_um=2.0))
    off = Verdict((OFF,))
    for sigma_um, verdict in ((0.001, off), (0.001, off), (2.1, None)):
        live.publish(sigma_um, done=4, verdict=verdict)
        make_cell.cell.record(50)
    live.publish(1.9, done=5)
    ended = until(job, "succeeded")
    assert make_cell.cell.heard == ["connect", "begin", "conclude"]
    assert ended.target_um == 2.0
    assert ended.early_end == EarlyEnd(1.9, 5, 10), "not of one that contradicts itself"
    assert live.heard[-2:] == ["finish", "close"]
    bodies = [event.body for event in context.store.read_events_after(0, job_id=job.id)]
    assert bodies[0]["early_end"] is None
    assert decode_job(bodies[-1]).early_end == EarlyEnd(1.9, 5, 10)
    job, live = followed(OTF)
    live.publish(0.001, done=9)
    make_cell.cell.record(50)
    make_cell.cell.end()
    ended = until(job, "succeeded")
    assert make_cell.cell.heard.count("conclude") == 1
    assert (ended.target_um, ended.early_end) == (None, None)


BY_UM = dict.fromkeys(("range_um", "azimuth_um", "elevation_um"), 9.0)
DIFFER = Reason("places-differ", "doubtful", {**BY_UM, "ratio": 5.0})
DRIFTS = Reason("loop-open", "doubtful", {"distance_um": 3.0, "limit_um": 1.0})
OFF = Reason("lines-off", "not-usable", {"lines": "4", "distance_um": 50.0})


@pytest.mark.parametrize(
    ("reasons", "heard"),
    [
        ((), [messages.CellVerb.CONCLUDE]),
        ((DIFFER,), [messages.CellVerb.CONCLUDE]),
        ((DIFFER, DRIFTS), []),
        ((OFF,), []),
    ],
)
def test_only_a_doubt_within_the_uncertainty_leaves_a_target_reached(reasons, heard):
    said = []
    verdict = verdict_json(Verdict(reasons))
    newest = {"volumetric_uncertainty_um": 1.9, "verdict": verdict}
    live, cell = SimpleNamespace(newest=newest), SimpleNamespace(send=said.append)
    LiveSteering(live, cell, None, 2.0, on_part=lambda *_: None).advance()
    assert said == heard


@pytest.mark.database
def test_a_job_goes_its_whole_way(dispatcher, context, running, cell, until, science):
    path, rows = cell.order.commanded, [*ROWS, OFF_THE_LINE]
    assert path.position.tolist() == [[row[f"{a}_mm"] for a in "xyz"] for row in rows]
    assert path.feed_mm_min.tolist()[1] == 1000.0
    cell.say(messages.LinesDamaged(3, None))
    cell.say(messages.MeasurementProgress(3, 9, "lines", "measuring", 4.0, 8.0, gaps=2))
    cell.end()
    job = until(running, "succeeded")
    assert cell.heard == ["connect", "begin"]
    assert (job.stage, job.failure, job.desired_state) == ("reporting", None, "running")
    health = job.health
    assert (health.samples, health.repeats, health.gaps) == (50, 1, 2)
    run = context.runs.get(job.run_id)
    assert (run.samples, run.lost_samples, run.complete) == (50, 0, True)
    files, folder = [str(context.runs.file(run.id))], str(context.results / job.id)
    assert science.calls == [(files, folder, False)]
    assert (context.results / job.id / "result.json").is_file()
    wait_until(lambda: dispatcher._active_jobs.get(job.id) is None)
    assert dispatcher.abort(job.id) == job
    with pytest.raises(IllegalTransition, match="a job that is succeeded"):
        dispatcher.resume(job.id, job.version)


def test_a_pause_holds_a_resume_by_version_goes_on(dispatcher, running, cell, until):
    assert dispatcher.pause(running.id).state == "pausing"
    paused = until(running, "paused")
    assert paused.desired_state == "paused"
    assert dispatcher.pause(running.id).version == paused.version
    with pytest.raises(errors.StaleVersion):
        dispatcher.resume(running.id, paused.version - 1)
    assert dispatcher.resume(running.id, paused.version).state == "resuming"
    until(running, "running")
    assert cell.heard == ["connect", "begin", "pause", "pause", "resume"]
    cell.end()
    until(running, "succeeded")


def test_a_hold_says_why_a_users_pause_outlasts_it(dispatcher, running, cell, until):
    cell.say_state("paused")
    assert until(running, "paused").failure is None
    cell.say_state("running")
    until(running, "running")
    cell.fault()
    cell.say_state("pausing")
    cell.say_state("paused")
    held = until(running, "paused")
    assert (held.failure.code, held.desired_state) == ("beam-lost", "running")
    assert "pause" not in cell.heard
    assert dispatcher.pause(running.id).desired_state == "paused"
    wait_until(lambda: "pause" in cell.heard, "the pause")


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_cells_stop_is_no_users_pause(running, cell, until, monkeypatch, confirmed):
    monkeypatch.setattr(cell_measurement, "REPEAT_S", 0.0)
    cell.fault("tracker-silent", "no sample", "nothing")
    cell.say_state("pausing")
    for _ in range(5):  # the job looks at its state before each of them
        cell.record(10)
    assert until(running, "pausing").desired_state == "running"
    if confirmed:
        cell.say_state("paused")
        cell.say_state("resuming")
    cell.say_state("running")
    wait_until(lambda: until(running, "running").failure is None, "all well again")
    assert "pause" not in cell.heard
    cell.end()
    until(running, "succeeded")


def test_what_moves_again_is_not_wanted_to_stand(paused, cell, until, monkeypatch):
    monkeypatch.setattr(cell_measurement, "REPEAT_S", 0.0)
    heard = cell.heard.count("pause")
    cell.say_state("running")  # somebody has released the machine at its panel
    assert until(paused, "running").desired_state == "running"
    cell.say_state("pausing")
    cell.record(10)
    cell.say_state("running")
    until(paused, "running")
    assert cell.heard.count("pause") == heard


def test_a_pause_that_came_early_is_repeated(dispatcher, context, running, cell, until):
    context.confirm_s["pausing"] = 8.0
    cell.deaf.add("pause")
    dispatcher.pause(running.id)
    cell.say_state("running")
    wait_until(lambda: cell.heard.count("pause") > 1, "a second pause")
    cell.deaf.clear()
    until(running, "paused")
    states = read_states(context)
    assert "running" not in states[states.index("pausing") :]


@pytest.mark.parametrize(
    ("verb", "deaf", "state"),
    [
        ("pause", {"pause"}, "pausing"),
        ("abort", {"abort"}, "aborting"),
        ("cancel", {"conclude", "abort"}, "aborting"),
    ],
)
def test_what_nobody_confirms_ends_the_cell_and_is_a_fault(
    clock, dispatcher, running, cell, make_cell, until, context, verb, deaf, state
):
    context.confirm_s["cancelling"] = -60.0  # the line that is planned takes some time
    cell.deaf |= deaf
    getattr(dispatcher, verb)(running.id)
    job = until(running, "faulted")
    assert job.failure.code == f"not-{state}"
    assert "watchdog" in job.failure.detail
    assert cell.closed
    assert context.runs.get(job.run_id).samples == 50
    wait_until(lambda: make_cell.cell is not cell, "another cell")


def test_a_refused_resume_stays_paused(dispatcher, paused, cell, until, context):
    cell.deaf.add("resume")
    for _ in range(3):
        version = context.store.get(paused.id).version
        assert dispatcher.resume(paused.id, version).state == "resuming"
        cell.fault("not-resumed", "no valid samples", "lock the beam")
        held = until(paused, "paused")
        assert held.desired_state == "paused"
    assert (held.failure.code, held.failure.action) == ("not-resumed", "lock the beam")
    cell.deaf.clear()
    dispatcher.resume(paused.id, held.version)
    until(paused, "running")
    wait_until(lambda: context.store.get(paused.id).failure is None, "all well again")
    cell.end()
    assert until(paused, "succeeded").failure is None


@pytest.mark.fault_row(34)
def test_a_cancel_ends_line_and_keeps_run(dispatcher, running, cell, until, science):
    assert dispatcher.cancel(running.id).state is transitions.State.CANCELLING
    ended = until(running, "cancelled")
    assert cell.heard == ["connect", "begin", "conclude"]
    assert (ended.run_id, ended.failure, science.calls) == (running.id, None, [])
    assert dispatcher.cancel(running.id) == ended


@pytest.mark.fault_row(34)
def test_a_cancel_overdue_is_an_abort(clock, dispatcher, running, cell, until, context):
    context.confirm_s["cancelling"] = 0.2
    cell.deaf.add("conclude")

    def is_stored():
        cell.record(1, line_s=0.3)
        return context.store.get(running.id).health.samples > 50

    wait_until(is_stored)
    begun_s = clock.time_s
    dispatcher.cancel(running.id)
    ended = until(running, "aborted")
    assert clock.time_s - begun_s >= 0.2 + 2 * 0.3
    assert ended.failure.code == "cancel-overdue"
    assert "the feed was held" in ended.failure.detail
    assert (cell.heard[-1], ended.run_id) == ("abort", running.id)


@pytest.mark.parametrize(
    ("moment", "heard"),
    [("ready", ["connect"]), ("paused", ["connect", "begin", "pause", "abort"])],
)
def test_what_stands_is_cancelled(request, dispatcher, cell, until, moment, heard):
    job = request.getfixturevalue(moment)
    dispatcher.cancel(job.id)
    assert until(job, "cancelled").run_id == (job.id if moment == "paused" else None)
    assert list(dict.fromkeys(cell.heard)) == heard


def test_an_abort_overtakes_a_cancel_that_takes_long(dispatcher, running, cell, until):
    cell.say_state("pausing")
    cell.deaf |= {"conclude"}
    dispatcher.cancel(running.id)
    dispatcher.abort(running.id)
    assert until(running, "aborted").desired_state == "aborted"
    with pytest.raises(IllegalTransition):
        arm_at_once(dispatcher, running.id, 99)


@pytest.mark.parametrize(("verb", "end"), [("cancel", "cancelled"), ("abort", None)])
def test_a_job_that_computes_cannot_be_paused_and_ends_at_once(
    dispatcher, running, cell, until, science, context, verb, end
):
    science.hold = threading.Event()
    cell.end()
    wait_until(lambda: science.calls, "the analysis")
    with pytest.raises(IllegalTransition, match="nothing moves any more"):
        dispatcher.pause(running.id)
    getattr(dispatcher, verb)(running.id)
    job = until(running, end or "aborted")
    assert job.run_id == running.id
    assert context.runs.get(job.run_id).complete
    assert not (context.results / job.id).exists()


@pytest.mark.fault_row(19)
def test_no_wrong_condition_lets_a_job_go_on(context, open_watched, until, begin, cell):
    seen = [OBSERVED]
    dispatcher = open_watched(lambda: seen[0])
    job = begin(dispatcher.create(OTF)[0], dispatcher)
    dispatcher.pause(job.id)
    held = until(job, "paused")
    seen[0] = replace(OBSERVED, free_bytes=0)
    with pytest.raises(NotInOrder, match="free"):
        dispatcher.resume(job.id, held.version)
    assert context.store.get(job.id) == held
    assert "resume" not in cell.heard
    seen[0] = OBSERVED
    dispatcher.resume(job.id, held.version)
    until(job, "running")


@pytest.mark.parametrize("moment", ["ready", "running", "paused"])
def test_abort_works_at_any_moment_and_keeps_what_was_recorded(
    request, dispatcher, make_cell, until, context, moment
):
    job = request.getfixturevalue(moment)
    # Where nothing has to stand first, it may have ended by then.
    assert dispatcher.abort(job.id).state in ("aborting", "aborted")
    job = until(job, "aborted")
    assert (job.desired_state, job.failure) == ("aborted", None)
    assert dispatcher.abort(job.id).version == job.version
    if moment == "ready":
        assert "begin" not in make_cell.cell.heard
        assert job.run_id is None
    else:
        run = context.runs.get(job.run_id)
        assert (run.samples, run.complete) == (50, False)


def test_abort_in_preparation_never_gets_ready(dispatcher, until, make_cell, context):
    hold = threading.Event()
    connect = make_cell.cell.connect
    make_cell.cell.connect = lambda: hold.wait(5) and connect()
    job, _ = dispatcher.create(OTF)
    until(job, "preparing")
    dispatcher.abort(job.id)
    hold.set()
    until(job, "aborted")
    assert "ready" not in read_states(context)


def test_an_abort_upon_arming_ends_what_it_begins(dispatcher, ready, make_cell, until):
    arm_at_once(dispatcher, ready.id, ready.version)
    dispatcher.abort(ready.id)
    until(ready, "aborted")
    heard = make_cell.cell.heard
    assert "begin" not in heard or heard.index("abort") > heard.index("begin")


def test_stop_ends_motion_alone(dispatcher, running, cell, until, science, context):
    cell.end()
    first = until(running, "succeeded")
    science.hold = threading.Event()
    request = RequestedJob(JobKind.ANALYSE, run_ids=[first.run_id])
    computing, _ = dispatcher.create(request)
    wait_until(lambda: len(science.calls) == 2)
    ready = until(dispatcher.create(OTF)[0], "ready")
    assert [job.id for job in dispatcher.stop()] == [ready.id]
    until(ready, "aborted")
    assert context.store.get(computing.id).state == "running"
    science.hold.set()
    until(computing, "succeeded")


def test_stop_reaches_the_cell_even_if_no_job_is_under_way(dispatcher, cell):
    assert dispatcher.stop() == []
    wait_until(lambda: cell.heard == ["abort"], "the abort")


@pytest.mark.parametrize(
    ("end", "fault"),
    [
        ("aborted", None),
        ("failed", ("storage", "the disk is full", "free some space")),
        ("faulted", ("motion-alarm", "servo alarm", "clear it")),
    ],
)
def test_a_job_ends_with_its_cells_reason(running, cell, until, context, end, fault):
    if fault is not None:
        cell.fault(*fault)
    cell.end(end)
    job = until(running, end)
    failure = job.failure
    assert fault == (failure and (failure.code, failure.detail, failure.action))
    assert not context.runs.get(job.run_id).complete


def test_a_cell_that_closes_without_a_word_fails_the_job(running, cell, until):
    recorder, cell._recorder = cell._recorder, None
    recorder.close("finished")
    cell.say(messages.RunClosed("", messages.CellState.FAILED, 50))
    assert "without saying why" in until(running, "failed").failure.detail


def send_nonsense(cell):
    cell.poll = Mock(side_effect=ValueError("a message that nobody can read"))


@pytest.mark.parametrize("harm", [lambda cell: cell.die(), send_nonsense])
def test_a_cell_that_dies_or_trips_over_a_defect_faults_the_job_and_is_replaced(
    running, cell, make_cell, until, context, dispatcher, harm
):
    harm(cell)
    job = until(running, "faulted")
    assert job.failure.code == "cell-died"
    run = context.runs.get(job.run_id)
    assert (run.samples, run.complete) == (50, False)
    wait_until(lambda: make_cell.cell is not cell, "another cell")
    assert cell.closed
    until(dispatcher.create(OTF)[0], "ready")


def test_a_device_out_of_reach_fails_the_job_at_once(dispatcher, make_cell, until):
    make_cell.cell.refuses = ConnectionLost("no such port")
    failure = until(dispatcher.create(OTF)[0], "failed").failure
    assert (failure.family, failure.detail) == ("ConnectionLost", "no such port")


def test_an_unreadable_run_is_kept_and_fails_an_analysis(running, cell, until, context):
    cell.end(spoil=b"no database at all")
    file = context.runs.name_run_file(running.id)
    job = until(running, "failed")
    assert (job.run_id, job.failure.family) == (None, "NotFound")
    assert file.is_file()


def test_a_path_that_cannot_be_driven_is_refused_and_makes_no_job(dispatcher, context):
    first, last = ROWS
    to_and_fro = [{**first, "x_mm": float(n % 2)} for n in range(4097)]
    for rows, problem in (
        ([{"x_mm": 1.0, "y_mm": 2.0}], "row 1: z_mm is missing"),
        ([first, {**last, "a_deg": 3.0}], "row 2: a_deg is no axis"),
        ([first], "at least two rows"),
        ([first, first], "row 2: the line starts where it ends"),
        ([{**row, "target": "T9"} for row in ROWS], "row 1: target 'T9' is unknown"),
        ([first, {**last, "x_mm": 9999.0}], "row 2: X = 9999 mm exceeds 500 mm"),
        (to_and_fro, "4097 rows; a controller takes 4096"),
    ):
        error = OutOfTravel if "exceeds" in problem else PlanningError
        with pytest.raises(error, match=problem):
            dispatcher.create(replace(OTF, rows=rows))
    assert context.store.list_page(10) == []


@pytest.mark.parametrize(
    ("request_", "kind", "feeds"),
    [
        (RequestedJob(JobKind.MEASURE_OTF, feed_mm_min=1234.0), "path", {1234.0}),
        (RequestedJob(JobKind.MEASURE_STANDSTILL), "points", set()),
    ],
)
def test_the_default_is_measured(dispatcher, context, until, request_, kind, feeds):
    job, _ = dispatcher.create(request_)
    until(job, "ready")
    plan = context.store.read_plan(job.id)
    assert plan["kind"] == kind
    assert len(plan["position"]) > 10
    assert set(plan["feed_mm_min"]) == feeds


def test_closing_stops_motion_first_then_the_job(dispatcher, running, cell, context):
    dispatcher.close()
    assert "abort" in cell.heard
    job = context.store.get(running.id)
    assert job.state == "interrupted"
    assert context.runs.get(job.run_id).samples == 50
    with pytest.raises(errors.CellDown, match="ending"):
        dispatcher.create(OTF)


@pytest.mark.database
def test_after_a_restart_all_is_interrupted(open_dispatcher, running, cell, context):
    """The catalogue as a killed service leaves it: the job runs, the Run is torn."""
    cell.tear()
    heard = list(cell.heard)
    after = open_dispatcher()
    after.interrupt_unfinished_jobs()
    job = context.store.get(running.id)
    assert (job.state, job.failure.family) == ("interrupted", "Interrupted")
    assert "was running" in job.failure.detail
    assert context.runs.get(job.run_id).samples == 50
    assert cell.heard == heard
    after.interrupt_unfinished_jobs()
    assert context.store.get(running.id).version == job.version
    cell.die()


def test_progress_and_views_are_told_not_kept(event_bus, running, cell, context, until):
    heard = []
    forget = event_bus.subscribe(heard.append)

    def told():
        # At most ten a second are passed on.
        cell.record(10)
        found = [n for n in heard if n.type == "progress"]
        return [n for n in found if n.body["health"]["samples"] > 50]

    notice = wait_until(told)[-1]
    forget()
    assert {n.type for n in heard} == {"progress", "live"}
    assert notice.job_id == running.id
    assert list(notice.body["progress"]["position"]) == [1.0, 2.0, 3.0]
    assert {e.type for e in context.store.read_events_after(0)} == {"job"}
    count = len(heard)
    cell.end()
    assert until(running, "succeeded").health.samples > 50
    assert len(heard) == count


@contextmanager
def locked(store):
    database = store._database
    with database.engine.connect() as raw:
        connection = raw.execution_options(truepath_writes=True)
        locks_whole = connection.dialect.name == "sqlite"  # by its first statement
        lock = "LOCK TABLE jobs, events IN EXCLUSIVE MODE"
        with database._writer:  # once nobody writes
            connection.execute(text("SELECT 1" if locks_whole else lock))
        yield
        connection.rollback()


@pytest.mark.database
@pytest.mark.fault_row(37)
def test_a_catalogue_that_is_locked_does_not_stop_an_abort(
    clock, dispatcher, running, cell, context, until, measured
):
    """The machine is told first; the books follow when they can."""
    with locked(context.store):
        begun_s = clock.time_s
        (answered,) = dispatcher.stop()
        took_s = clock.time_s - begun_s
        assert took_s < 4.0
        measured(f"catalogue locked: stop answered after {took_s:.2f} s")
        assert answered.id == running.id
        wait_until(lambda: "abort" in cell.heard, "the abort")
    assert until(running).state == "aborted"


@pytest.mark.database
@pytest.mark.fault_row(37)
def test_no_lock_stops_a_pause(clock, dispatcher, running, cell, context, until):
    with locked(context.store):
        asks = threading.Thread(target=dispatcher.pause, args=(running.id,))
        asks.start()
        wait_until(lambda: "pause" in cell.heard, "the pause")
        assert asks.is_alive()  # its answer waits for the books
    asks.join()
    assert until(running, "paused").wants_pause
    dispatcher.resume(running.id, context.store.get(running.id).version)
    until(running, "running")


@pytest.fixture
def full(context):
    """While it is set, the disk of the catalogue has no room left."""
    engine, full = context.store._database.engine, threading.Event()

    def refuse(connection, cursor, statement, *_):
        if full.is_set() and not statement.startswith(("SELECT", "BEGIN", "PRAGMA")):
            raise engine.dialect.loaded_dbapi.OperationalError("the disk is full")

    event.listen(engine, "before_cursor_execute", refuse)
    yield full
    full.clear()
    event.remove(engine, "before_cursor_execute", refuse)


def test_a_pause_that_cannot_be_stored_is_insisted_on(
    dispatcher, running, cell, until, full, monkeypatch, context
):
    monkeypatch.setattr(cell_measurement, "REPEAT_S", 0.01)
    wait_until(lambda: context.store.get(running.id).health.samples, "the first ones")
    cell.deaf.add("pause")
    full.set()
    with pytest.raises(errors.StorageUnavailable):
        dispatcher.pause(running.id)
    wait_until(lambda: cell.heard.count("pause") > 2, "a repetition")
    full.clear()
    cell.deaf.clear()
    dispatcher.resume(running.id, until(running, "paused").version)
    until(running, "running")
    assert cell.heard[-1] == "resume"


@pytest.mark.parametrize("obeys", [True, False])
def test_a_catalogue_that_fails_while_the_machine_moves_stops_it_or_ends_the_cell(
    running, cell, until, full, context, monkeypatch, obeys
):
    monkeypatch.setattr(cell_measurement, "CLOSE_RUN_S", 30.0 if obeys else 0.2)
    if not obeys:
        cell.deaf.add("abort")
    full.set()
    cell.say_state("paused")
    wait_until(lambda: cell.heard[-1] == "abort", "the abort")
    wait_until(lambda: obeys or cell.closed, "the end of the cell")
    full.clear()
    assert until(running, "failed").failure.family == "StorageFull"
    if obeys:  # its Run may have closed before there was room for it
        wait_until(lambda: context.runs.find([running.id]))
        assert context.runs.get(running.id).samples == 50


def test_an_end_not_stored_waits_for_the_next_start(dispatcher, running, full, context):
    full.set()
    dispatcher.close()
    assert context.store.get(running.id).state == "running"
    full.clear()
    dispatcher.interrupt_unfinished_jobs()
    assert context.store.get(running.id).state == "interrupted"


@pytest.mark.database
@pytest.mark.fault_row(27)
def test_a_full_disk_is_shown_at_once_and_the_job_ends_when_there_is_room(
    dispatcher, running, cell, until, full, context, event_bus, measured
):
    heard = []
    forget = event_bus.subscribe(heard.append)
    full.set()
    begun = time.monotonic()
    cell.say_state("paused")

    def shown():
        job = dispatcher.show(context.store.get(running.id))
        return job if job.state == "failed" else None

    job = wait_until(shown)
    took_s = time.monotonic() - begun
    assert took_s < 5.0
    measured(f"shown after {took_s:.2f} s")
    assert job.failure.family == "StorageFull"
    assert "disk is full" in job.failure.detail
    with context.store._database.read() as connection:
        assert read_job(connection, running.id).state == "running"
    told = [e.body for e in heard if e.type == "job" and e.id is None]
    assert told[-1]["state"] == "failed"
    full.clear()
    assert until(running, "failed").failure.family == "StorageFull"
    wait_until(lambda: context.store.get(running.id).run_id)
    forget()


VERBS = {
    "stop": lambda d, job: d.stop()[0],
    "stop machine": lambda d, job: d.stop(job.machine)[0],
    "abort": lambda d, job: d.abort(job.id),
    "cancel": lambda d, job: d.cancel(job.id),
    "pause": lambda d, job: d.pause(job.id),
    "resume": lambda d, job: d.resume(job.id, job.version),
    "prepare": lambda d, job: d.prepare_arming(job.id),
    "arm": lambda d, job: d.arm(job.id, job.version, "token"),
    "acknowledge": lambda d, job: d.acknowledge(job.id),
    "take control": lambda d, job: d.take_control(job.id, "anna"),
}


@pytest.mark.database
@pytest.mark.fault_row(48)
@pytest.mark.parametrize("end", ["failed", "faulted", "aborted"])
def test_a_job_that_has_ended_stays_so_whatever_is_asked_and_cannot_be_stored(
    clock, dispatcher, running, cell, until, full, context, monkeypatch, end
):
    monkeypatch.setattr(workflow, "TRY_AGAIN_S", 0.05)
    store = context.store

    def read_states():
        found = {dispatcher.show(store.get(running.id)).state}
        found |= {dispatcher.show(job).state for job in store.list_page(9)}
        found |= {state for (_, state), n in store.count_by_state().items() if n}
        assert store.list_unfinished() == []
        assert store.list_page(9, states=["running", "aborting", "paused"]) == []
        assert [job.id for job in store.list_page(9, states=[end])] == [running.id]
        return found

    full.set()
    if end == "failed":
        cell.say_state("paused")
    else:
        cell.end(end)
    wait_until(lambda: dispatcher.show(store.get(running.id)).state == end, end)
    refusals = IllegalTransition, errors.NotResumable, errors.StorageUnavailable
    for verb in random.Random(end).sample([*VERBS] * 2, 2 * len(VERBS)):
        with suppress(*refusals):
            answered = VERBS[verb](dispatcher, running)
            shown = answered[0] if isinstance(answered, tuple) else answered
            assert shown.state == end, verb
        assert read_states() == {end}, verb
        host_clock.sleep_s(0.01)
    full.clear()
    until(running, end)
    assert read_states() == {end}


@pytest.mark.fault_row(48)
@pytest.mark.parametrize("stopped_before", [True, False])
def test_a_machine_that_stands_elsewhere_is_a_fault_unless_a_stop_came_before(
    dispatcher, running, cell, until, context, stopped_before
):
    """A frozen cell hears the stop late."""
    cell.deaf.add("abort")
    if stopped_before:
        dispatcher.stop()
    cell.fault("ended-early", "the controller is aborted at X 3.000")
    if not stopped_before:
        wait_until(lambda: context.store.get(running.id).failure)
        dispatcher.stop()
    cell.end("faulted")
    job = until(running, "aborted" if stopped_before else "faulted")
    assert job.desired_state == "aborted"
    code = None if stopped_before else "ended-early"
    assert code == (job.failure and job.failure.code)


@pytest.mark.database
def test_progress_that_cannot_be_kept_is_shown_and_does_not_stop_the_measurement(
    dispatcher, running, cell, context, full, until, monkeypatch
):
    monkeypatch.setattr(active_job, "STORE_EVERY_S", 0.0)

    def shown():
        cell.record(10)
        return dispatcher.show(context.store.get(running.id)).failure

    full.set()
    assert wait_until(shown).family == "StorageFull"
    full.clear()
    wait_until(lambda: shown() is None)
    assert dispatcher.show(context.store.get(running.id)).state == "running"
    cell.end()
    assert until(running, "succeeded").health.samples == cell._samples


def test_a_full_disk_is_logged_only_once(running, cell, until, full, monkeypatch):
    monkeypatch.setattr(workflow, "TRY_AGAIN_S", 0.005)
    lines, tries = [], []
    for module in (active_job, workflow, databases):
        for level in ("warning", "exception"):
            monkeypatch.setattr(module.log, level, lambda text, **_: lines.append(text))
    full.set()
    store_end = active_job.ActiveJob.end

    def count(*given):
        tries.append(1)
        return store_end(*given)

    monkeypatch.setattr(active_job.ActiveJob, "end", count)
    cell.say_state("paused")
    wait_until(lambda: len(tries) > 20)
    full.clear()
    until(running, "failed")
    assert 1 <= lines.count("job not stored") <= 2
    assert len(lines) <= 4


def test_a_run_not_closed_in_time_is_a_fault(clock, running, cell, until, monkeypatch):
    monkeypatch.setattr(cell_measurement, "CLOSE_RUN_S", 0.2)
    cell.say_state("finished")
    assert until(running, "faulted").failure.code == "run-not-closed"


def test_a_torn_run_that_cannot_be_read_does_not_stop_the_sweep(dispatcher, context):
    job, _ = context.store.create(Job(JobKind.MEASURE_OTF), plan={})
    context.runs.name_run_file(job.id).write_bytes(b"no database at all")
    dispatcher.interrupt_unfinished_jobs()
    job = context.store.get(job.id)
    assert (job.state, job.run_id) == ("interrupted", None)


def test_a_job_that_is_created_as_the_service_ends_never_begins(dispatcher, context):
    create = context.store.create

    def late(*arguments):
        dispatcher.close()
        return create(*arguments)

    context.store.create = late
    job, _ = dispatcher.create(OTF)
    assert context.store.get(job.id).state == "queued"
    dispatcher.interrupt_unfinished_jobs()
    assert context.store.get(job.id).state == "interrupted"


def test_the_targets_of_rows_are_the_machines(machine):
    offsets = {"T1": 0, "T2": 50}
    targets = tuple(Target(name, "tool", (0, 0, z)) for name, z in offsets.items())
    two = replace(machine, targets=targets)
    rows = [{**ROWS[0], "target": name} for name in offsets]
    path = command_rows(two, rows, is_path=True)
    assert path.target == ("T1", "T2")
    again = files.decode_commanded_json(files.encode_commanded_json(path))
    assert again.target == ("T1", "T2")
    with pytest.raises(PlanningError, match="row 1: target '' is unknown"):
        command_rows(two, [ROWS[0], rows[1]], is_path=True)
