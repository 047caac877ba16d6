"""A job of several stations asks for the tracker, checks it and loses nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest
from arming import arm_at_once
from scripted_cell import wait_until

from truepath.app.errors import IllegalTransition, NotFound, PlanningError
from truepath.app.files.commanded_file import encode_commanded_json
from truepath.app.files.machine_file import machine_to_json
from truepath.app.jobs.dispatcher import Dispatcher
from truepath.app.jobs.job import JobKind
from truepath.app.jobs.requested_job import RequestedJob
from truepath.app.jobs.transitions import State
from truepath.app.motion.commanded_rows import command_rows

PLACES = ([1200.0, 0.0, 0.0], [0.0, -900.0, 50.0], [-500.0, 300.0, 0.0])
ROWS = (
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0},
    {"x_mm": 400.0, "y_mm": 300.0, "z_mm": 200.0, "feed_mm_min": 1000.0},
)
ADVICE = {"tracker": {}, "stations": {"recommended": 3}, "at_stations": []}
GOOD = {"place_mm": (1.0, 2.0, 3.0)}
BAD = {"problem": "not-moved", "text": "the tracker has not been moved"}


class Checker:
    """Says of each station what the test has said before."""

    def __init__(self):
        self.calls, self.answers = [], []

    def __call__(self, file, before, asked_mm, specification, *, on_progress):
        self.calls.append((file, before, asked_mm))
        return self.answers.pop(0) if self.answers else GOOD


@pytest.fixture
def checker():
    return Checker()


@pytest.fixture
def planner(machine):
    """A plan of as many stations as are asked for."""

    def plan(_, order, *, on_progress):
        path = encode_commanded_json(command_rows(machine, ROWS, is_path=True))
        points = [{k: v for k, v in row.items() if k != "feed_mm_min"} for row in ROWS]
        known = encode_commanded_json(command_rows(machine, points, is_path=False))
        places = PLACES[: order["stations"]]
        return {
            **path,
            "predicted_um": 1.0,
            "document": {"machine": machine_to_json(machine), **ADVICE},
            "stations": [{"position_mm": p, "duration_s": 9.0, **path} for p in places],
            "known_points": known,
            "specification": {},
        }

    return plan


@pytest.fixture
def open_dispatcher(context, event_bus, planner, checker):
    """Opens the service again and again on the same catalogue."""
    opened = []
    full = replace(context, planner=planner, checker=checker)
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
