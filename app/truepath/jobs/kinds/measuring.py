"""Plans, and measurements: prepared, armed, moved, analysed."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from truepath.catalogue.errors import CellDown
from truepath.catalogue.job import Job, JobKind, Json, OnNotice, Stage
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition, NotFound, PlanningError
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.kinds.job_steps import MachineSteps, RequestedJob, make_plan_request
from truepath.jobs.kinds.motion import MotionSteps, ResumedSteps
from truepath.jobs.kinds.stations import StationSteps, begin_at_station
from truepath.jobs.running.arming import (
    assess_approach,
    assess_path,
    hash_commanded,
    list_commanded,
)
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.plan_requests import (
    STATION_KEYS,
    command_measurable_rows,
    list_station_rows,
    request_first_part,
    require_measurable,
)
from truepath.jobs.running.resumption import (
    Resumption,
    count_measured,
    list_analysed_ids,
)
from truepath.kinematics.machine.machine import Machine
from truepath.machines.conditions import NO_JOB
from truepath.motion.configurations import Commanded, select_rows
from truepath.motion.paths.commanded_rows import check_feed
from truepath.motion.paths.default_points import default_points
from truepath.motion.workspace import check_travel, moves_relative_to_tracker
from truepath_drivers.interfaces.records import Path


class Plan(MachineSteps):
    """Rows that a measurement may execute."""

    kind = JobKind.PLAN

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """Its rows are chosen when it runs."""
        job = Job(
            request.kind,
            perpendicular_only=request.perpendicular_only,
            target_um=request.target_um,
        )
        return job, {"request": make_plan_request(request, context)}

    def run(self) -> None:
        """Choose the rows, unless that was done before the service ended."""
        if self.context.store.read_plan(self.job.id) is None:
            self.plan(State.RUNNING)
        else:
            self.active.enter(State.RUNNING, Stage.PLANNING)


class Measurement(MachineSteps):
    """A measurement from its plan to its answer."""

    @abstractmethod
    def conclude(self, run_ids: Sequence[str]) -> None:
        """Write the answer from the measured Runs."""

    def run(self) -> None:
        """Plan or prepare the rest, wait to be armed, measure, conclude."""
        job = self.job
        self.context.require_cell()
        self.active.enter(State.PREPARING, Stage.PLANNING)
        plan = self.context.store.read_plan(job.id)
        if plan is None:
            self.plan(State.PREPARING)
        elif job.started is not None:
            steps = self._station_steps if "stations" in plan else self._resumed_steps
            steps.prepare()
        self.conclude(self._measure(self._wait_until_armed()))

    def _wait_until_armed(self) -> Commanded:
        plan = self.read_plan()
        commanded = decode_commanded_json(plan)
        check_travel(self.context.require_machine(), commanded)
        self.context.require_cell().connect()
        self.active.checkpoint()
        begin_at_station(self.active, plan)
        parts = list_commanded(plan)
        self._show_path(parts)
        self._monitor_tracker()
        self.active.enter(State.READY, Stage.MEASURING)
        try:
            self.active.wait_until_armed(hash_commanded(parts), self._monitor_tracker)
        finally:
            self._show_path(())
        return commanded

    def _show_path(self, parts: Sequence[Commanded]) -> None:
        driven = self.context.require_machine_cell()
        if driven.conditions is None:
            return
        order = self.request_plan()
        workspace = workspace_from_json(order.get("workspace") or {})
        machine, board = driven.machine, driven.conditions
        if parts:
            board.assess_approach = partial(assess_approach, machine, parts, workspace)
        board.path = assess_path(machine, parts, workspace) if parts else NO_JOB
        asked = {"on": True, "off": False}.get(order.get("control_compensation", ""))
        board.wants_compensation = asked if parts else None

    def _monitor_tracker(self) -> None:
        driven = self.context.require_machine_cell()
        if driven.conditions is None:
            return
        machine = driven.machine
        rate_hz, aims = machine.tracker.rate_hz, len(machine.targets) > 1
        with suppress(CellDown):  # that is a separate condition
            driven.cell.monitor_tracker_at_rest(rate_hz, aims=aims)

    def _measure(self, commanded: Commanded) -> tuple[str, ...]:
        plan, job = self.read_plan(), self.job
        if "stations" in plan:
            return self._station_steps.run()
        resumption, run_id, before = Resumption.read(plan), job.id, job.run_ids
        if job.started is not None:
            before = self._resumed_steps.list_kept(resumption)
        if resumption is not None:
            run_id = self._resumed_steps.begin_part(resumption, commanded)
            commanded = resumption.select_rest(commanded)
        elif job.started is not None:
            run_id = self._resumed_steps.start_over()
        MotionSteps(self, run_id, resumption).run(commanded)
        return tuple(dict.fromkeys((*before, run_id)))

    @property
    def _resumed_steps(self) -> ResumedSteps:
        return ResumedSteps(self)

    @property
    def _station_steps(self) -> StationSteps:
        return StationSteps(self, self._monitor_tracker, self._show_path)


class MeasureOtf(Measurement):
    """A path measured on the fly, to error tables."""

    kind = JobKind.MEASURE_OTF

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """Rows of the request, of its plan, or the default of the machine."""
        if request.continues is not None:
            return _continue_job(request.continues, request, context)
        order = make_plan_request(request, context)
        check_feed(context.require_machine(), request.feed_mm_min)
        rows = cls.choose_rows(request, context)
        job = Job(
            request.kind,
            perpendicular_only=request.perpendicular_only,
            target_um=request.target_um,
            on_notice=request.on_notice,
        )
        return job, {**rows, "request": order}

    @classmethod
    def choose_rows(cls, request: RequestedJob, context: JobContext) -> Json:
        """Rows as the plan keeps them; empty where a worker process chooses them."""
        machine, is_path = context.require_machine(), cls.kind is JobKind.MEASURE_OTF
        if request.plan_id is not None:
            return _choose_planned_rows(request.plan_id, request, context)
        if request.rows:
            return encode_commanded_json(
                command_measurable_rows(
                    machine, request.rows, request.feed_mm_min, is_path=is_path
                )
            )
        if is_path:
            return {}  # the default path takes a worker process seconds
        return encode_commanded_json(default_points(machine))

    def conclude(self, run_ids: Sequence[str]) -> None:
        """Analyse."""
        self.analyse(run_ids)


class MeasureStandstill(MeasureOtf):
    """Points measured at rest, to error tables."""

    kind = JobKind.MEASURE_STANDSTILL


class MeasureAdaptive(MeasureOtf):
    """Rows chosen as it moves, by its live estimate, to error tables."""

    kind = JobKind.MEASURE_ADAPTIVE

    @classmethod
    def choose_rows(cls, request: RequestedJob, context: JobContext) -> Json:
        """None before it moves, for one target that moves."""
        machine, order = context.require_machine(), request.plan_request or {}
        moving = [t for t in machine.targets if moves_relative_to_tracker(machine, t)]
        if order.get("mode") == "standstill" and len(moving) > 1:
            raise PlanningError(
                f"{machine.name} has {len(moving)} targets that move; adaptive "
                "standstills are for one; plan them, then measure at standstill"
            )
        return {}

    def plan(self, state: State) -> None:
        """Have the first part chosen, and store it."""
        machine = self.context.require_machine()
        task = self.context.planner
        order = request_first_part(machine, self.request_plan())
        plan = self.compute(state, Stage.PLANNING, task, machine, order)
        self.context.store.store_plan(self.job.id, plan)


def _choose_planned_rows(
    plan_id: str, request: RequestedJob, context: JobContext
) -> Json:
    job = context.store.get(plan_id)
    plan = context.store.read_plan(job.id)
    if job.kind is not JobKind.PLAN:
        raise NotFound(f"there is no plan {plan_id}")
    if plan is None:
        raise IllegalTransition(f"plan {plan_id} is {job.state}; it has no rows")
    if plan.get("stations") and request.target_um is not None:
        raise PlanningError(
            "a plan of several stations is driven to its end; leave target_um out"
        )
    if plan.get("stations") and request.on_notice is not OnNotice.NOTE:
        raise PlanningError(
            "several stations have no live estimate to notice anything; leave "
            "on_notice out"
        )
    machine, kind = context.require_machine(), request.kind
    return _check_plan(machine, kind, plan, request.plan_rows)


def _check_plan(
    machine: Machine, kind: JobKind, plan: Json, count: int | None
) -> dict[str, Any]:
    commanded = decode_commanded_json(plan)
    if isinstance(commanded, Path) != (kind is JobKind.MEASURE_OTF):
        wanted = (
            JobKind.MEASURE_OTF
            if isinstance(commanded, Path)
            else JobKind.MEASURE_STANDSTILL
        )
        raise PlanningError(f"the plan is one for {wanted}, not for {kind}")
    now = json.loads(json.dumps(machine_to_json(machine)))  # as the catalogue keeps it
    if plan["document"]["machine"] != now:
        raise PlanningError(
            "the machine file has changed since this plan was made; plan again"
        )
    if count is not None:
        plan = _select_beginning(machine, plan, count)
        commanded = decode_commanded_json(plan)
    for rows in (commanded, *list_station_rows(plan)):
        check_travel(machine, rows)
    kept = {"predicted_um", *STATION_KEYS} & set(plan)
    document = plan["document"]
    place = {key: document.get(key) for key in ("tracker", "stations", "at_stations")}
    return {
        **encode_commanded_json(commanded),
        **{key: plan[key] for key in sorted(kept)},
        "tracker_mm": document.get("tracker", {}).get("position_mm"),
        **({"place": place} if place["stations"] else {}),
    }


def _select_beginning(machine: Machine, plan: Json, count: int) -> Json:
    document, left = dict(plan["document"]), count
    whole = plan.get("stations") or [plan]
    kept = list[dict[str, Any]]()
    for part in whole:
        rows = select_rows(decode_commanded_json(part), slice(max(left, 0)))
        if len(rows):
            require_measurable(machine, rows)
            kept.append({**part, **encode_commanded_json(rows)})
        left -= len(part["position"])
    if left > 0:
        raise PlanningError(
            f"the plan has {count - left} rows, not {count}; give fewer"
        )
    driven = [point for point in document["curve"] if point["row"] <= count]
    last = driven[-1] if driven else {}
    predicted_um = last.get("volumetric_uncertainty_um")
    plan = {**plan, **kept[0], "document": document, "predicted_um": predicted_um}
    if len(whole) == 1:
        return plan
    before_s = sum(part["duration_s"] for part in kept[:-1])
    took_s = round(last.get("time_s", before_s) - before_s, 3)
    kept[-1]["duration_s"] = took_s
    *shares, share = document["at_stations"][: len(kept)]
    now = {"duration_s": took_s, "rows": len(kept[-1]["position"])}
    share = {key: last.get(key, value) for key, value in share.items()} | now
    document["at_stations"] = [*shares, share]
    if len(kept) > 1:
        return {**plan, "stations": kept}
    return {key: plan[key] for key in plan.keys() - set(STATION_KEYS)}


def _continue_job(
    job_id: str, request: RequestedJob, context: JobContext
) -> tuple[Job, Json]:
    machine = context.require_machine()
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
