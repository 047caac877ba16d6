"""A job of several stations asks for the tracker, checks it and loses nothing."""

from dataclasses import replace

import pytest

from job_builders import OBSERVED, ROWS, arm_at_once
from scripted_cell import PLACES as SEEN_MM
from scripted_cell import wait_until
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition, NotFound, PlanningError
from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.bundle.machine_file import machine_to_json
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.machines.cell_status import ControllerLevels
from truepath.machines.conditions import NotInOrder
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import MotionState, MotionStatus

PLACES = ([1200.0, 0.0, 0.0], [0.0, -900.0, 50.0], [-500.0, 300.0, 0.0])
LONG = tuple({**ROWS[row % 2], "z_mm": 10.0 + row} for row in range(11))
SHARES = [{"position_mm": place, "rows": 11, "duration_s": 9.0} for place in PLACES]
ADVICE = {"tracker": {}, "stations": {"recommended": 3}, "at_stations": SHARES}
CURVE = [
    {"row": row, "time_s": float(row), "volumetric_uncertainty_um": 9.0 / row}
    for row in (6, 15, 33)
]
GOOD = {"place_mm": (1.0, 2.0, 3.0)}
BAD = {"problem": "not-moved", "text": "the tracker has not been moved"}
POINTS, LINES = "Configurations", "Path"
VICE = {"name": "vice", "min_mm": [100, 0, 0], "max_mm": [200, 50, 50]}


class Checker:
    def __init__(self):
        self.calls, self.answers = [], []

    def __call__(self, file, before, planned_mm, asked_mm, specified, *, on_progress):
        self.calls.append((file, before, asked_mm, planned_mm))
        return self.answers.pop(0) if self.answers else GOOD


@pytest.fixture
def checker():
    return Checker()


@pytest.fixture
def context(context, machine, checker):
    def plan(_, order, *, on_progress):
        path = encode_commanded_json(command_rows(machine, LONG, is_path=True))
        points = [{k: v for k, v in row.items() if k != "feed_mm_min"} for row in ROWS]
        known = encode_commanded_json(command_rows(machine, points, is_path=False))
        places = PLACES[: order["stations"]]
        return {
            **path,
            "predicted_um": 1.0,
            "document": {"machine": machine_to_json(machine), **ADVICE, "curve": CURVE},
            "stations": [{"position_mm": p, "duration_s": 9.0, **path} for p in places],
            "known_points": known,
            "specification": {},
        }

    return replace(context, planner=plan, checker=checker)


@pytest.fixture
def restart(dispatcher, open_dispatcher):
    def restart(*, is_killed=False):
        if not is_killed:
            dispatcher.close()
        opened = open_dispatcher()
        opened.interrupt_unfinished_jobs()
        return opened

    return restart


@pytest.fixture
def plan_id(dispatcher, until):
    asked = RequestedJob(JobKind.PLAN, plan_request={"mode": "otf", "stations": 3})
    return until(dispatcher.create(asked)[0], State.SUCCEEDED).id


@pytest.fixture
def prepare(dispatcher, until, plan_id):
    def prepare(dispatcher=dispatcher, **request):
        request = request or {"plan_id": plan_id}
        job, _ = dispatcher.create(RequestedJob(JobKind.MEASURE_OTF, **request))
        return until(job, State.READY)

    return prepare


@pytest.fixture
def measure(dispatcher, cell, until):
    def measured(job, *runs, then=State.AWAITING_MOVE, dispatcher=dispatcher):
        armed = arm_at_once(dispatcher, job.id, job.version)
        for kind in runs:
            wait_until(cell.begun.is_set, "a measurement")
            assert type(cell.order.commanded).__name__ == kind
            cell.begun.clear()
            cell.end()
        return until(armed, then)

    return measured


@pytest.fixture
def moved(prepare, measure):
    return measure(prepare(), POINTS, LINES)


def test_each_station_is_asked_for(prepare, measure, context, checker, science, cell):
    job = prepare()
    assert (job.station.number, job.station.total) == (1, 3)
    assert context.store.read_plan(job.id)["place"] == ADVICE
    for number in (2, 3):
        job = measure(job, POINTS, LINES)
        assert job.station.number == number
        assert list(job.station.position_mm) == PLACES[number - 1]
        assert len(job.run_ids) == number - 1
        assert cell.heard.count("begin") == 2 * (number - 1)
    job = measure(job, POINTS, LINES, then=State.SUCCEEDED)
    assert len(set(job.run_ids)) == 3
    assert science.calls[-1][0] == [str(context.runs.file(i)) for i in job.run_ids]
    assert checker.calls[0][1] is None
    assert checker.calls[0][2:] == (pytest.approx(1500.8, abs=0.1), PLACES[0])
    assert checker.calls[1][1] == checker.calls[0][0]
    assert checker.calls[1][2] == pytest.approx(1500.8, abs=0.1)


def test_a_station_that_known_points_contradict_is_asked_again(moved, measure, checker):
    checker.answers = [BAD, GOOD]
    again = measure(moved, POINTS)
    assert (again.station.number, again.station.checks[-1].problem) == (2, "not-moved")
    assert again.run_ids == moved.run_ids
    last = measure(again, POINTS, LINES)
    assert [check.problem for check in last.station.checks] == ["", ""]


def test_known_points_not_seen_are_no_fault_of_the_job(prepare, begin, cell, until):
    job = begin(prepare())
    cell.begun.clear()
    cell.fault("beam-lost")
    asked = until(job, State.AWAITING_MOVE)
    assert asked.station.checks[-1].problem == "not-seen"
    assert "beam" in asked.station.checks[-1].text
    assert "abort" in cell.heard


def test_the_way_to_a_plan_avoids_what_it_avoids(open_watched, measure, until, cell):
    behind_the_vice = (300.0, 10.0, 10.0)  # it is between here and the known points
    place = [behind_the_vice]

    def observe():
        status = MotionStatus(MotionState.IDLE, place[0], 0, override=1.0)
        read = ControllerLevels(status, "", host_clock.now_s(), ("X", "Y", "Z"))
        return replace(OBSERVED, controller=read)

    dispatcher = open_watched(observe)
    asked = {"mode": "otf", "stations": 2, "workspace": {"keep_out": [VICE]}}
    plan, _ = dispatcher.create(RequestedJob(JobKind.PLAN, plan_request=asked))
    until(plan, State.SUCCEEDED)
    job, _ = dispatcher.create(RequestedJob(JobKind.MEASURE_OTF, plan_id=plan.id))
    ready = until(job, State.READY)
    with pytest.raises(NotInOrder, match="keep-out box vice"):
        arm_at_once(dispatcher, ready.id, ready.version)
    assert "begin" not in cell.heard
    place[0] = (10.0, 300.0, 10.0)
    waits = measure(ready, POINTS, LINES, dispatcher=dispatcher)
    place[0] = behind_the_vice  # jogged while the tracker was moved
    with pytest.raises(NotInOrder, match="keep-out box vice"):
        arm_at_once(dispatcher, waits.id, waits.version)


def test_in_a_move_a_job_is_only_aborted(moved, prepare, dispatcher, until, plan_id):
    with pytest.raises(IllegalTransition, match="goes on by itself"):
        prepare(continues=moved.id)
    with pytest.raises(NotFound, match="from stations"):
        prepare(continues=plan_id)
    dispatcher.abort(moved.id)
    assert until(moved, State.ABORTED).run_ids == moved.run_ids


@pytest.mark.database
@pytest.mark.parametrize("is_killed", [False, True])
def test_a_service_that_ends_meanwhile_loses_nothing_and_another_job_goes_on(
    moved, prepare, measure, restart, until, science, is_killed
):
    second = restart(is_killed=is_killed)
    assert until(moved, State.INTERRUPTED).run_ids == moved.run_ids
    again = prepare(second, continues=moved.id)
    assert (again.station.number, again.run_ids) == (2, moved.run_ids)
    again = measure(again, POINTS, LINES, dispatcher=second)
    last = measure(again, POINTS, LINES, then=State.SUCCEEDED, dispatcher=second)
    assert (last.run_ids[0], len(science.calls[-1][0])) == (moved.run_ids[0], 3)
    with pytest.raises(IllegalTransition, match="all stations"):
        prepare(second, continues=last.id)


def test_a_job_that_waits_for_the_tracker_asks_it_again(moved, measure, restart, until):
    second = restart()
    until(moved, State.INTERRUPTED)
    second.acknowledge(moved.id)
    ready = until(moved, State.READY)
    assert ready.station.number == 2
    asked = measure(ready, POINTS, LINES, dispatcher=second)
    assert (asked.station.number, len(asked.run_ids)) == (3, 2)


@pytest.fixture
def cut_short(moved, dispatcher, cell, end_in_motion):
    arm_at_once(dispatcher, moved.id, moved.version)
    wait_until(cell.begun.is_set, "the known points")
    cell.begun.clear()
    cell.end()
    wait_until(cell.begun.is_set, "the lines")
    cell.begun.clear()
    return end_in_motion(moved)


@pytest.fixture
def go_on(cut_short, dispatcher, until):
    def done():
        dispatcher.acknowledge(cut_short.id)
        return until(cut_short, State.READY)

    return done


def test_a_station_that_was_cut_short_goes_on_with_the_rest_of_its_lines(
    go_on, measure, cell, resumer, closer, context, science
):
    resumer.next_row = 4
    ready = go_on()
    assert ready.station.number == 2
    asked = measure(ready, POINTS, LINES)
    assert asked.station.number == 3
    rest = cell.order.commanded
    assert rest.position[:, 2].tolist() == [10.0 + row for row in range(3, 11)]
    assert closer.calls == [SEEN_MM]
    last = measure(asked, POINTS, LINES, then=State.SUCCEEDED)
    assert len(last.run_ids) == 4
    assert science.calls[-1][0] == [str(context.runs.file(i)) for i in last.run_ids]


@pytest.mark.parametrize("is_put_back", [True, False])
def test_a_moved_station_is_a_new_one(go_on, measure, closer, checker, is_put_back):
    closer.problem = "the target is 51 µm from where it was"
    elsewhere = measure(go_on(), POINTS)
    before = len(checker.calls)
    assert before == 2, "of the first station and of the second"
    (check,) = elsewhere.station.checks
    assert (elsewhere.station.number, check.station, check.problem) == (2, 2, "moved")
    assert closer.problem in check.text
    assert "new station" in check.text
    if is_put_back:
        closer.problem = ""
        assert measure(elsewhere, POINTS, LINES).station.number == 3
        assert len(checker.calls) == before
        return
    checker.answers = [{"problem": "residual", "text": "they do not fit"}, GOOD]
    again = measure(elsewhere, POINTS)
    assert again.station.checks[-1].problem == "residual"
    assert measure(again, POINTS, LINES).station.number == 3
    _, itself, asked_mm, _ = checker.calls[-1]
    assert itself == checker.calls[before - 1][0], "its own known points before"
    assert asked_mm == 0.0


def test_a_run_that_tells_nothing_is_left_out(go_on, measure, cell, resumer, science):
    resumer.next_row = None
    asked = measure(go_on(), POINTS, LINES)
    assert len(cell.order.commanded) == len(LONG)
    last = measure(asked, POINTS, LINES, then=State.SUCCEEDED)
    assert (len(last.run_ids), len(science.calls[-1][0])) == (4, 3)


def test_a_continued_job_measures_its_station_whole(cut_short, prepare, measure, cell):
    again = prepare(continues=cut_short.id)
    assert again.station.number == 2
    measure(again, POINTS, LINES)
    assert len(cell.order.commanded) == len(LONG)


def test_a_beginning_of_a_plan_ends_early(prepare, plan_id, context, dispatcher, until):
    job = prepare(plan_id=plan_id, plan_rows=15)
    assert job.station.total == 2
    plan = context.store.read_plan(job.id)
    assert [len(part["position"]) for part in plan["stations"]] == [11, 4]
    assert [part["duration_s"] for part in plan["stations"]] == [9.0, 6.0]
    assert plan["predicted_um"] == pytest.approx(0.6)
    shares = plan["place"]["at_stations"]
    assert [(one["rows"], one["duration_s"]) for one in shares] == [(11, 9.0), (4, 6.0)]
    for order, why in (
        ({"plan_rows": 34}, "33 rows"),
        ({"plan_rows": 2}, "add rows"),
        ({"plan_rows": 12}, "1 place"),
        ({"target_um": 1.0}, "leave target_um out"),
    ):
        with pytest.raises(PlanningError, match=why):
            prepare(plan_id=plan_id, **order)
    dispatcher.abort(job.id)
    until(job)
    first = prepare(plan_id=plan_id, plan_rows=6)
    plan = context.store.read_plan(first.id)
    assert (first.station, len(plan["position"])) == (None, 6)
    assert "stations" not in plan
