"""Extra lines of a discovery: driven when armed, then explained with all before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arming import arm_at_once
from resumption_doubles import Closer, Resumer
from scripted_cell import Explorer

from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import NotFound, OutOfTravel, PlanningError
from truepath.files.bundle.bundle import zip_bundle
from truepath.files.bundle.run import Run
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import TrackerSamples

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
def resumer():
    return Resumer()


@pytest.fixture
def asking(context, event_bus, explorer, lives, resumer):
    """A dispatcher whose discoveries ask for extra lines."""
    context.require_cell().start()
    full = replace(
        context,
        discoverer=explorer,
        live=lambda *_: lives.append(1),
        resumer=resumer,
        closer=Closer(),
    )
    dispatcher = Dispatcher(full, event_bus)
    yield dispatcher
    dispatcher.close()


@pytest.fixture
def run(context, machine, tmp_path):
    samples = TrackerSamples(
        np.arange(10), np.arange(10) / 500.0, np.ones((10, 3)), np.zeros(10, np.int64)
    )
    points = Configurations(machine.axis_names, np.ones((1, 3)), np.array([1.0]))
    packed = tmp_path / "bundle.zip"
    packed.write_bytes(zip_bundle(Run("b", machine, points, samples)))
    return context.runs.add_uploaded(packed, "from the shop floor")


@pytest.fixture
def discover(asking, run, until):
    """Discover in the Run and wait for the end."""

    def done(*run_ids, **more):
        of = run_ids or [run.id]
        job, _ = asking.create(RequestedJob(JobKind.DISCOVER, of, **more))
        return until(job, State.SUCCEEDED)

    return done


@pytest.fixture
def drive(asking, until, make_cell):
    """Drive the extra lines of a discovery to the end."""

    def done(discovery, **order):
        request = RequestedJob(
            JobKind.MEASURE_EXTRA, discovery_id=discovery.id, plan_request=order
        )
        job = until(asking.create(request)[0], State.READY)
        make_cell.cell.begun.clear()
        arm_at_once(asking, job.id, job.version)
        assert make_cell.cell.begun.wait(5)
        make_cell.cell.end()
        return until(job, State.SUCCEEDED)

    return done


def test_the_lines_are_driven_and_all_runs_are_explained_together(
    context, run, discover, drive, explorer, make_cell, lives
):
    job = drive(discover())
    path = make_cell.cell.order.commanded
    assert path.position.tolist() == [[10.0, 10.0, 10.0], [400.0, 10.0, 10.0]]
    assert path.feed_mm_min.tolist() == [6000.0, 900.0]
    assert job.has_discovery
    assert not job.has_result
    assert job.run_ids == (run.id, job.run_id)
    files, _, _ = explorer.calls[-1]
    assert files == [str(context.runs.file(i)) for i in (run.id, job.run_id)]
    assert not lives


@pytest.fixture
def cut_short(asking, discover, until, make_cell):
    """A measurement of eight extra lines that a fault has ended in motion."""

    def made(explorer):
        explorer.rows = [ROWS[row % 2] for row in range(9)]
        request = RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=discover().id)
        job = until(asking.create(request)[0], State.READY)
        arm_at_once(asking, job.id, job.version)
        assert make_cell.cell.begun.wait(5)
        make_cell.cell.fault()
        make_cell.cell.end("faulted")
        return until(job, State.FAULTED)

    return made


@pytest.fixture
def go_on(asking, until, make_cell):
    """Acknowledge and arm; let so many Runs be measured; return their orders."""

    def done(job, runs):
        asking.acknowledge(job.id)
        cell, orders = make_cell.cell, []
        cell.begun.clear()
        arm_at_once(asking, job.id, until(job, State.READY).version)
        for _ in range(runs):
            assert cell.begun.wait(5)
            cell.begun.clear()
            orders.append(cell.order)
            cell.end()
        return orders

    return done


def test_extra_lines_that_were_cut_short_go_on_and_all_runs_are_explained_together(
    cut_short, go_on, explorer, resumer, until, run, context
):
    job, resumer.next_row = cut_short(explorer), 3
    closure, rest = go_on(job, runs=2)
    assert isinstance(closure.commanded, Configurations)
    assert len(rest.commanded) == 9 - 2
    ended = until(job, State.SUCCEEDED)
    assert ended.run_ids == (run.id, job.id, ended.run_id)
    assert explorer.calls[-1][0] == [str(context.runs.file(i)) for i in ended.run_ids]
    assert ended.has_discovery


def test_extra_lines_that_tell_no_pose_are_driven_again_and_explained_with_the_others(
    cut_short, go_on, explorer, resumer, until, run, context
):
    job, resumer.next_row = cut_short(explorer), None
    (whole,) = go_on(job, runs=1)
    assert len(whole.commanded) == 9
    ended = until(job, State.SUCCEEDED)
    assert ended.run_ids == (run.id, job.id, ended.run_id)
    explained = [str(context.runs.file(i)) for i in (run.id, ended.run_id)]
    assert explorer.calls[-1][0] == explained


def test_nothing_moves_before_it_is_armed(asking, discover, until, make_cell):
    request = RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=discover().id)
    job = until(asking.create(request)[0], State.READY)
    assert "begin" not in make_cell.cell.heard
    asking.abort(job.id)
    assert until(job, State.ABORTED).run_ids
    assert "begin" not in make_cell.cell.heard


def test_the_model_stays_the_one_that_the_discovery_was_held_against(
    discover, drive, explorer
):
    model = discover()
    drive(discover(model_id=model.id))
    assert explorer.calls[-1][2] == model.id


def test_what_is_still_open_is_asked_again(run, discover, drive, explorer):
    first = drive(discover())
    second = drive(first)
    assert second.run_ids == (run.id, first.run_id, second.run_id)
    assert len(explorer.calls[-1][0]) == 3


def test_where_nothing_is_asked_nothing_is_driven(asking, discover, explorer):
    explorer.rows = []
    request = RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=discover().id)
    with pytest.raises(PlanningError, match="asks for no extra lines"):
        asking.create(request)


def test_a_job_without_a_discovery_is_refused(asking, run, until):
    analysed = until(
        asking.create(RequestedJob(JobKind.ANALYSE, [run.id]))[0], State.SUCCEEDED
    )
    for job_id, said in ((analysed.id, "has no discovery"), ("nowhere", "no job")):
        with pytest.raises(NotFound, match=said):
            asking.create(RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=job_id))


def test_lines_for_another_machine_are_refused(asking, discover, explorer):
    explorer.machine = {**explorer.machine, "name": "lathe"}
    request = RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=discover().id)
    with pytest.raises(PlanningError, match=r"another machine.*name is demo.*lathe"):
        asking.create(request)


def test_lines_that_leave_the_travel_are_refused(asking, discover, explorer):
    explorer.rows = [ROWS[0], {**ROWS[1], "x_mm": 501.0}]
    request = RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=discover().id)
    with pytest.raises(OutOfTravel, match="row 2: X = 501"):
        asking.create(request)


def test_lines_through_a_stated_box_are_refused(asking, discover):
    request = RequestedJob(
        JobKind.MEASURE_EXTRA,
        discovery_id=discover().id,
        plan_request={"keep_out": [DOOR, VICE]},
    )
    with pytest.raises(PlanningError, match=r"way to row 2 enters .* vice; .*keep_out"):
        asking.create(request)


def test_lines_keep_clear_of_the_boxes_of_the_runs_that_they_are_to_explain(
    asking, discover, drive, explorer, context
):
    before = drive(discover(), keep_out=[DOOR])
    explorer.rows = [{**row, "y_mm": 250.0, "z_mm": 250.0} for row in ROWS]
    found = discover(before.run_id)
    request = RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=found.id)
    with pytest.raises(PlanningError, match="enters the keep-out box door"):
        asking.create(request)
    gone = {"keep_out": [], "keep_out_replaces": True}
    job, _ = asking.create(replace(request, plan_request=gone))
    asking.abort(job.id)
    assert "workspace" not in context.store.read_plan_request(job.id)


@pytest.mark.parametrize("stated", [[], [PRESS], [DOOR, PRESS]])
def test_boxes_of_an_order_hold_beside_those_of_the_runs(
    asking, discover, drive, explorer, context, stated
):
    before = drive(discover(), keep_out=[DOOR])
    found = discover(before.run_id)
    order = {"keep_out": stated}
    job, _ = asking.create(
        RequestedJob(JobKind.MEASURE_EXTRA, discovery_id=found.id, plan_request=order)
    )
    asking.abort(job.id)
    hold = context.store.read_plan_request(job.id)["workspace"]["keep_out"]
    assert hold == ([DOOR, PRESS] if stated else [DOOR])


def test_the_way_to_extra_lines_is_held_against_the_same_boxes(
    asking, discover, until, context
):
    order = {"keep_out": [DOOR]}
    request = RequestedJob(
        JobKind.MEASURE_EXTRA, discovery_id=discover().id, plan_request=order
    )
    job = until(asking.create(request)[0], State.READY)
    assert context.store.read_plan_request(job.id)["workspace"] == order
    asking.abort(job.id)
