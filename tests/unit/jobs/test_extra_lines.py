"""Extra lines of a discovery: driven when armed, then explained with all before."""

from dataclasses import replace

import pytest

from scripted_cell import Explorer
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import NotFound, OutOfTravel, PlanningError
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.motion.configurations import Configurations

ROWS = [
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0, "feed_mm_min": 6000.0, "dwell_s": 0.35},
    {"x_mm": 400.0, "y_mm": 10.0, "z_mm": 10.0, "feed_mm_min": 900.0, "dwell_s": 0.35},
]
VICE = {"name": "vice", "min_mm": [200, 0, 0], "max_mm": [300, 50, 50]}
DOOR = {"name": "door", "min_mm": [200, 200, 200], "max_mm": [300, 300, 300]}
PRESS = {"name": "press", "min_mm": [20, 100, 100], "max_mm": [30, 110, 110]}


@pytest.fixture
def explorer():
    asking = Explorer()
    asking.rows = ROWS
    return asking


@pytest.fixture
def lives():
    """Live estimates that were started; none may be."""
    return []


@pytest.fixture
def context(context, explorer, lives):
    return replace(context, discoverer=explorer, live=lambda *_: lives.append(1))


@pytest.fixture
def discover(dispatcher, run, until):
    def done(*run_ids, **more):
        of = run_ids or [run.id]
        job, _ = dispatcher.create(RequestedJob(JobKind.DISCOVER, of, **more))
        return until(job, State.SUCCEEDED)

    return done


@pytest.fixture
def ask(dispatcher, discover):
    def asked(discovery=None, **order):
        asked = {"discovery_id": (discovery or discover()).id, "plan_request": order}
        return dispatcher.create(RequestedJob(JobKind.MEASURE_EXTRA, **asked))[0]

    return asked


@pytest.fixture
def drive(ask, begin, until, cell):
    def done(*discovery, **order):
        job = begin(ask(*discovery, **order))
        cell.end()
        return until(job, State.SUCCEEDED)

    return done


def test_the_lines_are_driven_once_armed_and_all_runs_are_explained_together(
    context, run, ask, drive, explorer, cell, lives, dispatcher, until
):
    job = until(ask(), State.READY)
    dispatcher.abort(job.id)
    assert until(job, State.ABORTED).run_ids
    assert "begin" not in cell.heard
    job = drive()
    path = cell.order.commanded
    assert path.position.tolist() == [[10.0, 10.0, 10.0], [400.0, 10.0, 10.0]]
    assert path.feed_mm_min.tolist() == [6000.0, 900.0]
    assert (job.answer, job.run_ids) == ("discovery", (run.id, job.run_id))
    files, _, _ = explorer.calls[-1]
    assert files == [str(context.runs.file(i)) for i in (run.id, job.run_id)]
    assert not lives


def test_extra_lines_that_were_cut_short_go_on_and_both_runs_are_explained(
    ask, begin, end_in_motion, dispatcher, explorer, resumer, until, run, context, cell
):
    explorer.rows = [ROWS[row % 2] for row in range(9)]
    job, resumer.next_row = end_in_motion(begin(ask())), 3
    dispatcher.acknowledge(job.id)
    begin(job)
    assert isinstance(cell.order.commanded, Configurations), "of the closure"
    cell.begun.clear()
    cell.end()
    assert cell.begun.wait(5)
    assert len(cell.order.commanded) == 7
    cell.end()
    ended = until(job, State.SUCCEEDED)
    assert ended.run_ids == (run.id, job.id, ended.run_id)
    assert explorer.calls[-1][0] == [str(context.runs.file(i)) for i in ended.run_ids]
    assert ended.answer == "discovery"


def test_what_is_open_is_asked_again_of_the_same_model(run, discover, drive, explorer):
    model = discover()
    first = drive(discover(model_id=model.id))
    second = drive(first)
    assert second.run_ids == (run.id, first.run_id, second.run_id)
    assert [call[2] for call in explorer.calls[-2:]] == [model.id] * 2
    assert len(explorer.calls[-1][0]) == 3


def test_lines_out_of_place_are_refused(ask, explorer, dispatcher, run, until):
    analysed = until(dispatcher.create(RequestedJob(JobKind.ANALYSE, [run.id]))[0])
    with pytest.raises(NotFound, match="has no discovery"):
        ask(analysed)
    with pytest.raises(PlanningError, match=r"way to row 2 enters .* vice; .*keep_out"):
        ask(keep_out=[DOOR, VICE])
    explorer.rows = [ROWS[0], {**ROWS[1], "x_mm": 501.0}]
    with pytest.raises(OutOfTravel, match="row 2: X = 501"):
        ask()
    explorer.machine = {**explorer.machine, "name": "lathe"}
    with pytest.raises(PlanningError, match=r"another machine.*name is demo.*lathe"):
        ask()


def test_boxes_of_an_order_hold_beside_those_of_the_runs_that_lines_are_to_explain(
    ask, discover, drive, explorer, context, dispatcher, until
):
    before = drive(keep_out=[DOOR])
    found = discover(before.run_id)
    for stated in ([], [PRESS], [DOOR, PRESS]):
        job = until(ask(found, keep_out=stated), State.READY)
        hold = context.store.read_plan_request(job.id)["workspace"]
        assert hold == {"keep_out": [DOOR, PRESS] if stated else [DOOR]}
        dispatcher.abort(job.id)
        until(job)
    explorer.rows = [{**row, "y_mm": 250.0, "z_mm": 250.0} for row in ROWS]
    found = discover(before.run_id)
    with pytest.raises(PlanningError, match="enters the keep-out box door"):
        ask(found)
    job = ask(found, keep_out=[], keep_out_replaces=True)
    dispatcher.abort(job.id)
    assert "workspace" not in context.store.read_plan_request(job.id)
