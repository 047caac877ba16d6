"""A measurement that was cut short goes on: acknowledged, armed, checked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arming import arm_at_once
from resumption_doubles import PLACES, Closer, Resumer
from scripted_cell import ScriptedLive, Verifier, wait_until

from truepath.catalogue.errors import (
    CellBusy,
    MachineFileChanged,
    NotResumable,
    TaskFailed,
)
from truepath.catalogue.job import Job, JobKind, Stage, StationProgress
from truepath.catalogue.live_notice import OnNotice
from truepath.catalogue.machine_registry import MachineRegistry
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.dispatch.resumability import (
    find_way_to_result,
    may_be_acknowledged,
    require_resumable,
    require_targets_apart,
)
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.jobs.running.resumption import choose_first_row
from truepath.measurement.messages import PartRequested
from truepath.motion.configurations import Configurations
from truepath.planning.adaptive_plan import Part
from truepath_drivers.interfaces.records import Path
from truepath_simulators.scenario import load_machine

PATH = tuple(
    {"x_mm": 20.0 + 40.0 * n, "y_mm": 30.0 + 10.0 * (n % 3), "z_mm": 40.0 + 5.0 * n}
    for n in range(12)
)
OTF = RequestedJob(JobKind.MEASURE_OTF, rows=PATH)


@pytest.fixture
def resumer():
    return Resumer()


@pytest.fixture
def closer():
    return Closer()


@pytest.fixture
def registry(catalogue):
    return MachineRegistry(catalogue)


@pytest.fixture
def describe(context, registry):
    """Gives the machine another file, as a new version."""

    def describe(machine):
        content = machine_to_json(machine)
        version = registry.note("default", "catalogue", content, {})
        one = context.machines.get("default")
        context.machines.put(replace(one, machine=machine, version=version))

    return describe


@pytest.fixture
def lives():
    """The live estimates, the newest last."""
    return []


@pytest.fixture
def verifier():
    return Verifier()


@pytest.fixture
def going_on(context, event_bus, resumer, closer, registry, lives, verifier):
    """A dispatcher that can go on with what was cut short."""

    def follow(order, show):
        lives.append(ScriptedLive(order, show))
        return lives[-1]

    context.require_cell().start()
    full = replace(
        context,
        resumer=resumer,
        closer=closer,
        registry=registry,
        live=follow,
        verifier=verifier,
    )
    dispatcher = Dispatcher(full, event_bus)
    yield dispatcher
    dispatcher.close()


@pytest.fixture
def faulted(going_on, until, make_cell):
    """A measurement that a fault has ended in motion."""

    def make(request=OTF, then=lambda _: None):
        return cut_short(going_on, until, make_cell.cell, request, then)

    return make


def cut_short(going_on, until, cell, request, then):
    """Measure, do what the test wants, then fault."""
    job, _ = going_on.create(request)
    arm_at_once(going_on, job.id, until(job, "ready").version)
    assert cell.begun.wait(5)
    then(cell)
    cell.fault()
    cell.end("faulted")
    return until(job, "faulted")


def drive(going_on, until, cell, job):
    """Acknowledge and arm; let the closure be measured."""
    going_on.acknowledge(job.id)
    cell.begun.clear()
    arm_at_once(going_on, job.id, until(job, "ready").version)
    assert cell.begun.wait(5)
    closure = cell.order
    cell.begun.clear()
    cell.end()
    return closure


@pytest.mark.fault_row(25)
def test_it_stands_where_it_stood_then_drives_what_is_left_as_a_further_run(
    going_on, faulted, until, make_cell, closer, science, context
):
    job, cell = faulted(), make_cell.cell
    closure = drive(going_on, until, cell, job)
    assert isinstance(closure.commanded, Configurations)
    x_mm = closure.commanded.position[:, 0].tolist()
    assert x_mm == [PATH[row]["x_mm"] for row in (1, 2, 3)]
    assert cell.begun.wait(5)
    rest = cell.order
    assert rest.commanded.position[:, 0].tolist() == [r["x_mm"] for r in PATH[3:]]
    assert closer.calls == [tuple(map(tuple, PLACES))]
    cell.end()
    ended = until(job, "succeeded")
    assert ended.run_ids == (job.id, ended.further_run_ids[0])
    files = [str(context.runs.file(run_id)) for run_id in ended.run_ids]
    assert science.calls[0][0] == files
    assert ended.failure is None


def test_nothing_moves_until_it_is_armed_anew(going_on, faulted, until, make_cell):
    job, heard = faulted(), make_cell.cell.heard
    before = len(heard)
    ready = going_on.acknowledge(job.id)
    assert (ready.state, ready.failure, ready.ended) == (State.PREPARING, None, None)
    now = until(job, "ready")
    assert going_on.acknowledge(job.id) == now
    assert heard[before:] == ["connect"]


@pytest.mark.fault_row(11)
def test_a_target_that_is_elsewhere_faults_the_job_and_it_can_be_checked_again(
    going_on, faulted, until, make_cell, closer
):
    job, cell = faulted(), make_cell.cell
    closer.problem = "the target is 51 µm from where it was"
    drive(going_on, until, cell, job)
    refused = until(job, "faulted")
    assert (refused.failure.code, refused.failure.detail) == ("closure", closer.problem)
    assert refused.run_ids == (job.id,)
    closer.problem = ""
    drive(going_on, until, cell, job)
    assert cell.begun.wait(5)
    cell.end()
    assert len(until(job, "succeeded").run_ids) == 2


def test_a_part_that_was_cut_short_too_is_joined_by_a_third(
    going_on, faulted, until, make_cell, resumer, science
):
    job, cell = faulted(), make_cell.cell
    drive(going_on, until, cell, job)
    assert cell.begun.wait(5)
    cell.fault()
    cell.end("faulted")
    until(job, "faulted")
    resumer.next_row = 2
    drive(going_on, until, cell, job)
    assert cell.begun.wait(5)
    assert len(resumer.calls[-1]) == 2
    assert cell.order.commanded.position[0, 0] == PATH[4]["x_mm"]
    cell.end()
    assert len(until(job, "succeeded").run_ids) == 3
    assert len(science.calls[0][0]) == 3


def test_what_tells_no_pose_is_kept_and_the_path_driven_from_its_first_row(
    going_on, faulted, until, make_cell, resumer, science
):
    resumer.next_row = None
    job, cell = faulted(), make_cell.cell
    going_on.acknowledge(job.id)
    cell.begun.clear()
    arm_at_once(going_on, job.id, until(job, "ready").version)
    assert cell.begun.wait(5)
    assert len(cell.order.commanded) == len(PATH)
    cell.end()
    ended = until(job, "succeeded")
    assert ended.run_ids[0] == job.id
    assert len(ended.run_ids) == 2
    assert len(science.calls[0][0]) == 1


def test_few_rows_that_are_left_are_driven_with_some_before_them(
    going_on, faulted, until, resumer, context
):
    resumer.next_row = 12
    job = faulted()
    going_on.acknowledge(job.id)
    until(job, "ready")
    assert context.store.read_plan(job.id)["resumption"]["first_row"] == 5


def test_it_goes_on_only_by_the_machine_file_that_it_was_measured_with(
    going_on, faulted, until, make_cell, context, describe, machine
):
    describe(machine)
    job, cell = faulted(), make_cell.cell
    (target,) = machine.targets
    describe(replace(machine, targets=(replace(target, offset_mm=(1.0, 2.0, -9.0)),)))
    with pytest.raises(MachineFileChanged, match=r"offset_mm is \[1.0, 2.0, -9.0\]"):
        going_on.acknowledge(job.id)
    assert context.store.get(job.id) == job
    describe(machine)
    drive(going_on, until, cell, job)
    assert cell.begun.wait(5)
    assert cell.order.machine_version == 3
    cell.end()
    assert until(job, "succeeded").machine_version == 3


def test_what_fails_before_it_is_armed_leaves_a_measurement_that_can_go_on(
    going_on, faulted, until, resumer
):
    job = faulted()
    resumer.error = TaskFailed("BundleError", "is of another machine file")
    going_on.acknowledge(job.id)
    failure = until(job, "faulted").failure
    assert (failure.family, failure.detail) == ("BundleError", str(resumer.error))
    assert "acknowledge" in failure.action
    resumer.error = None
    going_on.acknowledge(job.id)
    until(job, "ready")


def test_it_does_not_go_on_while_another_job_holds_the_machine(
    going_on, faulted, until
):
    job = faulted()
    other, _ = going_on.create(OTF)
    until(other, "ready")
    with pytest.raises(CellBusy, match=other.id):
        going_on.acknowledge(job.id)


ADAPTIVE = RequestedJob(JobKind.MEASURE_ADAPTIVE, plan_request={"minutes": 8})


def choose_line(cell, live, x_mm):
    """Have the live estimate choose a line after those of the order; tell the cell."""
    position = np.array([cell.order.commanded.position[-1], [x_mm, 90.0, 90.0]])
    part = Path(("X", "Y", "Z"), position, np.full(2, 3000.0), np.zeros(2))
    cell.parts.clear()
    live.parts.append(Part(part, 1, 3.0, 1e-3))
    cell.say(PartRequested(len(cell.order.commanded) - 1))
    wait_until(lambda: cell.parts, "the part")


def test_an_adaptive_measurement_goes_on_at_its_next_line_and_plans_on(
    going_on, faulted, until, make_cell, science, resumer, lives, context
):
    cell = make_cell.cell
    job = faulted(ADAPTIVE, then=lambda _: choose_line(cell, lives[-1], 70.0))
    kept = context.store.read_plan(job.id)["position"]
    assert kept[-1] == [70.0, 90.0, 90.0]
    resumer.next_row = 4
    closure = drive(going_on, until, cell, job)
    assert closure.commanded.position[-1].tolist() == kept[3]
    assert cell.begun.wait(5)
    rest = cell.order
    assert rest.grows
    first_row = context.store.read_plan(job.id)["resumption"]["first_row"]
    assert rest.commanded.position.tolist() == kept[first_row:]
    assert lives[-1].order.earlier_files == (str(context.runs.file(job.id)),)
    choose_line(cell, lives[-1], 110.0)
    now = context.store.read_plan(job.id)
    assert now["position"] == [*kept, [110.0, 90.0, 90.0]]
    assert len(now["parts"]) == 2
    cell.end()
    ended = until(job, "succeeded")
    assert science.calls[0][0] == [
        str(context.runs.file(run_id)) for run_id in ended.run_ids
    ]


def test_what_acts_on_notices_goes_on_with_what_is_left_and_keeps_them(
    going_on, faulted, until, make_cell, resumer, lives, context
):
    """Rows that were driven again count: the Run numbers its rows with them."""
    cell = make_cell.cell
    told = {
        **{"number": 1, "kind": "something-changed", "grade": "likely", "axis": ""},
        **{"since_row": 2, "noticed_row": 2, "noticed_s": 9.0, "size_um": 20.0},
        **{"uncertainty_um": 1.0, "is_over": False},
    }

    def notice(_):
        lives[-1].publish(5.0, 2)
        lives[-1].newest["notices"] = [told]
        (active,) = context.store.list_unfinished()
        wait_until(lambda: context.store.get(active.id).notices, "the notice")
        cell.say(PartRequested(2))
        wait_until(lambda: cell.parts, "the lines that are driven again")

    request = replace(OTF, on_notice=OnNotice.CHECK)
    job = faulted(request, then=notice)
    kept = context.store.read_plan(job.id)["position"]
    assert len(kept) > len(PATH)
    resumer.next_row = 5
    drive(going_on, until, cell, job)
    assert cell.begun.wait(5)
    assert cell.order.grows
    assert cell.order.commanded.position[0].tolist() == kept[4]
    lives[-1].publish(5.0, 2)
    lives[-1].newest["notices"] = [{**told, "axis": "X"}]

    def numbered():
        now = context.store.get(job.id).notices
        return [(n.number, n.since_row) for n in now] == [(1, 2), (2, 6)]

    wait_until(numbered, "both notices")
    cell.end()
    until(job, "succeeded")


def test_points_that_are_measured_again_are_not_gone_back_to_through_a_box(
    going_on, faulted, make_cell, lives, context
):
    places = (20.0, 20.0), (100.0, 100.0), (200.0, 200.0), (300.0, 100.0), (20.0, 30.0)
    points = tuple({"x_mm": x, "y_mm": y, "z_mm": 50.0 + y / 9} for x, y in places)
    box = {"min_mm": [180, 60, 0], "max_mm": [220, 140, 200]}
    cell = make_cell.cell
    told = {
        **{"number": 1, "kind": "something-changed", "grade": "likely", "axis": ""},
        **{"since_row": 2, "noticed_row": 3, "noticed_s": 9.0, "size_um": 20.0},
        **{"uncertainty_um": 1.0, "is_over": False},
    }

    def notice(_):
        cell.say(PartRequested(1))
        wait_until(lambda: len(cell.parts) == 1, "rows 3 and 4")
        lives[-1].publish(5.0, 3)
        lives[-1].newest["notices"] = [told]
        (active,) = context.store.list_unfinished()
        wait_until(lambda: context.store.get(active.id).notices, "the notice")
        cell.say(PartRequested(3))
        wait_until(lambda: len(cell.parts) == 2, "the points that are measured again")

    faulted(
        RequestedJob(
            JobKind.MEASURE_STANDSTILL,
            rows=points,
            on_notice=OnNotice.CHECK,
            plan_request={"workspace": {"keep_out": [box]}},
        ),
        then=notice,
    )
    again = [tuple(row[:2]) for row in cell.parts[1].position.tolist()]
    assert again == [places[2], places[1], places[2], places[3]]


def test_rows_that_are_not_those_of_the_run_are_never_gone_on_with(
    going_on, faulted, until, context
):
    job = faulted()
    plan = dict(context.store.read_plan(job.id))
    plan["position"] = [plan["position"][-1], *plan["position"][:-1]]
    context.store.keep_plan(job.id, plan)
    going_on.acknowledge(job.id)
    assert "not those that its Run was told" in until(job, "faulted").failure.detail


def test_a_verification_goes_on_at_its_next_standstill_and_takes_both_runs(
    going_on, faulted, until, make_cell, verifier, context
):
    job = faulted(replace(OTF, kind=JobKind.MEASURE_STANDSTILL))
    context.store.change(job.id, lambda one: replace(one, kind=JobKind.VERIFY))
    plan = dict(context.store.read_plan(job.id))
    context.store.keep_plan(job.id, {**plan, "request": {"result_id": "a"}})
    found = context.results / "a" / "model.json"
    found.parent.mkdir()
    found.write_text("{}")
    cell = make_cell.cell
    drive(going_on, until, cell, job)
    assert cell.begun.wait(5)
    assert cell.order.commanded.position[0, 0] == PATH[4]["x_mm"]
    cell.end()
    ended = until(job, "succeeded")
    ((files, first_row, *_),) = verifier.calls
    assert files == [str(context.runs.file(run_id)) for run_id in ended.run_ids]
    assert first_row == [0, 4]


@pytest.mark.parametrize(
    ("next_row", "point", "path_row"), [(0, 0, 0), (4, 1, 0), (7, 7, 7), (12, 7, 7)]
)
def test_a_part_begins_with_six_rows_of_its_target_or_with_all_of_them(
    next_row, point, path_row
):
    axes, rows = ("X", "Y", "Z"), np.zeros((12, 3))
    target = ("T1",) * 7 + ("T2",) * 5
    points = Configurations(axes, rows, np.ones(12), target)
    path = Path(axes, rows, np.ones(12), np.zeros(12), target)
    assert choose_first_row(points, next_row) == point
    assert choose_first_row(path, next_row) == path_row


@pytest.mark.parametrize(
    ("scenario", "names", "goes_on"),
    [
        ("demo", ("T1", "T2"), True),
        ("demo", ("T1", "W1"), False),
        ("trunnion", ("T1", "T2"), False),
        ("trunnion", ("T1",), True),
    ],
)
def test_targets_that_only_one_run_joins_keep_a_measurement_from_going_on(
    scenario, names, goes_on
):
    content = load_machine(scenario)
    content.pop("tool_offset_mm", None)
    content["targets"] = load_machine("trunnion")["targets"]
    machine = machine_from_json(content)
    plan = {"target": ["T1"], "stations": [{"target": list(names)}]}
    if goes_on:
        require_targets_apart(plan, machine)
        return
    with pytest.raises(NotResumable, match=f"T1.*{names[-1]}.*have to be measured in"):
        require_targets_apart(plan, machine)


def test_the_closure_stands_where_the_last_target_stood_and_changes_none(
    going_on, faulted, until, context, resumer
):
    job = faulted()
    plan = dict(context.store.read_plan(job.id))
    plan["target"] = ["T1"] * 3 + ["T2"] * 9
    context.store.keep_plan(job.id, plan)
    going_on.acknowledge(job.id)
    until(job, "ready")
    resumption = context.store.read_plan(job.id)["resumption"]
    assert resumption["closure_row"] == [3]
    assert resumption["place_mm"] == PLACES[1:]


def test_a_job_that_only_computes_does_not_go_on():
    job = Job(JobKind.ANALYSE, id="a", state=State.FAULTED, run_id="a")
    with pytest.raises(NotResumable, match=r"only computes.*begin a new job"):
        require_resumable(job, {})


@pytest.mark.parametrize(
    ("stations", "goes_on"),
    [([{"measured": True}, {}], True), ([{"measured": True}] * 2, False)],
)
def test_stations_go_on_until_all_are_measured_whatever_was_computed_last(
    stations, goes_on
):
    job = Job(JobKind.MEASURE_OTF, state=State.FAULTED, stage=Stage.ALIGNING)
    if goes_on:
        require_resumable(job, {"stations": stations})
        return
    with pytest.raises(NotResumable, match="analyse its Runs"):
        require_resumable(job, {"stations": stations})


def test_only_a_fault_or_an_interruption_is_acknowledged(going_on, until, context):
    job, _ = going_on.create(OTF)
    until(job, "ready")
    going_on.abort(job.id)
    until(job, "aborted")
    with pytest.raises(IllegalTransition, match="cannot acknowledge"):
        going_on.acknowledge(job.id)


@pytest.mark.parametrize(
    ("stage", "more", "goes_on", "order"),
    [
        (Stage.MEASURING, {}, True, None),
        (Stage.ESTIMATING, {}, False, '{"kind": "analyse", "run_ids": ["a", "b"]}'),
        (Stage.ALIGNING, {"station": StationProgress(1, 2, (0.0,))}, True, None),
        (Stage.MEASURING, {"kind": JobKind.MEASURE_ADAPTIVE}, True, None),
        (Stage.ALIGNING, {"kind": JobKind.VERIFY}, True, None),
        (
            Stage.DISCOVERING,
            {"kind": JobKind.MEASURE_EXTRA},
            False,
            '{"kind": "discover", "run_ids": ["b", "a"]}',
        ),
    ],
)
def test_only_what_is_not_measured_yet_is_offered_to_go_on(stage, more, goes_on, order):
    job = Job(JobKind.MEASURE_OTF, state=State.INTERRUPTED, run_id="a", stage=stage)
    job = replace(job, further_run_ids=("b",), **more)
    assert may_be_acknowledged(job) is goes_on
    way = find_way_to_result(job)
    assert (order in way) if order else way == ""
    assert not find_way_to_result(replace(job, state=State.SUCCEEDED))
