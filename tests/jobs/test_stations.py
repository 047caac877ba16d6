"""A job of several stations asks for the tracker, checks it and loses nothing."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from arming import arm_at_once
from resumption_doubles import PLACES as SEEN_MM
from resumption_doubles import Closer, Resumer
from scripted_cell import wait_until

from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition, NotFound, PlanningError
from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.bundle.machine_file import machine_to_json
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.machines.cell_status import CellStatus, ControllerLevels
from truepath.machines.conditions.condition_board import ConditionBoard
from truepath.machines.conditions.conditions import NotInOrder, Observed
from truepath.machines.machine_cells import Machines
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers.interfaces.records import MotionState, MotionStatus

PLACES = ([1200.0, 0.0, 0.0], [0.0, -900.0, 50.0], [-500.0, 300.0, 0.0])
ROWS = (
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0},
    {"x_mm": 400.0, "y_mm": 300.0, "z_mm": 200.0, "feed_mm_min": 1000.0},
)
LONG = tuple({**ROWS[row % 2], "z_mm": 10.0 + row} for row in range(11))
SHARES = [{"position_mm": place, "rows": 11, "duration_s": 9.0} for place in PLACES]
ADVICE = {"tracker": {}, "stations": {"recommended": 3}, "at_stations": SHARES}
CURVE = [
    {"row": row, "time_s": float(row), "volumetric_uncertainty_um": 9.0 / row}
    for row in (6, 15, 33)
]
GOOD = {"place_mm": (1.0, 2.0, 3.0)}
BAD = {"problem": "not-moved", "text": "the tracker has not been moved"}


class Checker:
    """Says of each station what the test has said before."""

    def __init__(self):
        self.calls, self.answers = [], []

    def __call__(
        self, file, before, planned_mm, asked_mm, specification, *, on_progress
    ):
        self.calls.append((file, before, asked_mm, planned_mm))
        return self.answers.pop(0) if self.answers else GOOD


@pytest.fixture
def checker():
    return Checker()


@pytest.fixture
def resumer():
    return Resumer()


@pytest.fixture
def closer():
    return Closer()


@pytest.fixture
def planner(machine):
    """A plan of as many stations as are asked for, ten lines from each."""

    def plan(_, order, *, on_progress):
        path = encode_commanded_json(command_rows(machine, LONG, is_path=True))
        points = [{k: v for k, v in row.items() if k != "feed_mm_min"} for row in ROWS]
        known = encode_commanded_json(command_rows(machine, points, is_path=False))
        places = PLACES[: order["stations"]]
        return {
            **path,
            "predicted_um": 1.0,
            "document": {
                "machine": machine_to_json(machine),
                **ADVICE,
                "curve": CURVE,
            },
            "stations": [{"position_mm": p, "duration_s": 9.0, **path} for p in places],
            "known_points": known,
            "specification": {},
        }

    return plan


@pytest.fixture
def open_dispatcher(context, event_bus, planner, checker, resumer, closer):
    """Opens the service again and again on the same catalogue."""
    opened = []
    full = replace(
        context, planner=planner, checker=checker, resumer=resumer, closer=closer
    )
    context.require_cell().start()

    def make():
        opened.append(Dispatcher(full, event_bus))
        opened[-1].interrupt_unfinished_jobs()
        return opened[-1]

    yield make
    for dispatcher in opened:
        dispatcher.close()


@pytest.fixture
def dispatcher(open_dispatcher):
    return open_dispatcher()


@pytest.fixture
def plan_id(dispatcher, until):
    asked = RequestedJob(JobKind.PLAN, plan_request={"mode": "otf", "stations": 3})
    return until(dispatcher.create(asked)[0], State.SUCCEEDED).id


@pytest.fixture
def begin(dispatcher, until, plan_id):
    def made(dispatcher=dispatcher, **request):
        request = request or {"plan_id": plan_id}
        job, _ = dispatcher.create(RequestedJob(JobKind.MEASURE_OTF, **request))
        return until(job, State.READY)

    return made


@pytest.fixture
def measure(dispatcher, make_cell, until):
    """Arm a job and let the cell finish so many Runs; return the job then."""

    def measured(job, *runs, then=State.AWAITING_MOVE, dispatcher=dispatcher):
        armed = arm_at_once(dispatcher, job.id, job.version)
        for kind in runs:
            cell = make_cell.cell
            wait_until(cell.begun.is_set, "a measurement")
            assert type(cell.order.commanded).__name__ == kind
            cell.begun.clear()
            cell.end()
        return until(armed, then)

    return measured


POINTS, LINES = "Configurations", "Path"


def test_stations_are_asked_for_one_after_another(
    begin, measure, context, checker, science
):
    job = begin()
    assert (job.station.number, job.station.total) == (1, 3)
    for number in (2, 3):
        job = measure(job, POINTS, LINES)
        assert job.station.number == number
        assert list(job.station.position_mm) == PLACES[number - 1]
        assert len(job.run_ids) == number - 1
    job = measure(job, POINTS, LINES, then=State.SUCCEEDED)
    assert len(set(job.run_ids)) == 3
    assert science.calls[-1][0] == [str(context.runs.file(i)) for i in job.run_ids]
    assert checker.calls[0][1] is None
    assert checker.calls[0][2:] == (pytest.approx(1500.8, abs=0.1), PLACES[0])
    assert checker.calls[1][1] == checker.calls[0][0]
    assert checker.calls[1][2] == pytest.approx(1500.8, abs=0.1)


def test_a_station_that_the_known_points_contradict_is_asked_for_again(
    begin, measure, checker
):
    checker.answers = [GOOD, BAD, GOOD]
    job = measure(begin(), POINTS, LINES)
    again = measure(job, POINTS)
    assert again.station.number == 2
    assert again.station.checks[-1].problem == "not-moved"
    assert again.run_ids == job.run_ids
    last = measure(again, POINTS, LINES)
    assert [check.problem for check in last.station.checks] == ["", ""]


def test_known_points_that_are_not_seen_are_no_fault_of_the_job(
    begin, dispatcher, make_cell, until
):
    job = begin()
    arm_at_once(dispatcher, job.id, job.version)
    wait_until(lambda: make_cell.cell.begun.is_set(), "the known points")
    make_cell.cell.begun.clear()
    make_cell.cell.fault("beam-lost")
    asked = until(job, State.AWAITING_MOVE)
    assert asked.station.checks[-1].problem == "not-seen"
    assert "beam" in asked.station.checks[-1].text
    assert "abort" in make_cell.cell.heard


VICE = {"name": "vice", "min_mm": [100, 0, 0], "max_mm": [200, 50, 50]}


class Standing:
    """Says where the machine stands while nothing is measured."""

    place = (300.0, 10.0, 10.0)  # the vice is between here and the known points

    def __call__(self):
        status = MotionStatus(MotionState.IDLE, self.place, 0, override=1.0)
        read = ControllerLevels(status, "", time.monotonic(), ("X", "Y", "Z"))
        devices = {"motion": {"has_watchdog": True}}
        return Observed(CellStatus("ready", devices=devices), read, False, 10**9, 1)


@pytest.fixture
def standing():
    return Standing()


@pytest.fixture
def watched(context, standing):
    """The service, with a board of conditions that stand as the test says."""
    cell = replace(context.machines.get("default"), conditions=ConditionBoard(standing))
    return replace(context, machines=Machines([cell]))


def test_what_a_plan_avoids_is_avoided_on_the_way_to_its_rows(
    watched, event_bus, planner, checker, measure, until, standing, make_cell
):
    dispatcher = Dispatcher(
        replace(watched, planner=planner, checker=checker), event_bus
    )
    asked = {"mode": "otf", "stations": 2, "workspace": {"keep_out": [VICE]}}
    plan, _ = dispatcher.create(RequestedJob(JobKind.PLAN, plan_request=asked))
    until(plan, State.SUCCEEDED)
    job, _ = dispatcher.create(RequestedJob(JobKind.MEASURE_OTF, plan_id=plan.id))
    ready = until(job, State.READY)
    with pytest.raises(NotInOrder, match="keep-out box vice"):
        arm_at_once(dispatcher, ready.id, ready.version)
    assert "begin" not in make_cell.cell.heard
    standing.place = (10.0, 300.0, 10.0)
    waits = measure(ready, POINTS, LINES, dispatcher=dispatcher)
    standing.place = (300.0, 10.0, 10.0)  # jogged while the tracker was moved
    with pytest.raises(NotInOrder, match="keep-out box vice"):
        arm_at_once(dispatcher, waits.id, waits.version)
    dispatcher.close()


def test_abort_works_while_the_tracker_is_moved(begin, measure, dispatcher, until):
    job = measure(begin(), POINTS, LINES)
    dispatcher.abort(job.id)
    ended = until(job, State.ABORTED)
    assert ended.run_ids == job.run_ids


def test_nothing_moves_until_the_job_is_armed_again(begin, measure, make_cell):
    measure(begin(), POINTS, LINES)
    assert make_cell.cell.heard.count("begin") == 2


@pytest.mark.parametrize("how", ["closed", "killed"])
def test_a_service_that_ends_meanwhile_loses_nothing_and_another_job_goes_on(
    begin, measure, dispatcher, open_dispatcher, until, science, how
):
    job = measure(begin(), POINTS, LINES)
    if how == "closed":
        dispatcher.close()
    second = open_dispatcher()
    ended = until(job, State.INTERRUPTED)
    assert ended.run_ids == job.run_ids
    again = begin(second, continues=job.id)
    assert again.station.number == 2
    assert again.run_ids == job.run_ids
    again = measure(again, POINTS, LINES, dispatcher=second)
    last = measure(again, POINTS, LINES, then=State.SUCCEEDED, dispatcher=second)
    assert last.run_ids[0] == job.run_ids[0]
    assert len(science.calls[-1][0]) == 3
    with pytest.raises(IllegalTransition, match="all stations"):
        begin(second, continues=last.id)


@pytest.fixture
def cut_short(begin, measure, dispatcher, make_cell, until):
    """A job that a fault has ended on the lines of its second station."""

    def made():
        job = measure(begin(), POINTS, LINES)
        arm_at_once(dispatcher, job.id, job.version)
        cell = make_cell.cell
        wait_until(cell.begun.is_set, "the known points")
        cell.begun.clear()
        cell.end()
        wait_until(cell.begun.is_set, "the lines")
        cell.begun.clear()
        cell.fault()
        cell.end("faulted")
        return until(job, State.FAULTED)

    return made


@pytest.fixture
def go_on(dispatcher, until):
    def done(job):
        dispatcher.acknowledge(job.id)
        return until(job, State.READY)

    return done


def test_a_station_that_was_cut_short_goes_on_with_the_rest_of_its_lines(
    cut_short, go_on, measure, make_cell, resumer, closer, context, science
):
    job, resumer.next_row = cut_short(), 4
    ready = go_on(job)
    assert ready.station.number == 2
    asked = measure(ready, POINTS, LINES)
    assert asked.station.number == 3
    rest = make_cell.cell.order.commanded
    assert rest.position[:, 2].tolist() == [10.0 + row for row in range(3, 11)]
    assert closer.calls == [SEEN_MM]
    last = measure(asked, POINTS, LINES, then=State.SUCCEEDED)
    assert len(last.run_ids) == 4
    assert science.calls[-1][0] == [str(context.runs.file(i)) for i in last.run_ids]


def test_a_station_that_was_moved_meanwhile_is_said_and_measured_on_as_a_new_one(
    cut_short, go_on, measure, closer, checker
):
    job, closer.problem = cut_short(), "the target is 51 µm from where it was"
    before = len(checker.calls)
    asked = measure(go_on(job), POINTS)
    (check,) = asked.station.checks
    assert (asked.station.number, check.station, check.problem) == (2, 2, "moved")
    assert closer.problem in check.text
    assert "new station" in check.text
    assert len(checker.calls) == before
    checker.answers = [{"problem": "residual", "text": "they do not fit"}, GOOD]
    again = measure(asked, POINTS)
    assert again.station.checks[-1].problem == "residual"
    assert measure(again, POINTS, LINES).station.number == 3
    _, itself, asked_mm, _ = checker.calls[-1]
    assert itself == checker.calls[before - 1][0], "its own known points before"
    assert asked_mm == 0.0


def test_a_station_that_is_put_back_where_it_was_is_no_new_one(
    cut_short, go_on, measure, closer, checker
):
    job, closer.problem = cut_short(), "the target is 51 µm from where it was"
    before = len(checker.calls)
    asked = measure(go_on(job), POINTS)
    closer.problem = ""
    assert measure(asked, POINTS, LINES).station.number == 3
    assert len(checker.calls) == before


def test_a_station_whose_run_tells_nothing_is_measured_whole_and_its_run_left_out(
    cut_short, go_on, measure, make_cell, resumer, context, science
):
    job, resumer.next_row = cut_short(), None
    asked = measure(go_on(job), POINTS, LINES)
    assert len(make_cell.cell.order.commanded) == len(LONG)
    last = measure(asked, POINTS, LINES, then=State.SUCCEEDED)
    assert len(last.run_ids) == 4
    assert len(science.calls[-1][0]) == 3


def test_a_job_that_waits_for_the_tracker_when_the_service_ends_asks_for_it_again(
    begin, measure, open_dispatcher, until, dispatcher
):
    job = measure(begin(), POINTS, LINES)
    dispatcher.close()
    second = open_dispatcher()
    until(job, State.INTERRUPTED)
    second.acknowledge(job.id)
    ready = until(job, State.READY)
    assert ready.station.number == 2
    asked = measure(ready, POINTS, LINES, dispatcher=second)
    assert asked.station.number == 3
    assert len(asked.run_ids) == 2


def test_a_job_that_continues_one_that_was_cut_short_measures_that_station_whole(
    cut_short, begin, measure, make_cell
):
    job = cut_short()
    again = begin(continues=job.id)
    assert again.station.number == 2
    measure(again, POINTS, LINES)
    assert len(make_cell.cell.order.commanded) == len(LONG)


def test_what_cannot_be_continued_is_refused(begin, measure, dispatcher, plan_id):
    job = measure(begin(), POINTS, LINES)
    with pytest.raises(IllegalTransition, match="goes on by itself"):
        begin(continues=job.id)
    with pytest.raises(NotFound, match="from stations"):
        begin(continues=plan_id)
    dispatcher.abort(job.id)


def test_a_job_keeps_what_its_plan_says_of_places(begin, context):
    assert context.store.read_plan(begin().id)["place"] == ADVICE


def test_a_target_is_not_for_a_plan_of_several_stations(begin, plan_id):
    with pytest.raises(PlanningError, match="leave target_um out"):
        begin(plan_id=plan_id, target_um=1.0)


def test_a_beginning_of_a_plan_ends_at_its_last_station(begin, plan_id, context):
    job = begin(plan_id=plan_id, plan_rows=15)
    assert job.station.total == 2
    plan = context.store.read_plan(job.id)
    assert [len(part["position"]) for part in plan["stations"]] == [11, 4]
    assert [part["duration_s"] for part in plan["stations"]] == [9.0, 6.0]
    assert plan["predicted_um"] == pytest.approx(0.6)
    shares = plan["place"]["at_stations"]
    assert [(one["rows"], one["duration_s"]) for one in shares] == [(11, 9.0), (4, 6.0)]


def test_a_beginning_within_the_first_station_needs_no_other(begin, plan_id, context):
    job = begin(plan_id=plan_id, plan_rows=6)
    plan = context.store.read_plan(job.id)
    assert job.station is None
    assert "stations" not in plan
    assert len(plan["position"]) == 6


@pytest.mark.parametrize(
    ("rows", "why"), [(34, "33 rows"), (2, "add rows"), (12, "1 place")]
)
def test_a_beginning_that_cannot_be_measured_is_refused(begin, plan_id, rows, why):
    with pytest.raises(PlanningError, match=why):
        begin(plan_id=plan_id, plan_rows=rows)
