"""A measuring job from its creation to its end, over a cell that the test plays."""

from __future__ import annotations

import random
import threading
import time
from contextlib import suppress
from dataclasses import replace

import pytest
from arming import arm_at_once
from scripted_cell import ScriptedLive, wait_until
from sqlalchemy import Connection, event, text

from truepath.catalogue.errors import (
    CellBusy,
    CellDown,
    NoMachine,
    NotResumable,
    StaleVersion,
    StorageUnavailable,
)
from truepath.catalogue.job import EarlyEnd, Job, JobKind, decode_job
from truepath.catalogue.store import database as databases
from truepath.catalogue.store.idempotency import IdempotencyKey
from truepath.catalogue.store.job_rows import read_job
from truepath.catalogue.transitions import FINAL, State, Verb
from truepath.errors import IllegalTransition, NotFound, OutOfTravel, PlanningError
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds import workflow
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.running import active_job, cell_measurement
from truepath.kinematics.machine.machine import Target
from truepath.machines.cell_status import CellStatus, ControllerLevels
from truepath.machines.conditions.condition_board import ConditionBoard
from truepath.machines.conditions.conditions import ConditionType, NotInOrder, Observed
from truepath.machines.machine_cells import Machines
from truepath.measurement.messages import (
    CellState,
    LinesDamaged,
    MeasurementProgress,
    RunClosed,
)
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.interfaces.records import MotionState, MotionStatus

ROWS = (
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0},
    {"x_mm": 400.0, "y_mm": 300.0, "z_mm": 200.0, "feed_mm_min": 1000.0},
)
OFF_THE_LINE = {"x_mm": 100.0, "y_mm": 350.0, "z_mm": 50.0}
OTF = RequestedJob(JobKind.MEASURE_OTF, rows=(*ROWS, OFF_THE_LINE))
STANDSTILL = RequestedJob(JobKind.MEASURE_STANDSTILL)


@pytest.fixture
def ready(dispatcher, until):
    """A job that waits to be armed."""
    job, _ = dispatcher.create(OTF)
    return until(job, "ready")


@pytest.fixture
def running(dispatcher, ready, make_cell):
    """A job whose machine moves."""
    job = arm_at_once(dispatcher, ready.id, ready.version)
    assert make_cell.cell.begun.wait(5)
    return job


@pytest.fixture
def followed(context, event_bus, make_cell, until):
    """Run a job to its motion with a live estimate; return both."""
    estimates = []

    def live(order, show):
        estimates.append(ScriptedLive(order, show))
        return estimates[-1]

    context.require_cell().start()
    dispatcher = Dispatcher(replace(context, live=live), event_bus)

    def begin(request):
        job, _ = dispatcher.create(request)
        arm_at_once(dispatcher, job.id, until(job, "ready").version)
        assert make_cell.cell.begun.wait(5)
        return job, estimates[-1]

    yield begin
    dispatcher.close()


def test_a_measurement_says_why_it_ended_at_its_target(followed, make_cell, until):
    job, live = followed(replace(OTF, target_um=2.0))
    live.publish(2.1, done=4)
    make_cell.cell.record(50)
    live.publish(1.9, done=5)
    ended = until(job, "succeeded")
    assert make_cell.cell.heard == ["connect", "begin", "conclude"]
    assert ended.target_um == 2.0
    assert ended.early_end == EarlyEnd(1.9, 5, 10)
    assert live.heard[-2:] == ["finish", "close"]


def test_an_estimate_that_contradicts_itself_ends_nothing(followed, make_cell, until):
    job, live = followed(replace(OTF, target_um=2.0))
    values = {"lines": "4", "distance_um": 50.0}
    off = Verdict((Reason("lines-off", "not-usable", values),))
    live.publish(0.001, done=3, verdict=off)
    make_cell.cell.record(50)
    live.publish(0.001, done=3, verdict=off)
    make_cell.cell.record(50)
    live.publish(1.9, done=5)
    assert until(job, "succeeded").early_end == EarlyEnd(1.9, 5, 10)


def test_a_measurement_without_a_target_goes_to_its_end(followed, make_cell, until):
    job, live = followed(OTF)
    live.publish(0.001, done=9)
    make_cell.cell.record(50)
    make_cell.cell.end()
    ended = until(job, "succeeded")
    assert "conclude" not in make_cell.cell.heard
    assert (ended.target_um, ended.early_end) == (None, None)


def test_an_early_end_is_told_as_an_event_that_is_kept(followed, context, until):
    job, live = followed(replace(OTF, target_um=2.0))
    live.publish(1.5, done=3)
    until(job, "succeeded")
    bodies = [event.body for event in context.store.read_events_after(0, job_id=job.id)]
    assert bodies[0]["early_end"] is None
    assert decode_job(bodies[-1]).early_end == EarlyEnd(1.5, 3, 10)


def test_a_job_is_planned_armed_measured_and_analysed(
    dispatcher, context, running, make_cell, until, science
):
    make_cell.cell.end()
    job = until(running, "succeeded")
    assert make_cell.cell.heard == ["connect", "begin"]
    assert (job.stage, job.failure, job.desired_state) == ("reporting", None, "running")
    assert job.health.samples == 50
    run = context.runs.get(job.run_id)
    assert (run.samples, run.lost_samples, run.complete) == (50, 0, True)
    assert science.calls == [
        ([str(context.runs.file(run.id))], str(context.results / job.id), False)
    ]
    assert (context.results / job.id / "result.json").is_file()


def test_a_standstill_job_steps_through_its_points(
    dispatcher, context, make_cell, until
):
    points = [{**row, "dwell_s": 0.5} for row in (*ROWS, OFF_THE_LINE)]
    job, _ = dispatcher.create(replace(STANDSTILL, rows=points))
    ready = until(job, "ready")
    arm_at_once(dispatcher, job.id, ready.version)
    order = wait_until(lambda: make_cell.cell.order)
    rows = [[row[f"{axis}_mm"] for axis in "xyz"] for row in points]
    assert order.commanded.position.tolist() == rows
    assert order.commanded.dwell_s.tolist() == [0.5] * 3
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    assert until(job, "succeeded").kind == "measure-standstill"
    assert context.runs.get(job.id).mode == "standstill"


def test_nothing_moves_before_the_job_is_armed(ready, make_cell):
    assert make_cell.cell.heard == ["connect"]


def test_arming_needs_the_version_that_was_read(dispatcher, ready, make_cell):
    with pytest.raises(StaleVersion):
        arm_at_once(dispatcher, ready.id, ready.version - 1)
    assert "begin" not in make_cell.cell.heard


def test_a_job_is_armed_by_its_stored_state_which_a_thread_may_not_know_yet(
    dispatcher, ready, make_cell
):
    dispatcher._under_way.require(ready.id, Verb.ARM).state = State.PREPARING
    assert arm_at_once(dispatcher, ready.id, ready.version).state is State.RUNNING
    assert make_cell.cell.begun.wait(5)


AT_THE_PANEL = MotionStatus(MotionState.HELD, (0.0,) * 3, 0, hold_reason="operator")


@pytest.mark.parametrize(
    ("devices", "kind", "remedy"),
    [
        ({}, ConditionType.DEVICES_CONNECTED, "connect them"),
        (
            {"motion": {"has_watchdog": True}},
            ConditionType.CONTROLLER_FREE,
            "end or reset it at the panel",
        ),
    ],
)
def test_nothing_is_armed_while_a_required_condition_is_known_to_be_wrong(
    context, event_bus, until, make_cell, devices, kind, remedy
):
    context.require_cell().start()
    board = ConditionBoard(
        lambda: Observed(
            CellStatus("ready", devices=devices),
            ControllerLevels(AT_THE_PANEL, "", time.monotonic()),
            False,
            10**9,
            10**8,
        )
    )
    watched = replace(context.machines.get("default"), conditions=board)
    dispatcher = Dispatcher(replace(context, machines=Machines([watched])), event_bus)
    try:
        job, _ = dispatcher.create(OTF)
        job = until(job, "ready")
        with pytest.raises(NotInOrder, match=remedy) as refused:
            arm_at_once(dispatcher, job.id, job.version)
        (obstacle,) = refused.value.obstacles
        assert obstacle.type is kind
        assert context.store.get(job.id) == job
        assert not make_cell.cell.begun.is_set()
    finally:
        dispatcher.close()


def test_arming_twice_is_refused(dispatcher, running):
    with pytest.raises(IllegalTransition, match="cannot arm a job that is running"):
        arm_at_once(dispatcher, running.id, running.version)


def test_the_cell_drives_what_was_planned(dispatcher, running, make_cell):
    path = make_cell.cell.order.commanded
    rows = [*ROWS, OFF_THE_LINE]
    assert path.position.tolist() == [[row[f"{a}_mm"] for a in "xyz"] for row in rows]
    assert path.feed_mm_min.tolist()[1] == 1000.0


def test_a_second_measuring_job_is_refused_with_the_first_ones_name(dispatcher, ready):
    with pytest.raises(CellBusy, match=ready.id):
        dispatcher.create(OTF)


def test_a_pause_holds_and_a_resume_goes_on(dispatcher, running, make_cell, until):
    assert dispatcher.pause(running.id).state == "pausing"
    paused = until(running, "paused")
    assert paused.desired_state == "paused"
    assert dispatcher.pause(running.id).version == paused.version
    assert dispatcher.resume(running.id, paused.version).state == "resuming"
    until(running, "running")
    assert make_cell.cell.heard == ["connect", "begin", "pause", "pause", "resume"]
    make_cell.cell.end()
    until(running, "succeeded")


def test_a_resume_with_a_stale_version_moves_nothing(
    dispatcher, running, make_cell, until
):
    dispatcher.pause(running.id)
    paused = until(running, "paused")
    with pytest.raises(StaleVersion):
        dispatcher.resume(running.id, paused.version - 1)
    assert "resume" not in make_cell.cell.heard


def test_a_hold_at_the_machines_panel_is_a_pause(running, make_cell, until):
    make_cell.cell.say_state("paused")
    until(running, "paused")
    make_cell.cell.say_state("running")
    until(running, "running")


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_stop_of_the_cells_own_never_becomes_a_users_pause(
    running, make_cell, until, monkeypatch, confirmed
):
    monkeypatch.setattr(cell_measurement, "REPEAT_S", 0.0)
    cell = make_cell.cell
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


def test_a_users_pause_outlasts_a_stop_of_the_cells_own(
    dispatcher, running, make_cell, until
):
    make_cell.cell.say_state("pausing")
    make_cell.cell.say_state("paused")
    stands = until(running, "paused")
    assert stands.desired_state == "running"
    assert dispatcher.pause(running.id).desired_state == "paused"
    wait_until(lambda: "pause" in make_cell.cell.heard, "the pause")


def test_what_moves_again_is_not_wanted_to_stand(
    dispatcher, running, make_cell, until, monkeypatch
):
    monkeypatch.setattr(cell_measurement, "REPEAT_S", 0.0)
    dispatcher.pause(running.id)
    until(running, "paused")
    cell = make_cell.cell
    heard = cell.heard.count("pause")
    cell.say_state("running")  # somebody has released the machine at its panel
    assert until(running, "running").desired_state == "running"
    cell.say_state("pausing")
    cell.record(10)
    cell.say_state("running")
    until(running, "running")
    assert cell.heard.count("pause") == heard


def test_what_the_cell_said_before_a_pause_does_not_undo_it(
    dispatcher, running, make_cell, until, context
):
    make_cell.cell.deaf.add("pause")
    dispatcher.pause(running.id)
    make_cell.cell.say_state("running")
    make_cell.cell.say_state("paused")
    until(running, "paused")
    states = [event.body["state"] for event in context.store.read_events_after(0)]
    after = states[states.index("pausing") :]
    assert "running" not in after


def test_a_pause_that_came_too_early_is_repeated(dispatcher, context, until, make_cell):
    context.confirm_s["pausing"] = 8.0
    job, _ = dispatcher.create(OTF)
    ready = until(job, "ready")
    make_cell.cell.deaf.add("pause")
    arm_at_once(dispatcher, job.id, ready.version)
    assert make_cell.cell.begun.wait(5)
    dispatcher.pause(job.id)
    wait_until(lambda: make_cell.cell.heard.count("pause") > 1, "a second pause")
    make_cell.cell.deaf.clear()
    until(job, "paused")


def test_a_pause_nobody_confirms_ends_the_cell_and_is_a_fault(
    dispatcher, running, make_cell, until, context
):
    first = make_cell.cell
    first.deaf.add("pause")
    dispatcher.pause(running.id)
    job = until(running, "faulted")
    assert job.failure.code == "not-pausing"
    assert "watchdog" in job.failure.detail
    assert first.closed
    assert context.runs.get(job.run_id).samples == 50
    wait_until(lambda: make_cell.cell is not first, "another cell")


def test_a_resume_that_the_tracker_refuses_leaves_the_job_paused_with_the_reason(
    dispatcher, running, make_cell, until, context
):
    dispatcher.pause(running.id)
    paused = until(running, "paused")
    make_cell.cell.deaf.add("resume")
    dispatcher.resume(running.id, paused.version)
    make_cell.cell.fault("not-resumed", "no valid samples", "lock the beam")
    held = wait_until(
        lambda: (job := context.store.get(running.id)).failure and job, "the reason"
    )
    assert (held.state, held.desired_state) == ("paused", "paused")
    assert (held.failure.code, held.failure.action) == ("not-resumed", "lock the beam")
    make_cell.cell.deaf.clear()
    dispatcher.resume(running.id, held.version)
    job = until(running, "running")
    wait_until(lambda: context.store.get(running.id).failure is None, "all well again")
    make_cell.cell.end()
    assert until(job, "succeeded").failure is None


def test_a_resume_that_is_refused_again_leaves_the_job_paused_again(
    dispatcher, running, make_cell, until, context
):
    dispatcher.pause(running.id)
    job = until(running, "paused")
    make_cell.cell.deaf.add("resume")
    for _ in range(3):
        assert dispatcher.resume(running.id, job.version).state == "resuming"
        make_cell.cell.fault("not-resumed", "no valid samples", "lock the beam")
        job = until(running, "paused")
    assert job.failure.code == "not-resumed"


def test_a_lost_beam_pauses_and_says_why(running, make_cell, until, context):
    make_cell.cell.fault()
    make_cell.cell.say_state("pausing")
    make_cell.cell.say_state("paused")
    job = until(running, "paused")
    assert job.failure.code == "beam-lost"


@pytest.mark.fault_row(34)
def test_a_cancelled_measurement_finishes_its_line_and_keeps_its_run(
    dispatcher, running, make_cell, until, science
):
    assert dispatcher.cancel(running.id).state is State.CANCELLING
    ended = until(running, "cancelled")
    assert make_cell.cell.heard == ["connect", "begin", "conclude"]
    assert (ended.run_id, ended.failure, science.calls) == (running.id, None, [])
    assert dispatcher.cancel(running.id) == ended


@pytest.mark.fault_row(34)
def test_a_line_that_never_ends_after_a_cancel_is_aborted_with_the_reason(
    dispatcher, running, make_cell, until, context
):
    context.confirm_s["cancelling"] = 0.2
    make_cell.cell.deaf.add("conclude")

    def is_stored():
        make_cell.cell.record(1, line_s=0.3)
        return context.store.get(running.id).health.samples > 50

    wait_until(is_stored)
    begun_s = time.monotonic()
    dispatcher.cancel(running.id)
    ended = until(running, "aborted")
    assert time.monotonic() - begun_s >= 0.2 + 2 * 0.3
    assert ended.failure.code == "cancel-overdue"
    assert "the feed was held" in ended.failure.detail
    assert make_cell.cell.heard[-1] == "abort"
    assert ended.run_id == running.id


def test_a_line_that_ends_by_neither_cancel_nor_abort_is_a_fault(
    dispatcher, running, make_cell, until, context
):
    context.confirm_s["cancelling"] = -60.0  # the line that is planned takes some time
    make_cell.cell.deaf |= {"conclude", "abort"}
    dispatcher.cancel(running.id)
    assert until(running, "faulted").failure.code == "not-aborting"


def test_a_held_measurement_is_cancelled_where_it_stands(
    dispatcher, running, make_cell, until
):
    dispatcher.pause(running.id)
    until(running, "paused")
    dispatcher.cancel(running.id)
    assert until(running, "cancelled").run_id == running.id
    assert make_cell.cell.heard[-1] == "abort"
    assert "conclude" not in make_cell.cell.heard


def test_a_job_that_waits_is_cancelled_without_motion(dispatcher, ready, make_cell):
    dispatcher.cancel(ready.id)
    wait_until(lambda: dispatcher.cancel(ready.id).state is State.CANCELLED)
    assert make_cell.cell.heard == ["connect"]


def test_an_abort_overtakes_a_cancelling_that_takes_long(
    dispatcher, running, make_cell, until
):
    make_cell.cell.say_state("pausing")
    make_cell.cell.deaf |= {"conclude"}
    dispatcher.cancel(running.id)
    dispatcher.abort(running.id)
    assert until(running, "aborted").desired_state == "aborted"
    with pytest.raises(IllegalTransition):
        arm_at_once(dispatcher, running.id, 99)


def test_a_job_that_computes_is_cancelled_at_once(
    dispatcher, running, make_cell, until, science
):
    science.hold = threading.Event()
    make_cell.cell.end()
    wait_until(lambda: science.calls)
    dispatcher.cancel(running.id)
    assert until(running, "cancelled").run_id == running.id


@pytest.mark.fault_row(19)
def test_a_held_machine_is_not_let_go_on_while_a_required_condition_is_wrong(
    context, event_bus, until, make_cell
):
    seen = [
        Observed(
            CellStatus("ready", devices={"motion": {"has_watchdog": True}}),
            None,
            False,
            10**12,
            1,
        )
    ]
    board = ConditionBoard(lambda: seen[0])
    watched = replace(context.machines.get("default"), conditions=board)
    dispatcher = Dispatcher(replace(context, machines=Machines([watched])), event_bus)
    context.require_cell().start()
    job, _ = dispatcher.create(OTF)
    arm_at_once(dispatcher, job.id, until(job, "ready").version)
    assert make_cell.cell.begun.wait(5)
    dispatcher.pause(job.id)
    held = until(job, "paused")
    seen[0] = replace(seen[0], free_bytes=0)
    with pytest.raises(NotInOrder, match="free"):
        dispatcher.resume(job.id, held.version)
    assert context.store.get(job.id) == held
    assert "resume" not in make_cell.cell.heard
    seen[0] = replace(seen[0], free_bytes=10**12)
    dispatcher.resume(job.id, held.version)
    until(job, "running")
    dispatcher.close()


@pytest.mark.parametrize("moment", ["ready", "running", "paused"])
def test_abort_works_at_any_moment_and_keeps_what_was_recorded(
    dispatcher, ready, make_cell, until, context, moment
):
    if moment != "ready":
        arm_at_once(dispatcher, ready.id, ready.version)
        assert make_cell.cell.begun.wait(5)
    if moment == "paused":
        dispatcher.pause(ready.id)
        until(ready, "paused")
    # Where nothing has to stand first, it may have ended by then.
    assert dispatcher.abort(ready.id).state in ("aborting", "aborted")
    job = until(ready, "aborted")
    assert (job.desired_state, job.failure) == ("aborted", None)
    assert dispatcher.abort(ready.id).version == job.version
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
    states = [event.body["state"] for event in context.store.read_events_after(0)]
    assert "ready" not in states


def test_an_abort_on_the_heels_of_arming_begins_nothing_or_ends_it(
    dispatcher, ready, make_cell, until
):
    arm_at_once(dispatcher, ready.id, ready.version)
    dispatcher.abort(ready.id)
    until(ready, "aborted")
    heard = make_cell.cell.heard
    assert "begin" not in heard or heard.index("abort") > heard.index("begin")


def test_an_abort_nobody_confirms_ends_the_cell_and_is_a_fault(
    dispatcher, running, make_cell, until
):
    make_cell.cell.deaf.add("abort")
    dispatcher.abort(running.id)
    job = until(running, "faulted")
    assert job.failure.code == "not-aborting"
    assert make_cell.cells[0].closed


def test_an_abort_during_the_analysis_ends_it(
    dispatcher, running, make_cell, until, science, context
):
    science.hold = threading.Event()
    make_cell.cell.end()
    wait_until(lambda: science.calls, "the analysis")
    dispatcher.abort(running.id)
    job = until(running, "aborted")
    assert context.runs.get(job.run_id).complete
    assert not (context.results / job.id).exists()


def test_a_job_that_computes_cannot_be_paused(
    dispatcher, running, make_cell, until, science
):
    science.hold = threading.Event()
    make_cell.cell.end()
    wait_until(lambda: science.calls, "the analysis")
    with pytest.raises(IllegalTransition, match="nothing moves any more"):
        dispatcher.pause(running.id)
    science.hold.set()
    until(running, "succeeded")


def test_stop_ends_every_motion_and_leaves_computing_alone(
    dispatcher, running, make_cell, until, science, context
):
    make_cell.cell.end()
    first = until(running, "succeeded")
    science.hold = threading.Event()
    computing, _ = dispatcher.create(
        RequestedJob(JobKind.ANALYSE, run_ids=[first.run_id])
    )
    wait_until(lambda: len(science.calls) == 2)
    moving, _ = dispatcher.create(OTF)
    ready = until(moving, "ready")
    stopped = dispatcher.stop()
    assert [job.id for job in stopped] == [moving.id]
    until(ready, "aborted")
    assert context.store.get(computing.id).state == "running"
    science.hold.set()
    until(computing, "succeeded")


def test_stop_reaches_the_cell_even_if_no_job_is_under_way(dispatcher, make_cell):
    assert dispatcher.stop() == []
    wait_until(lambda: make_cell.cell.heard == ["abort"], "the abort")


def test_stop_without_a_machine_is_harmless(context, event_bus):
    dispatcher = Dispatcher(replace(context, machines=Machines()), event_bus)
    assert dispatcher.stop() == []
    dispatcher.close()


def test_an_abort_at_the_machine_aborts_the_job(running, make_cell, until):
    make_cell.cell.end("aborted")
    job = until(running, "aborted")
    assert job.failure is None


def test_a_measurement_that_fails_fails_the_job_with_the_cells_reason(
    running, make_cell, until
):
    make_cell.cell.fault("storage", "the disk is full", "free some space")
    make_cell.cell.end("failed")
    job = until(running, "failed")
    failure = job.failure
    assert (failure.code, failure.detail) == ("storage", "the disk is full")
    assert failure.action == "free some space"


def test_a_fault_of_the_machine_is_a_fault_of_the_job_and_the_run_is_kept(
    running, make_cell, until, context
):
    make_cell.cell.fault("motion-alarm", "servo alarm", "clear it")
    make_cell.cell.end("faulted")
    job = until(running, "faulted")
    assert job.failure.code == "motion-alarm"
    assert not context.runs.get(job.run_id).complete


def test_a_cell_that_closes_without_a_word_fails_the_job(running, make_cell, until):
    recorder, make_cell.cell._recorder = make_cell.cell._recorder, None
    recorder.close("finished")
    make_cell.cell.say(RunClosed("", CellState.FAILED, 50))
    assert "without saying why" in until(running, "failed").failure.detail


def test_a_cell_that_dies_faults_the_job_and_its_run_is_salvaged(
    running, make_cell, until, context, dispatcher
):
    first = make_cell.cell
    first.die()
    job = until(running, "faulted")
    assert job.failure.code == "cell-died"
    run = context.runs.get(job.run_id)
    assert (run.samples, run.complete) == (50, False)
    wait_until(lambda: make_cell.cell is not first, "another cell")
    again, _ = dispatcher.create(OTF)
    until(again, "ready")


def test_a_defect_beside_the_cell_costs_the_job_and_the_cell_only(
    running, make_cell, until, monkeypatch, context
):
    first = make_cell.cell

    def fail(_timeout_s):
        raise ValueError("a message that nobody can read")

    monkeypatch.setattr(first, "poll", fail)
    assert until(running, "faulted").failure.code == "cell-died"
    wait_until(lambda: make_cell.cell is not first, "another cell")
    assert first.closed
    assert context.require_cell().connect()


def test_a_device_that_cannot_be_reached_fails_the_job_before_it_is_ready(
    dispatcher, make_cell, until
):
    make_cell.cell.refuses = ConnectionLost("no such port")
    job, _ = dispatcher.create(OTF)
    failed = until(job, "failed")
    assert (failed.failure.family, failed.failure.detail) == (
        "ConnectionLost",
        "no such port",
    )


def test_a_run_that_cannot_be_read_is_kept_and_fails_the_analysis(
    running, make_cell, until, context
):
    make_cell.cell.end(spoil=b"no database at all")
    file = context.runs.name_run_file(running.id)
    job = until(running, "failed")
    assert job.run_id is None
    assert job.failure.family == "NotFound"
    assert file.is_file()


def test_science_that_fails_fails_the_job_and_the_run_is_kept(
    running, make_cell, until, science, context
):
    science.raises = ValueError("matrix")
    make_cell.cell.end()
    job = until(running, "failed")
    assert (job.failure.family, job.failure.detail) == ("ValueError", "matrix")
    assert context.runs.get(job.run_id).complete


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ([{"x_mm": 1.0, "y_mm": 2.0}], "row 1: z_mm is missing"),
        ([ROWS[0], {**ROWS[1], "a_deg": 3.0}], "row 2: a_deg is no axis"),
        ([ROWS[0]], "at least two rows"),
        ([ROWS[0], ROWS[0]], "row 2: the line starts where it ends"),
        ([{**row, "target": "T9"} for row in ROWS], "row 1: target 'T9' is unknown"),
    ],
)
def test_a_path_that_cannot_be_driven_is_refused_before_there_is_a_job(
    dispatcher, context, rows, problem
):
    with pytest.raises(PlanningError, match=problem):
        dispatcher.create(replace(OTF, rows=rows))
    assert context.store.list_page(10) == []


def test_a_path_out_of_travel_is_refused_before_there_is_a_job(dispatcher, context):
    rows = [ROWS[0], {**ROWS[1], "x_mm": 9999.0}]
    with pytest.raises(OutOfTravel, match="row 2: X = 9999 mm exceeds 500 mm"):
        dispatcher.create(replace(OTF, rows=rows))
    assert context.store.list_page(10) == []


def test_without_rows_the_default_path_is_driven(dispatcher, context, until):
    job, _ = dispatcher.create(RequestedJob(JobKind.MEASURE_OTF, feed_mm_min=1234.0))
    until(job, "ready")
    plan = context.store.read_plan(job.id)
    assert plan["kind"] == "path"
    assert len(plan["position"]) > 10
    assert set(plan["feed_mm_min"]) == {1234.0}


@pytest.mark.fault_row(33)
def test_a_repeated_request_makes_one_job_even_while_the_machine_is_busy(
    dispatcher, ready
):
    key = IdempotencyKey("twice", b"body")
    with pytest.raises(CellBusy):
        dispatcher.create(OTF, key)
    dispatcher.abort(ready.id)


def test_the_same_key_finds_its_job_again(dispatcher, until):
    key = IdempotencyKey("once", b"body")
    job, is_new = dispatcher.create(OTF, key)
    until(job, "ready")
    again, is_new_again = dispatcher.create(OTF, key)
    assert (again.id, is_new, is_new_again) == (job.id, True, False)


def test_a_service_without_a_machine_measures_nothing(context, event_bus):
    dispatcher = Dispatcher(replace(context, machines=Machines()), event_bus)
    with pytest.raises(NoMachine, match="machine_file"):
        dispatcher.create(OTF)
    dispatcher.close()


def test_closing_stops_motion_first_and_leaves_the_job_interrupted(
    dispatcher, running, make_cell, context
):
    dispatcher.close()
    assert "abort" in make_cell.cell.heard
    job = context.store.get(running.id)
    assert job.state == "interrupted"
    assert context.runs.get(job.run_id).samples == 50
    with pytest.raises(CellDown, match="ending"):
        dispatcher.create(OTF)


def test_after_a_restart_what_had_not_ended_is_interrupted_and_nothing_moves(
    dispatcher, running, make_cell, context, event_bus
):
    """The catalogue as a killed service leaves it: the job runs, the Run is torn."""
    make_cell.cell.tear()
    heard = list(make_cell.cell.heard)
    after = Dispatcher(context, event_bus)
    after.interrupt_unfinished_jobs()
    job = context.store.get(running.id)
    assert job.state == "interrupted"
    assert job.failure.family == "Interrupted"
    assert "was running" in job.failure.detail
    assert context.runs.get(job.run_id).samples == 50
    assert make_cell.cell.heard == heard
    after.interrupt_unfinished_jobs()
    assert context.store.get(running.id).version == job.version
    make_cell.cell.die()


def test_a_run_that_was_left_out_of_the_catalogue_joins_its_job_at_the_next_start(
    running, make_cell, until, context, event_bus, monkeypatch
):
    """As after a full disk: the file is there, no row and no job names it."""
    with monkeypatch.context() as full:
        full.setattr(type(context.runs), "add_measured", lambda *_: None)
        make_cell.cell.end()
        job = until(running, *FINAL)
    assert job.run_id is None
    after = Dispatcher(context, event_bus)
    after.interrupt_unfinished_jobs()
    joined = context.store.get(job.id)
    assert (joined.run_id, joined.state) == (job.id, job.state)
    assert context.runs.get(job.id).samples == 50
    after.interrupt_unfinished_jobs()
    assert context.store.get(job.id).version == joined.version


def test_progress_and_live_views_are_told_but_not_kept(
    dispatcher, event_bus, running, make_cell, context, until
):
    heard = []
    forget = event_bus.subscribe(heard.append)

    def told():
        # At most ten a second are passed on.
        make_cell.cell.record(10)
        found = [n for n in heard if n.type == "progress"]
        return [n for n in found if n.body["health"]["samples"] > 50]

    notice = wait_until(told)[-1]
    forget()
    assert {n.type for n in heard} == {"progress", "live"}
    assert notice.job_id == running.id
    assert list(notice.body["progress"]["position"]) == [1.0, 2.0, 3.0]
    assert {e.type for e in context.store.read_events_after(0)} == {"job"}
    count = len(heard)
    make_cell.cell.end()
    assert until(running, "succeeded").health.samples > 50
    assert len(heard) == count


def lock_catalogue(connection: Connection) -> None:
    """Let nobody else write until the transaction ends."""
    locks_whole = connection.dialect.name == "sqlite"  # by its first statement
    lock = "LOCK TABLE jobs, events IN EXCLUSIVE MODE"
    connection.execute(text("SELECT 1" if locks_whole else lock))


@pytest.mark.fault_row(37)
def test_a_catalogue_that_is_locked_does_not_stop_an_abort(
    dispatcher, running, make_cell, context, until, measured
):
    """The machine is told first; the books follow when they can."""
    with context.store._database.engine.connect() as raw:
        connection = raw.execution_options(truepath_writes=True)
        with connection.begin():
            lock_catalogue(connection)
            begun = time.monotonic()
            (answered,) = dispatcher.stop()
            took_s = time.monotonic() - begun
            assert took_s < 4.0
            measured(f"catalogue locked: stop answered after {took_s:.2f} s")
            assert answered.id == running.id
            wait_until(lambda: "abort" in make_cell.cell.heard, "the abort")
    until(running, *FINAL)
    assert context.store.get(running.id).state == "aborted"


@pytest.mark.fault_row(37)
def test_a_catalogue_that_is_locked_does_not_stop_a_pause(
    dispatcher, running, make_cell, context, until
):
    with context.store._database.engine.connect() as raw:
        connection = raw.execution_options(truepath_writes=True)
        with connection.begin():
            lock_catalogue(connection)
            asks = threading.Thread(target=dispatcher.pause, args=(running.id,))
            asks.start()
            wait_until(lambda: "pause" in make_cell.cell.heard, "the pause")
            assert asks.is_alive()  # its answer waits for the books
    asks.join()
    assert until(running, "paused").wants_pause
    dispatcher.resume(running.id, context.store.get(running.id).version)
    until(running, "running")


def test_a_pause_that_cannot_be_stored_is_insisted_on(
    dispatcher, running, make_cell, until, failing, monkeypatch, context
):
    monkeypatch.setattr(cell_measurement, "REPEAT_S", 0.01)
    wait_until(lambda: context.store.get(running.id).health.samples, "the first ones")
    cell = make_cell.cell
    cell.deaf.add("pause")
    failing.set()
    with pytest.raises(StorageUnavailable):
        dispatcher.pause(running.id)
    wait_until(lambda: cell.heard.count("pause") > 2, "a repetition")
    failing.clear()
    cell.deaf.clear()
    paused = until(running, "paused")
    dispatcher.resume(running.id, paused.version)
    until(running, "running")
    assert cell.heard[-1] == "resume"


@pytest.fixture
def failing(context):
    """While it is set, nothing can be written down."""
    failing, change = threading.Event(), context.store.change

    def may_fail(*arguments, **options):
        if failing.is_set():
            raise StorageUnavailable("the disk is full")
        return change(*arguments, **options)

    context.store.change = may_fail
    yield failing
    failing.clear()


def test_a_catalogue_that_fails_while_the_machine_moves_stops_it(
    running, make_cell, until, failing, context
):
    failing.set()
    make_cell.cell.say_state("paused")
    wait_until(lambda: make_cell.cell.heard[-1] == "abort", "the abort")
    failing.clear()
    job = until(running, "failed")
    assert job.failure.family == "StorageUnavailable"
    assert context.runs.get(running.id).samples == 50


def test_a_cell_that_does_not_stop_when_the_catalogue_fails_is_ended(
    running, make_cell, until, failing, monkeypatch
):
    monkeypatch.setattr(cell_measurement, "CLOSE_RUN_S", 0.2)
    first = make_cell.cell
    first.deaf.add("abort")
    failing.set()
    first.say_state("paused")
    wait_until(lambda: first.closed, "the end of the cell")
    failing.clear()
    until(running, "failed")


def test_a_job_whose_end_cannot_be_put_down_is_left_to_the_next_start(
    dispatcher, running, failing, context
):
    failing.set()
    dispatcher.close()
    assert context.store.get(running.id).state == "running"
    failing.clear()
    dispatcher.interrupt_unfinished_jobs()
    assert context.store.get(running.id).state == "interrupted"


def test_lines_that_are_driven_again_and_gaps_are_counted(running, make_cell, until):
    progress = MeasurementProgress(3, 9, "lines", "measuring", 4.0, 8.0, gaps=2)
    make_cell.cell.say(LinesDamaged(3, None))
    make_cell.cell.say(progress)
    make_cell.cell.end()
    health = until(running, "succeeded").health
    assert (health.repeats, health.gaps) == (1, 2)


def test_progress_that_cannot_be_kept_does_not_stop_the_measurement(
    running, make_cell, until, context
):
    def full(*_):
        raise StorageUnavailable("the disk is full")

    keep, context.store.keep_progress = context.store.keep_progress, full
    make_cell.cell.record(10)
    make_cell.cell.end()
    assert until(running, "succeeded").health.samples == 60
    context.store.keep_progress = keep


@pytest.fixture
def full(context):
    """While it is set, the disk of the catalogue has no room left."""
    database, full = context.store._database, threading.Event()
    engine = database.engine

    def refuse(connection, cursor, statement, *_):
        if full.is_set() and not statement.startswith(("SELECT", "BEGIN", "PRAGMA")):
            raise engine.dialect.loaded_dbapi.OperationalError("the disk is full")

    event.listen(engine, "before_cursor_execute", refuse)
    yield full
    full.clear()
    event.remove(engine, "before_cursor_execute", refuse)


@pytest.mark.fault_row(27)
def test_a_full_disk_is_shown_at_once_and_the_job_ends_when_there_is_room(
    dispatcher, running, make_cell, until, full, context, event_bus, measured
):
    heard = []
    forget = event_bus.subscribe(heard.append)
    full.set()
    begun = time.monotonic()
    make_cell.cell.say_state("paused")

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
    stored = until(running, "failed")
    assert stored.failure.family == "StorageFull"
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


@pytest.mark.fault_row(48)
@pytest.mark.parametrize("end", ["failed", "faulted", "aborted"])
def test_a_job_that_has_ended_stays_so_whatever_is_asked_and_cannot_be_stored(
    dispatcher, running, make_cell, until, full, context, monkeypatch, end
):
    monkeypatch.setattr(workflow, "TRY_AGAIN_S", 0.05)
    store = context.store

    def read_states():
        found = {dispatcher.show(store.get(running.id)).state}
        found |= {dispatcher.show(job).state for job in store.list_page(9)}
        found |= {
            state for (_, state), count in store.count_by_state().items() if count
        }
        assert store.list_unfinished() == []
        assert store.list_page(9, states=["running", "aborting", "paused"]) == []
        assert [job.id for job in store.list_page(9, states=[end])] == [running.id]
        return found

    full.set()
    if end == "failed":
        make_cell.cell.say_state("paused")
    else:
        make_cell.cell.end(end)
    wait_until(lambda: dispatcher.show(store.get(running.id)).state == end, end)
    for verb in random.Random(end).sample([*VERBS] * 2, 2 * len(VERBS)):
        with suppress(IllegalTransition, NotResumable, StorageUnavailable):
            answered = VERBS[verb](dispatcher, running)
            shown = answered[0] if isinstance(answered, tuple) else answered
            assert shown.state == end, verb
        assert read_states() == {end}, verb
        time.sleep(0.01)
    full.clear()
    until(running, end)
    assert read_states() == {end}


@pytest.mark.fault_row(48)
def test_a_stop_that_a_frozen_cell_hears_late_is_an_abort(
    dispatcher, running, make_cell, until
):
    cell = make_cell.cell
    cell.deaf.add("abort")
    dispatcher.stop()
    cell.fault("ended-early", "the controller is aborted at X 3.000")
    cell.end("faulted")
    job = until(running, "aborted")
    assert (job.failure, job.desired_state) == (None, "aborted")


def test_a_machine_that_stands_elsewhere_before_anybody_stops_it_is_a_fault(
    dispatcher, running, make_cell, until, context
):
    cell = make_cell.cell
    cell.deaf.add("abort")
    cell.fault("ended-early", "the controller is aborted at X 3.000")
    wait_until(lambda: context.store.get(running.id).failure)
    dispatcher.stop()
    cell.end("faulted")
    assert until(running, "faulted").failure.code == "ended-early"


def test_progress_that_could_not_be_kept_is_shown_until_it_is(
    dispatcher, running, make_cell, context, full, monkeypatch
):
    monkeypatch.setattr(active_job, "STORE_EVERY_S", 0.0)

    def shown():
        make_cell.cell.record(10)
        return dispatcher.show(context.store.get(running.id)).failure

    full.set()
    assert wait_until(shown).family == "StorageFull"
    full.clear()
    wait_until(lambda: shown() is None)
    assert dispatcher.show(context.store.get(running.id)).state == "running"


def test_a_full_disk_is_logged_once_not_ten_times_a_second(
    dispatcher, running, make_cell, until, full, monkeypatch
):
    monkeypatch.setattr(workflow, "TRY_AGAIN_S", 0.005)
    lines, tries = [], []
    for module in (active_job, workflow, databases):
        for level in ("warning", "exception"):
            monkeypatch.setattr(module.log, level, lambda text, **_: lines.append(text))
    full.set()
    store_end = active_job.ActiveJob.end
    monkeypatch.setattr(
        active_job.ActiveJob,
        "end",
        lambda *given: (tries.append(1), store_end(*given))[1],
    )
    make_cell.cell.say_state("paused")
    wait_until(lambda: len(tries) > 20)
    full.clear()
    until(running, "failed")
    assert 1 <= lines.count("job not stored") <= 2
    assert len(lines) <= 4


def test_a_run_that_is_not_closed_in_time_is_a_fault(
    running, make_cell, until, monkeypatch
):
    monkeypatch.setattr(cell_measurement, "CLOSE_RUN_S", 0.2)
    make_cell.cell.say_state("finished")
    assert until(running, "faulted").failure.code == "run-not-closed"


def test_a_job_that_ended_can_only_be_looked_at(
    dispatcher, running, make_cell, until, context
):
    make_cell.cell.end()
    job = until(running, "succeeded")
    wait_until(lambda: dispatcher._under_way.get(job.id) is None)
    assert dispatcher.abort(job.id) == job
    for verb in (
        dispatcher.pause,
        lambda id: arm_at_once(dispatcher, id, job.version),
        lambda id: dispatcher.resume(id, job.version),
    ):
        with pytest.raises(IllegalTransition, match="a job that is succeeded"):
            verb(job.id)
    with pytest.raises(NotFound):
        dispatcher.abort("nobody")


def test_a_job_of_another_process_cannot_be_armed_here(dispatcher, context):
    job, _ = context.store.create(Job(JobKind.MEASURE_OTF), plan={})
    context.store.change(job.id, lambda job: replace(job, state=State.PREPARING))
    ready = context.store.change(job.id, lambda job: replace(job, state=State.READY))
    with pytest.raises(IllegalTransition, match="not under way any more"):
        arm_at_once(dispatcher, job.id, ready.version)


def test_a_torn_run_that_cannot_be_read_does_not_stop_the_sweep(dispatcher, context):
    job, _ = context.store.create(Job(JobKind.MEASURE_OTF), plan={})
    context.runs.name_run_file(job.id).write_bytes(b"no database at all")
    dispatcher.interrupt_unfinished_jobs()
    job = context.store.get(job.id)
    assert (job.state, job.run_id) == ("interrupted", None)


def test_a_job_that_is_created_as_the_service_ends_never_begins(
    dispatcher, context, make_cell
):
    create = context.store.create

    def late(*arguments):
        dispatcher.close()
        return create(*arguments)

    context.store.create = late
    job, _ = dispatcher.create(OTF)
    assert context.store.get(job.id).state == "queued"
    dispatcher.interrupt_unfinished_jobs()
    assert context.store.get(job.id).state == "interrupted"


def test_a_standstill_job_without_rows_measures_the_default_points(
    dispatcher, context, until
):
    job, _ = dispatcher.create(STANDSTILL)
    assert context.store.read_plan(job.id)["kind"] == "points"
    until(job, "ready")


def test_more_rows_than_a_controller_takes_are_refused(dispatcher):
    rows = [{**ROWS[0], "x_mm": float(n % 2)} for n in range(4097)]
    with pytest.raises(PlanningError, match="4097 rows; a controller takes 4096"):
        dispatcher.create(replace(OTF, rows=rows))


def test_the_targets_of_rows_are_the_machines(context, machine):
    two = replace(
        machine,
        targets=(Target("T1", "tool", (0, 0, 0)), Target("T2", "tool", (0, 0, 50))),
    )
    rows = [{**ROWS[0], "target": "T1"}, {**ROWS[0], "target": "T2"}]
    path = command_rows(two, rows, is_path=True)
    assert path.target == ("T1", "T2")
    assert decode_commanded_json(encode_commanded_json(path)).target == ("T1", "T2")
    with pytest.raises(PlanningError, match="row 1: target '' is unknown"):
        command_rows(two, [ROWS[0], rows[1]], is_path=True)
