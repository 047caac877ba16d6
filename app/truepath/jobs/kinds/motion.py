"""Motions of a measurement: fixed rows, rows with a live estimate, a resumed part."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import structlog
from jaxtyping import Float64

from truepath.catalogue.errors import MachineFault, StorageUnavailable
from truepath.catalogue.job import (
    EarlyEnd,
    JobKind,
    Json,
    OnNotice,
    Stage,
    make_id,
)
from truepath.catalogue.transitions import State
from truepath.errors import MeasurementFailed
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.kinds.job_steps import MachineSteps
from truepath.jobs.running.cell_measurement import CellMeasurement
from truepath.jobs.running.live_estimation import (
    LiveAlerts,
    LiveEstimation,
    LiveSteering,
)
from truepath.jobs.running.live_process import LiveEstimateOrder
from truepath.jobs.running.resumption import (
    Resumption,
    choose_first_row,
    find_target,
    list_part_ids,
)
from truepath.measurement.messages import MeasurementOrder
from truepath.motion.configurations import Commanded, join_rows, select_rows
from truepath.motion.paths.plan_segments import PlannedRows
from truepath_drivers.interfaces.records import Path

_OF_FIRST_PART = frozenset({"predicted_um", "document"})
_SAME = 1e-5  # mm or deg: as rows are rounded where they are kept
_REMEDY = (
    "Look at reflector, its nest and the tracker: one of them has moved since. Put it "
    "back and acknowledge the job to check again, or measure anew; what was recorded "
    "is kept."
)

Position = Float64[np.ndarray, " a"]

log = structlog.get_logger(__name__)


def measure_fixed_rows(
    steps: MachineSteps,
    commanded: Commanded,
    run_id: str,
    label: str,
    *,
    gives_up: Collection[str] = (),
) -> None:
    """Measure rows without live estimate; the Run is catalogued in any case.

    label : in the name of the Run; gives_up : as in `CellMeasurement`

    Raises as `CellMeasurement.run`, and CellDown.
    """
    steps.active.enter(State.RUNNING, Stage.MEASURING)
    try:
        order = _make_order(steps, commanded, run_id, label)
        _measure(order, steps, gives_up=gives_up)
    finally:
        steps.context.runs.add_measured(run_id)


def _make_order(
    steps: MachineSteps, commanded: Commanded, run_id: str, label: str = ""
) -> MeasurementOrder:
    job, context = steps.job, steps.context
    machine = context.require_machine()
    return MeasurementOrder(
        run_name=f"{machine.name} {job.created}{label and f', {label}'}",
        run_file=str(context.runs.name_run_file(run_id)),
        machine=machine,
        commanded=commanded,
        rate_hz=machine.tracker.rate_hz,
        live=True,
        job_id=job.id,
        machine_id=job.machine or "",
        machine_version=job.machine_version or 0,
        active_tables=context.read_loaded_files(job.machine or "").files_sha256,
    )


def _measure(
    order: MeasurementOrder,
    steps: MachineSteps,
    *,
    steering: LiveSteering | None = None,
    gives_up: Collection[str] = (),
) -> None:
    CellMeasurement(
        steps.active,
        steps.context.require_cell(),
        confirm_s=steps.context.confirm_s,
        steering=steering,
        gives_up=gives_up,
    ).run(order)


class MotionSteps:
    """One measurement from one station, with a live estimate where its kind has one.

    run_id : of the Run that is made; equal to the job's where it is the first
    first_row : of the plan, with which the Run begins
    kept_run_ids : Runs of the measurement that is resumed
    """

    def __init__(
        self, steps: MachineSteps, run_id: str, resumption: Resumption | None
    ) -> None:
        self._steps, self._request = steps, steps.request_plan()
        self.job, self.active, self.context = steps.job, steps.active, steps.context
        self.run_id = run_id
        self.first_row = 0 if resumption is None else resumption.first_row
        self.kept_run_ids = () if resumption is None else resumption.kept_run_ids

    def run(self, commanded: Commanded) -> None:
        """Move the machine; recorded data are catalogued even after a failure."""
        planned = self._part(commanded)
        first = commanded if planned is None else planned.driven
        live = self._start_live_estimate(first, len(commanded))
        try:
            if live is None:
                if self._is_adaptive:
                    text = "an adaptive measurement needs its live estimate"
                    raise MeasurementFailed(text)
                order = _make_order(self._steps, commanded, self.run_id)
                _measure(order, self._steps)
                return
            with closing(live):
                self._follow(live, first, planned)
        finally:
            record = self.context.runs.add_measured(self.run_id)
            if record is not None:
                self.active.add_run(record.id)

    def _part(self, commanded: Commanded) -> PlannedRows | None:
        if self._is_adaptive or self.job.on_notice is OnNotice.NOTE:
            return None
        machine = self.context.require_machine()
        clear = workspace_from_json(self._request.get("workspace") or {}).without_sight

        def is_free(begin: Position, end: Position) -> bool:
            return bool(clear.allows(machine, begin[None], end[None])[0])

        return PlannedRows(commanded, is_free)

    def _follow(
        self, live: LiveEstimation, commanded: Commanded, planned: PlannedRows | None
    ) -> None:
        cell, policy = self.context.require_cell(), self.job.on_notice
        board = LiveAlerts(
            self.active,
            cell,
            policy,
            planned,
            first_row=self.first_row,
            before=self.active.job.notices,
        )
        steering = LiveSteering(
            live,
            cell,
            commanded if self._is_adaptive else None,
            self.job.target_um,
            self._store_part,
            self._store_early_end,
            board.show,
            planned,
            self._store_plan,
        )
        order = _make_order(self._steps, commanded, self.run_id)
        order = replace(order, grows=self._is_adaptive or planned is not None)
        _measure(order, self._steps, steering=steering)
        live.finish()
        board.store_notices((live.newest or {}).get("notices", ()))
        if planned is not None:
            self._store_plan(planned.driven)

    @property
    def _is_adaptive(self) -> bool:
        return self.job.kind is JobKind.MEASURE_ADAPTIVE

    def _start_live_estimate(
        self, commanded: Commanded, rows: int
    ) -> LiveEstimation | None:
        """None for extra lines, which alone carry too little information, and for a
        verification, which fits nothing.
        """
        without = JobKind.MEASURE_EXTRA, JobKind.VERIFY
        if self.context.live is None or self.job.kind in without:
            return None
        order = LiveEstimateOrder(
            self.context.require_machine(),
            commanded,
            self.job.perpendicular_only,
            self._request,
            rows - isinstance(commanded, Path),
            tuple(str(self.context.runs.file(run)) for run in self.kept_run_ids),
        )
        live = self.context.live(
            order, lambda body: self.active.publish("estimate", body)
        )
        try:
            live.start()
        except OSError:
            log.exception("no live estimate")
            return None
        return live

    def _store_early_end(self, estimate: Mapping[str, Any]) -> None:
        reached_um = estimate["volumetric_uncertainty_um"]
        log.info("target reached", reached_um=reached_um, target_um=self.job.target_um)
        early_end = EarlyEnd(reached_um, estimate["done"], estimate["total"])
        self.active.store_values(early_end=early_end)

    def _store_part(self, rows: Commanded, part: Mapping[str, Any]) -> None:
        self.active.publish("plan", part)
        self._store_plan(rows)

    def _store_plan(self, rows: Commanded) -> None:
        store = self.context.store
        try:
            plan = self._steps.read_plan()
            before = select_rows(decode_commanded_json(plan), slice(self.first_row))
            kept = {key: plan[key] for key in plan if key not in _OF_FIRST_PART}
            joined = encode_commanded_json(join_rows([before, rows]))
            store.store_plan(self.job.id, {**kept, **joined})
        except StorageUnavailable:
            log.exception("the extended plan is not stored; the Run holds it")


class ResumedSteps:
    """Steps of a job that is resumed."""

    def __init__(self, steps: MachineSteps) -> None:
        self._steps, self.job, self.context = steps, steps.job, steps.context

    def prepare(self) -> None:
        """Find the progress of the job; store with its plan how it is resumed."""
        plan = dict(self._steps.read_plan())
        parts = plan.get("parts") or [{"run_id": self.job.id, "first_row": 0}]
        recorded = set(self.context.runs.find([part["run_id"] for part in parts]))
        parts = [part for part in parts if part["run_id"] in recorded]
        plan |= {"parts": parts, "resumption": None, **self._find(plan, parts)}
        found = plan["resumption"]
        self.context.store.store_plan(self.job.id, plan)
        log.info("the measurement can go on", row=found and found["first_row"])

    def _find(self, plan: Json, parts: Sequence[Json]) -> Mapping[str, Any]:
        """Empty where no recorded data can be used."""
        files = [str(self.context.runs.file(part["run_id"])) for part in parts]
        found = self._steps.compute(
            State.PREPARING,
            Stage.PLANNING,
            self.context.resumer,
            files,
            self.context.require_machine(),
        )
        usable = [k for k, one in enumerate(found) if one is not None]
        if not usable:
            return {}
        last, base = found[usable[-1]], parts[usable[-1]]["first_row"]
        commanded = _append_later_rows(
            plan, base, decode_commanded_json(last["commanded"])
        )
        rows = [base + row for row in last["row"]]
        first, _ = find_target(commanded, rows[-1])
        rows = [row for row in rows if row >= first]  # no target is changed
        resumption = {
            "first_row": choose_first_row(commanded, base + last["next_row"]),
            "kept_run_ids": [parts[k]["run_id"] for k in usable],
            # One row more: the first place is then come to from where it was before.
            "closure_row": [*range(max(rows[0] - 1, first), rows[0]), *rows],
            "place_mm": last["place_mm"][-len(rows) :],
        }
        return {**encode_commanded_json(commanded), "resumption": resumption}

    def begin_part(self, resumption: Resumption, commanded: Commanded) -> str:
        """Check the closure; gives the Run of the part to be measured.

        Raises MachineFault where the target is not where it was.
        """
        run_id, closure_id = make_id(), make_id()
        part = {"run_id": run_id, "first_row": resumption.first_row}
        points = resumption.select_closure(commanded)
        measure_fixed_rows(self._steps, points, closure_id, "closure")
        self._require_closure(resumption, closure_id)
        self._append_part({**part, "closure_id": closure_id})
        return run_id

    def list_kept(self, resumption: Resumption | None) -> tuple[str, ...]:
        """Runs that the answer takes in addition to the part to be measured.

        Of extra lines those of the discovery come first.
        """
        plan = self._steps.read_plan()
        own = {self.job.id, *list_part_ids(plan)}
        others = tuple(run_id for run_id in self.job.run_ids if run_id not in own)
        return (*others, *(() if resumption is None else resumption.kept_run_ids))

    def start_over(self) -> str:
        """Run of a part from the first row, where no earlier Run can be used."""
        run_id = make_id()
        self._append_part({"run_id": run_id, "first_row": 0})
        return run_id

    def _append_part(self, part: Json) -> None:
        plan = dict(self._steps.read_plan())
        plan["parts"] = [*plan["parts"], part]
        self.context.store.store_plan(self.job.id, plan)

    def _require_closure(self, resumption: Resumption, closure_id: str) -> None:
        found = self._steps.compute(
            State.RUNNING,
            Stage.MEASURING,
            self.context.closer,
            str(self.context.runs.file(closure_id)),
            resumption.place_mm,
        )
        log.info("closure checked", **found)
        if found["problem"]:
            raise MachineFault("closure", found["problem"], _REMEDY)


def _append_later_rows(plan: Json, base: int, recorded: Commanded) -> Commanded:
    """A measurement that chooses rows as it moves may have commanded more than the plan
    could store.

    base : row of the plan that the Run begins with

    Raises MeasurementFailed where the plan is another one.
    """
    planned = decode_commanded_json(plan)
    both = min(len(planned) - base, len(recorded))
    apart = planned.position[base : base + both] - recorded.position[:both]
    if np.abs(apart).max(initial=0.0) > _SAME:
        raise MeasurementFailed(
            "the rows that are kept with the job are not those that its Run was told; "
            "begin a new job and analyse the Runs of both together"
        )
    more = select_rows(recorded, slice(both, None))
    left = select_rows(planned, slice(base + both, None))
    return join_rows([select_rows(planned, slice(base + both)), more, left])
