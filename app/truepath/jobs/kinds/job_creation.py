"""A user's request, and the job that a valid one becomes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from truepath.answers.history.model_history import find_model_file
from truepath.catalogue.job import Job, JobKind, Json, OnNotice
from truepath.errors import (
    BadInput,
    BundleError,
    IllegalTransition,
    NotFound,
    NotUsable,
    PlanningError,
)
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.runs_in_time import order_in_time
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.kinds.station_steps import count_measured, list_analysed_ids
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.plan_requests import (
    check_plan_to_drive,
    command_measurable_rows,
    list_station_rows,
    plan_extra_lines,
    reject_several_targets,
)
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.paths.commanded_rows import Row
from truepath.motion.paths.default_points import default_points
from truepath.motion.paths.feeds import check_feed
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import make_verification_rows
from truepath.motion.workspace.travel import check_travel
from truepath.numerics.adaptive_trials import TrialPlan
from truepath_drivers.interfaces.records import Path

_KEEP_OUT_REMEDY = (
    "ask for other lines or points, or, where a box is gone, state those that hold now "
    "as keep_out with keep_out_replaces"
)
_KEEP_OUT_KEYS = ("keep_out", "keep_out_replaces")


@dataclass(frozen=True, slots=True)
class RequestedJob:
    """A job as requested.

    run_ids : the Runs to analyse together
    rows : path or points in the columns of the bundle
    target_um : volumetric uncertainty (k = 1) at which the measurement may end
    plan_id : of a plan to execute; plan_rows : how many rows from its first on
    model_id : of the job whose model or result is the basis of comparison, analysis or
        planning
    discovery_id : of the job whose discovery proposes the extra lines
    continues : job whose unmeasured stations are measured
    plan_request : of a plan or an adaptive measurement, as in `plan_requests`; of a
        trend, as `TrendRequest.of` reads it; of a reanalysis `since`, where it names no
        Runs; of a verification `result_id`, `what`, `seed`, `tolerance_um`,
        `compensation_id`; of that and of extra lines `keep_out`, in addition to those
        of the underlying Runs or, with `keep_out_replaces`, alone
    on_notice : action when the live estimate detects a change
    control_compensation : `on` or `off`, required of the control; None for either
    machine : None for the only one, or that of the plan, job, discovery or result that
        is named
    """

    kind: JobKind
    run_ids: Sequence[str] = ()
    rows: Sequence[Row] | None = None
    feed_mm_min: float | None = None
    perpendicular_only: bool = False
    target_um: float | None = None
    monte_carlo: TrialPlan | None = None
    plan_id: str | None = None
    plan_rows: int | None = None
    model_id: str | None = None
    discovery_id: str | None = None
    continues: str | None = None
    plan_request: Json | None = None
    on_notice: OnNotice = OnNotice.NOTE
    machine: str | None = None
    control_compensation: str | None = None


def check_requested_job(request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
    """The job of a request, and its plan as the store keeps it.

    Raises BadInput (NotUsable of a model, UnnamedMachine), NotFound, NoMachine.
    """
    if not (request.kind.measures or request.kind is JobKind.PLAN):
        return _make_computing_job(request, context)
    machine = context.machines.choose(_name_machine(request, context))
    job, plan = _make_driving_job(request, replace(context, driven=machine))
    job = replace(job, machine=machine.id, machine_version=machine.version)
    return job, _add_wish(request, plan)


def _add_wish(request: RequestedJob, plan: Json) -> Json:
    order = dict(plan.get("request") or {})
    wish = request.control_compensation
    if wish is None and order.get("compensation_id") is not None:
        wish = "on"  # what is proved is the machine with these files
    if wish is None:
        return plan
    return {**plan, "request": {**order, "control_compensation": wish}}


def _name_machine(request: RequestedJob, context: JobContext) -> str | None:
    machine_id = request.machine
    verified = (request.plan_request or {}).get("result_id")
    builds_on = request.plan_id, request.continues, request.discovery_id, verified
    for job_id in builds_on:
        stated = None if job_id is None else context.store.get(job_id).machine
        if stated is not None and machine_id not in (None, stated):
            raise BadInput(
                f"job {job_id} is of machine {stated}, not of {machine_id}; leave "
                "`machine` out, or name another job"
            )
        machine_id = machine_id or stated
    return machine_id


def _make_driving_job(request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
    if request.kind is JobKind.MEASURE_EXTRA:
        return _make_extra_job(request, context)
    if request.kind is JobKind.VERIFY:
        return _make_verifying_job(request, context)
    if request.continues is not None:
        return _continue_job(request.continues, request, context)
    job = Job(
        request.kind,
        perpendicular_only=request.perpendicular_only,
        target_um=request.target_um,
        on_notice=request.on_notice,
    )
    order = _make_plan_request(request, context)
    return job, {**_find_rows(request, context), "request": order}


def _make_computing_job(request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
    if request.kind is JobKind.REANALYSE:
        order = {"run_ids": _choose_runs(request, context)}
        only = request.perpendicular_only
        return Job(request.kind, perpendicular_only=only), {"request": order}
    first, *further = [context.runs.get(run_id).id for run_id in request.run_ids]
    if request.kind is JobKind.TREND:
        _check_order_of_time(request, context)
    job = Job(
        request.kind,
        run_id=first,
        further_run_ids=tuple(further),
        perpendicular_only=request.perpendicular_only,
        monte_carlo=request.monte_carlo,
        machine=_find_machine(request.run_ids, context),
    )
    return job, {"request": _make_plan_request(request, context)}


def _choose_runs(request: RequestedJob, context: JobContext) -> list[str]:
    if request.run_ids:
        found = context.runs.find(request.run_ids)
        missing = [run_id for run_id in request.run_ids if run_id not in set(found)]
        if missing:
            raise NotFound(f"there is no run {missing[0]}")
        return found
    since, name = (request.plan_request or {}).get("since"), None
    if request.machine is not None:
        name = context.machines.get(request.machine).machine.name
    found = context.runs.list_of_machine(name, since)
    if not found:
        raise NotFound(
            f"there is no Run of {name or 'any machine'}"
            f"{f' since {since}' if since else ''}"
        )
    return found


def _find_machine(run_ids: Sequence[str], context: JobContext) -> str | None:
    by_name = {one.machine.name: one.id for one in context.machines.list_all()}
    known = {by_name.get(context.runs.get(run_id).machine) for run_id in run_ids}
    return known.pop() if len(known) == 1 else None


def _check_order_of_time(request: RequestedJob, context: JobContext) -> None:
    at_h = (request.plan_request or {}).get("at_h")
    order_in_time([context.runs.read_times(i) for i in request.run_ids], at_h)


def _find_rows(request: RequestedJob, context: JobContext) -> Json:
    machine, kind = context.require_machine(), request.kind
    if kind is JobKind.PLAN:
        return {}
    context.require_cell()
    check_feed(machine, request.feed_mm_min)
    if kind is JobKind.MEASURE_ADAPTIVE:
        reject_several_targets(machine, dict(request.plan_request or {}))
        return {}
    if request.plan_id is None:
        if request.rows:
            rows, feed_mm_min = request.rows, request.feed_mm_min
            is_path = kind is JobKind.MEASURE_OTF
            return encode_commanded_json(
                command_measurable_rows(machine, rows, feed_mm_min, is_path=is_path)
            )
        if kind is JobKind.MEASURE_STANDSTILL:
            return encode_commanded_json(default_points(machine))
        return {}  # the default path takes a worker process seconds
    job = context.store.get(request.plan_id)
    plan = context.store.read_plan(job.id)
    if job.kind is not JobKind.PLAN:
        raise NotFound(f"there is no plan {request.plan_id}")
    if plan is None:
        raise IllegalTransition(
            f"plan {request.plan_id} is {job.state}; it has no rows"
        )
    if plan.get("stations") and request.target_um is not None:
        raise PlanningError(
            "a plan of several stations is driven to its end; leave target_um out"
        )
    if plan.get("stations") and request.on_notice is not OnNotice.NOTE:
        raise PlanningError(
            "several stations have no live estimate to notice anything; leave "
            "on_notice out"
        )
    return check_plan_to_drive(machine, kind, plan, request.plan_rows)


def _continue_job(
    job_id: str, request: RequestedJob, context: JobContext
) -> tuple[Job, Json]:
    machine = context.require_machine()
    context.require_cell()
    job = context.store.get(job_id)
    plan = context.store.read_plan(job.id) or {}
    stations = plan.get("stations", ())
    if job.kind is not request.kind or not stations:
        raise NotFound(f"job {job.id} ({job.kind}) is no {request.kind} from stations")
    if not job.is_final:
        raise IllegalTransition(f"job {job.id} is {job.state}; it goes on by itself")
    if count_measured(plan) == len(stations):
        raise IllegalTransition(
            f"all stations of job {job.id} are measured; analyse its Runs together"
        )
    for rows in list_station_rows(plan):
        check_travel(machine, rows)
    measured = list_analysed_ids(plan)
    new = Job(
        job.kind,
        run_id=next(iter(measured), None),
        further_run_ids=tuple(measured[1:]),
        perpendicular_only=request.perpendicular_only,
    )
    left = [s if s.get("measured") else _remove_runs(s) for s in stations]
    return new, {**plan, "stations": left}


def _remove_runs(station: Json) -> Json:
    made = {"run_id", "points_id", "parts", "resumption"}
    return {key: value for key, value in station.items() if key not in made}


def _make_extra_job(request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
    machine = context.require_machine()
    context.require_cell()
    job = context.store.get(request.discovery_id or "")
    if not job.has_discovery:
        raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no discovery")
    model_id = context.store.read_plan_request(job.id).get("model_id")
    rows = plan_extra_lines(machine, context.results / job.id, job.id)
    order = {**(request.plan_request or {}), "model_id": model_id}
    order = _add_workspace(order, job, context)
    workspace = workspace_from_json(order.get("workspace") or {})
    workspace.require_allowed(machine, decode_commanded_json(rows), _KEEP_OUT_REMEDY)
    extra = Job(JobKind.MEASURE_EXTRA, further_run_ids=job.run_ids)
    return extra, {**rows, "request": order}


def _make_verifying_job(request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
    machine, order = context.require_machine(), dict(request.plan_request or {})
    context.require_cell()
    job = context.store.get(order["result_id"])
    find_model_file(context.results, job.id)
    if not (job.has_result or job.has_discovery):
        raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no result")
    _require_machine_of_result(job, machine, context)
    if order.get("compensation_id") is not None:
        wish = request.control_compensation
        _require_compensation(order["compensation_id"], job, wish, context)
    kinds = [VerificationKind(kind) for kind in order["what"]]
    order = _add_workspace(order, job, context)
    workspace = workspace_from_json(order.get("workspace") or {})
    rows = make_verification_rows(machine, kinds, order["seed"], workspace)
    check_travel(machine, rows)
    workspace.require_allowed(machine, rows, _KEEP_OUT_REMEDY)
    _require_arcs(rows, context)
    new = Job(JobKind.VERIFY)
    return new, {**encode_commanded_json(rows), "request": order}


def _require_compensation(
    name: str, job: Job, wish: str | None, context: JobContext
) -> None:
    """Only a simulated control reports which files it applies.

    wish : `on` or `off`, required of the control; None for either
    """
    folder = context.results / job.id / "compensations"
    if not (folder / name / "compensation.json").is_file():
        raise NotFound(f"job {job.id} keeps no compensation {name}")
    if wish == "off":
        raise BadInput(
            f"compensation_id {name} asks for a control that corrects by these files, "
            "and control_compensation is off; leave one of the two out"
        )
    machine = context.driven or context.machines.choose(None)
    loaded = context.read_loaded_files(machine.id)
    if loaded.compensation_id is None:  # reported by the control itself
        return
    if (loaded.job_id, loaded.compensation_id) != (job.id, name):
        raise BadInput(
            f"the simulated control of machine {machine.id} has the files "
            f"{loaded.compensation_id} of job {loaded.job_id}, not {name} of job "
            f"{job.id}; load those first, or name the ones that it has"
        )


def _require_arcs(rows: Commanded, context: JobContext) -> None:
    """A control that has not connected yet rejects arcs itself, before it moves."""
    motion = context.require_cell().status.devices.get("motion")
    has_arcs = isinstance(rows, Path) and any(rows.arc)
    if has_arcs and motion is not None and not motion.get("drives_arcs"):
        raise BadInput(
            "this control does not drive arcs, which circles-in-motion are; ask for "
            "circles, which are measured at standstills"
        )


def _require_machine_of_result(job: Job, machine: Machine, context: JobContext) -> None:
    # Imported where it is needed: the service itself carries no science.
    from truepath.files.earlier.result_file import read_result_machine

    file = find_model_file(context.results, job.id)
    try:
        one_machine(
            [read_result_machine(file), machine], ["the result", "the machine now"]
        )
    except BundleError as error:
        raise BadInput(
            f"the result of job {job.id} cannot be verified on {machine.name}: "
            f"{error.problem}; name its own machine, described "
            "as it was measured, or another result"
        ) from error


def _add_workspace(order: Json, based_on: Job, context: JobContext) -> Json:
    """Boxes of both jobs: one that is not repeated still exists, unless
    `keep_out_replaces`. Boxes of an uploaded Run, or of a rebuilt catalogue, are
    unknown.
    """
    rest = {key: value for key, value in order.items() if key not in _KEEP_OUT_KEYS}
    known = () if order.get("keep_out_replaces") else _find_boxes(based_on, context)
    boxes: list[Json] = []
    for box in (*known, *(order.get("keep_out") or ())):
        stated = {key: value for key, value in box.items() if value is not None}
        if stated not in boxes:
            boxes.append(stated)
    return {**rest, "workspace": {"keep_out": boxes}} if boxes else rest


def _find_boxes(based_on: Job, context: JobContext) -> Iterator[Json]:
    for job_id in _list_jobs(based_on, context):
        with suppress(NotFound):
            workspace = context.store.read_plan_request(job_id).get("workspace") or {}
            yield from workspace.get("keep_out") or ()


def _list_jobs(based_on: Job, context: JobContext) -> Iterator[str]:
    yield based_on.id
    for run_id in based_on.run_ids:
        yield context.runs.read_job_id(run_id)


def _make_plan_request(request: RequestedJob, context: JobContext) -> Json:
    """A model that is named has to be usable, except in an analysis: it takes no
    numbers from a model of its own Runs.
    """
    order = dict(request.plan_request or {})
    if request.plan_id is not None:  # what the plan avoids is avoided on the way to it
        planned = context.store.read_plan_request(request.plan_id)
        order |= {key: planned[key] for key in ("workspace",) if key in planned}
    if request.feed_mm_min is not None:
        order["feeds_mm_min"] = [request.feed_mm_min]
    if request.model_id is not None:
        job = context.store.get(request.model_id)
        find_model_file(context.results, job.id)
        if job.verdict == "not-usable" and request.kind is not JobKind.ANALYSE:
            raise NotUsable(f"the model {job.id} is not to be used; see its reasons")
        order["model_id"] = job.id
    return order
