"""A measurement that was cut short goes on: acknowledged, armed, checked."""

from dataclasses import replace

import numpy as np
import pytest

from scripted_cell import PLACES, ScriptedLives, Verifier, wait_until
from truepath.catalogue import errors
from truepath.catalogue.job import Job, JobKind, OnNotice, Stage, StationProgress
from truepath.catalogue.machine_registry import MachineRegistry
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.running import resumption as resumability
from truepath.jobs.running.resumption import choose_first_row
from truepath.measurement.messages import PartRequested
from truepath.motion.configurations import Configurations
from truepath.planning.adaptive_plan import Part
from truepath_drivers.interfaces.records import Path
from truepath_simulators.machine_file import load_machine

PATH = tuple(
    {"x_mm": 20.0 + 40.0 * n, "y_mm": 30.0 + 10.0 * (n % 3), "z_mm": 40.0 + 5.0 * n}
    for n in range(12)
)
OTF = RequestedJob(JobKind.MEASURE_OTF, rows=PATH)
TWO_TARGETS = {"target": ["T1"] * 3 + ["T2"] * 9}
ADAPTIVE = RequestedJob(JobKind.MEASURE_ADAPTIVE, plan_request={"minutes": 8})
DISCOVER = '{"kind": "discover", "run_ids": ["b", "a"]}'


@pytest.fixture
def lives():
    return ScriptedLives()


@pytest.fixture
def context(context, lives, database):
    parts = {"registry": MachineRegistry(database), "verifier": Verifier()}
    return replace(context, live=lives, **parts)


@pytest.fixture
def faulted(dispatcher, begin, end_in_motion):
    def make(request=OTF, then=lambda: None):
        job = begin(dispatcher.create(request)[0])
        then()
        return end_in_motion(job)

    return make


@pytest.fixture
def drive(dispatcher, begin, cell):
    """Acknowledge and arm; let the closure be measured; wait for what follows."""

    def drive(job, *, goes_on=True):
        dispatcher.acknowledge(job.id)
        begin(job)
        closure = cell.order
        cell.begun.clear()
        cell.end()
        assert not goes_on or cell.begun.wait(5)
        return closure

    return drive


@pytest.fixture
def replan(context):
    def replan(job, **changes):
        plan = dict(context.store.read_plan(job.id))
        context.store.store_plan(job.id, plan | changes)

    return replan


@pytest.mark.database
@pytest.mark.fault_row(25)
def test_it_stands_where_it_stood_then_drives_what_is_left_as_further_runs(
    faulted, drive, end_in_motion, until, cell, closer, resumer, science, context
):
    job = faulted()
    closure = drive(job)
    assert isinstance(closure.commanded, Configurations)
    x_mm = closure.commanded.position[:, 0].tolist()
    assert x_mm == [PATH[row]["x_mm"] for row in (1, 2, 3)]
    assert cell.order.commanded.position[:, 0].tolist() == [r["x_mm"] for r in PATH[3:]]
    assert closer.calls == [tuple(map(tuple, PLACES))]
    end_in_motion(job)  # it is cut short too
    resumer.next_row = 2
    drive(job)
    assert len(resumer.calls[-1]) == 2
    assert cell.order.commanded.position[0, 0] == PATH[4]["x_mm"]
    cell.end()
    ended = until(job, "succeeded")
    assert ended.run_ids == (job.id, *ended.further_run_ids)
    assert len(ended.run_ids) == 3
    files = [str(context.runs.file(run_id)) for run_id in ended.run_ids]
    assert (science.calls[0][0], ended.failure) == (files, None)


@pytest.mark.fault_row(11)
def test_a_target_elsewhere_faults_until_put_back(faulted, drive, until, cell, closer):
    job = faulted()
    closer.problem = "the target is 51 µm from where it was"
    drive(job, goes_on=False)
    refused = until(job, "faulted")
    assert (refused.failure.code, refused.failure.detail) == ("closure", closer.problem)
    assert refused.run_ids == (job.id,)
    closer.problem = ""
    drive(job)
    cell.end()
    assert len(until(job, "succeeded").run_ids) == 2


def test_what_tells_no_pose_is_kept_and_the_path_driven_from_its_first_row(
    dispatcher, faulted, begin, until, cell, resumer, science
):
    resumer.next_row = None
    job = faulted()
    dispatcher.acknowledge(job.id)
    begin(job)
    assert len(cell.order.commanded) == len(PATH)
    cell.end()
    ended = until(job, "succeeded")
    assert (ended.run_ids[0], len(ended.run_ids)) == (job.id, 2)
    assert len(science.calls[0][0]) == 1


@pytest.mark.parametrize(
    ("next_row", "change", "known"),
    [
        (12, {}, {"first_row": 5}),
        (4, TWO_TARGETS, {"closure_row": [3], "place_mm": PLACES[1:]}),
    ],
    ids=["few rows are driven with some before them", "the closure has one target"],
)
def test_what_is_acknowledged_knows_its_rest_and_waits_to_be_armed_anew(
    dispatcher, faulted, until, cell, resumer, replan, context, next_row, change, known
):
    job, resumer.next_row = faulted(), next_row
    replan(job, **change)
    before = len(cell.heard)
    ready = dispatcher.acknowledge(job.id)
    assert (ready.state, ready.failure, ready.ended) == (State.PREPARING, None, None)
    assert until(job, "ready") == dispatcher.acknowledge(job.id)
    assert cell.heard[before:] == ["connect"]
    assert known.items() <= context.store.read_plan(job.id)["resumption"].items()


@pytest.mark.database
def test_it_goes_on_only_by_the_machine_file_that_it_was_measured_with(
    dispatcher, faulted, drive, until, cell, context, machine
):
    def describe(machine):
        given = "default", "catalogue", machine_to_json(machine), {}
        version = context.registry.record_configuration(*given)
        one = context.machines.get("default")
        context.machines.put(replace(one, machine=machine, version=version))

    describe(machine)
    job = faulted()
    (target,) = machine.targets
    describe(replace(machine, targets=(replace(target, offset_mm=(1.0, 2.0, -9.0)),)))
    with pytest.raises(errors.MachineFileChanged, match=r"offset_mm is \[1.0, 2.0, -9"):
        dispatcher.acknowledge(job.id)
    assert context.store.get(job.id) == job
    describe(machine)
    drive(job)
    assert cell.order.machine_version == 3
    cell.end()
    assert until(job, "succeeded").machine_version == 3


def test_what_fails_or_is_not_of_its_run_leaves_a_measurement_that_can_go_on(
    dispatcher, faulted, until, resumer, replan, context
):
    job = faulted()
    rows = context.store.read_plan(job.id)["position"]
    replan(job, position=[rows[-1], *rows[:-1]])
    dispatcher.acknowledge(job.id)
    assert "not those that its Run was told" in until(job, "faulted").failure.detail
    replan(job, position=rows)
    resumer.error = errors.TaskFailed("BundleError", "is of another machine file")
    dispatcher.acknowledge(job.id)
    failure = until(job, "faulted").failure
    assert (failure.family, failure.detail) == ("BundleError", str(resumer.error))
    assert "acknowledge" in failure.action
    resumer.error = None
    dispatcher.acknowledge(job.id)
    until(job, "ready")


def test_nothing_goes_on_beside_a_job_or_after_an_abort(dispatcher, faulted, until):
    job = faulted()
    other = until(dispatcher.create(OTF)[0], "ready")
    with pytest.raises(errors.CellBusy, match=other.id):
        dispatcher.acknowledge(job.id)
    dispatcher.abort(other.id)
    until(other, "aborted")
    with pytest.raises(IllegalTransition, match="cannot acknowledge"):
        dispatcher.acknowledge(other.id)


def test_an_adaptive_measurement_goes_on_at_its_next_line_and_plans_on(
    faulted, drive, until, cell, science, resumer, lives, context
):
    def choose_line(x_mm):
        position = np.array([cell.order.commanded.position[-1], [x_mm, 90.0, 90.0]])
        part = Path(("X", "Y", "Z"), position, np.full(2, 3000.0), np.zeros(2))
        cell.parts.clear()
        lives[-1].parts.append(Part(part, 1, 3.0, 1e-3))
        cell.say(PartRequested(len(cell.order.commanded) - 1))
        wait_until(lambda: cell.parts, "the part")

    job = faulted(ADAPTIVE, then=lambda: choose_line(70.0))
    kept = context.store.read_plan(job.id)["position"]
    assert kept[-1] == [70.0, 90.0, 90.0]
    resumer.next_row = 4
    assert drive(job).commanded.position[-1].tolist() == kept[3]
    rest = cell.order
    assert rest.grows
    first_row = context.store.read_plan(job.id)["resumption"]["first_row"]
    assert rest.commanded.position.tolist() == kept[first_row:]
    assert lives[-1].order.earlier_files == (str(context.runs.file(job.id)),)
    choose_line(110.0)
    now = context.store.read_plan(job.id)
    assert now["position"] == [*kept, [110.0, 90.0, 90.0]]
    assert len(now["parts"]) == 2
    cell.end()
    ended = until(job, "succeeded")
    files = [str(context.runs.file(run_id)) for run_id in ended.run_ids]
    assert science.calls[0][0] == files


@pytest.fixture
def note(lives, context):
    def note(done, expected=((1, 2),), **more):
        told = {
            **{"number": 1, "kind": "something-changed", "grade": "likely", "axis": ""},
            **{"since_row": 2, "noticed_row": done, "noticed_s": 9.0, "size_um": 20.0},
            **{"uncertainty_um": 1.0, "is_over": False},
        }
        lives[-1].publish(5.0, done)
        lives[-1].newest["notices"] = [told | more]
        (active,) = context.store.list_unfinished()

        def numbered():
            now = context.store.get(active.id).notices
            return tuple((n.number, n.since_row) for n in now) == expected

        wait_until(numbered, "the notices")

    return note


def test_notices_are_kept_later(faulted, drive, until, cell, resumer, context, note):
    """Rows that were driven again count: the Run numbers its rows with them."""

    def notice():
        note(2)
        cell.say(PartRequested(2))
        wait_until(lambda: cell.parts, "the lines that are driven again")

    job = faulted(replace(OTF, on_notice=OnNotice.CHECK), then=notice)
    kept = context.store.read_plan(job.id)["position"]
    assert len(kept) > len(PATH)
    resumer.next_row = 5
    drive(job)
    assert cell.order.grows
    assert cell.order.commanded.position[0].tolist() == kept[4]
    note(2, ((1, 2), (2, 6)), axis="X")
    cell.end()
    until(job, "succeeded")


def test_no_point_is_gone_back_to_through_a_box(faulted, cell, note):
    places = (20.0, 20.0), (100.0, 100.0), (200.0, 200.0), (300.0, 100.0), (20.0, 30.0)
    points = tuple({"x_mm": x, "y_mm": y, "z_mm": 50.0 + y / 9} for x, y in places)
    box = {"min_mm": [180, 60, 0], "max_mm": [220, 140, 200]}

    def notice():
        cell.say(PartRequested(1))
        wait_until(lambda: len(cell.parts) == 1, "rows 3 and 4")
        note(3)
        cell.say(PartRequested(3))
        wait_until(lambda: len(cell.parts) == 2, "the points that are measured again")

    avoids = {"plan_request": {"workspace": {"keep_out": [box]}}, "rows": points}
    kind, policy = JobKind.MEASURE_STANDSTILL, OnNotice.CHECK
    faulted(RequestedJob(kind, on_notice=policy, **avoids), then=notice)
    again = [tuple(row[:2]) for row in cell.parts[1].position.tolist()]
    assert again == [places[2], places[1], places[2], places[3]]


def test_a_verification_goes_on(faulted, drive, until, cell, context, replan):
    job = faulted(replace(OTF, kind=JobKind.MEASURE_STANDSTILL))
    context.store.change(job.id, lambda one: replace(one, kind=JobKind.VERIFY))
    replan(job, request={"result_id": "a"})
    found = context.results / "a" / "model.json"
    found.parent.mkdir()
    found.write_text("{}")
    drive(job)
    assert cell.order.commanded.position[0, 0] == PATH[4]["x_mm"]
    cell.end()
    ended = until(job, "succeeded")
    ((files, first_row, *_),) = context.verifier.calls
    assert files == [str(context.runs.file(run_id)) for run_id in ended.run_ids]
    assert first_row == [0, 4]


@pytest.mark.parametrize(
    ("next_row", "point", "path_row"), [(0, 0, 0), (4, 1, 0), (7, 7, 7), (12, 7, 7)]
)
def test_a_part_begins_with_six_rows_of_its_target_or_all(next_row, point, path_row):
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
def test_targets_that_one_run_joins_let_nothing_go_on(scenario, names, goes_on):
    content = load_machine(scenario)
    content.pop("tool_offset_mm", None)
    content["targets"] = load_machine("trunnion")["targets"]
    machine = machine_from_json(content)
    plan = {"target": ["T1"], "stations": [{"target": list(names)}]}
    if goes_on:
        resumability.require_targets_apart(plan, machine)
        return
    with pytest.raises(errors.NotResumable, match=f"T1.*{names[-1]}.*be measured in"):
        resumability.require_targets_apart(plan, machine)


def test_stations_go_on_until_all_are_measured_and_what_computes_does_not():
    ends = {"state": State.FAULTED, "stage": Stage.ALIGNING}
    measuring, done = Job(JobKind.MEASURE_OTF, **ends), {"measured": True}
    resumability.require_resumable(measuring, {"stations": [done, {}]})
    with pytest.raises(errors.NotResumable, match="analyse its Runs"):
        resumability.require_resumable(measuring, {"stations": [done, done]})
    computing = Job(JobKind.ANALYSE, run_id="a", state=State.FAULTED)
    with pytest.raises(errors.NotResumable, match=r"only computes.*begin a new job"):
        resumability.require_resumable(computing, {})


@pytest.mark.parametrize(
    ("stage", "more", "goes_on", "order"),
    [
        (Stage.MEASURING, {}, True, None),
        (Stage.ESTIMATING, {}, False, '{"kind": "analyse", "run_ids": ["a", "b"]}'),
        (Stage.ALIGNING, {"station": StationProgress(1, 2, (0.0,))}, True, None),
        (Stage.MEASURING, {"kind": JobKind.MEASURE_ADAPTIVE}, True, None),
        (Stage.ALIGNING, {"kind": JobKind.VERIFY}, True, None),
        (Stage.DISCOVERING, {"kind": JobKind.MEASURE_EXTRA}, False, DISCOVER),
    ],
)
def test_only_what_is_not_measured_yet_is_offered_to_go_on(stage, more, goes_on, order):
    job = Job(JobKind.MEASURE_OTF, state=State.INTERRUPTED, run_id="a", stage=stage)
    job = replace(job, further_run_ids=("b",), **more)
    assert resumability.may_be_acknowledged(job) is goes_on
    way = resumability.find_way_to_result(job)
    assert (order in way) if order else way == ""
    assert not resumability.find_way_to_result(replace(job, state=State.SUCCEEDED))
