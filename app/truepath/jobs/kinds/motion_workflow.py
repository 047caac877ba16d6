"""The motion step of a job, monitored by its live estimate."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import structlog
from jaxtyping import Float64

from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import EarlyEnd, Job, JobKind, Json, OnNotice
from truepath.errors import MeasurementFailed
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.cell_measurement import CellMeasurement
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.live_estimation import (
    LiveAlerts,
    LiveEstimation,
    LiveSteering,
)
from truepath.jobs.running.live_process import LiveEstimateOrder
from truepath.measurement.messages import MeasurementOrder
from truepath.motion.configurations import Commanded, join_rows, select_rows
from truepath.motion.paths.plan_segments import PlannedRows
from truepath_drivers.interfaces.records import Path

_OF_FIRST_PART = frozenset({"predicted_um", "document"})

Position = Float64[np.ndarray, " a"]

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class DrivingSteps:
    """One measurement from one station.

    request : as in `plan_requests`, for the live estimate
    run_id : of the Run that is made; equal to the job's where it is the first
    first_row : of the plan, with which the Run begins
    kept_run_ids : Runs of the measurement that is resumed
    """

    job: Job
    active: ActiveJob
    context: JobContext
    request: Json
    run_id: str
    first_row: int = 0
    kept_run_ids: tuple[str, ...] = ()

    def run(self, commanded: Commanded) -> None:
        """Move the machine; recorded data are catalogued even after a failure."""
        planned = self._part(commanded)
        first = commanded if planned is None else planned.driven
        live = self._start_live_estimate(first, len(commanded))
        try:
            if live is None:
                self._reject_without_estimate()
                self._drive(commanded, None, grows=False)
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
        clear = workspace_from_json(self.request.get("workspace") or {}).without_sight

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
        grows = self._is_adaptive or planned is not None
        self._drive(commanded, steering, grows=grows)
        live.finish()
        board.keep((live.newest or {}).get("notices", ()))
        if planned is not None:
            self._store_plan(planned.driven)

    @property
    def _is_adaptive(self) -> bool:
        return self.job.kind is JobKind.MEASURE_ADAPTIVE

    def _drive(
        self, commanded: Commanded, steering: LiveSteering | None, *, grows: bool
    ) -> None:
        machine = self.context.require_machine()
        order = MeasurementOrder(
            run_name=f"{machine.name} {self.job.created}",
            run_file=str(self.context.runs.name_run_file(self.run_id)),
            machine=machine,
            commanded=commanded,
            rate_hz=machine.tracker.rate_hz,
            live=True,
            grows=grows,
            job_id=self.job.id,
            machine_id=self.job.machine or "",
            machine_version=self.job.machine_version or 0,
            active_tables=self.context.read_loaded_files(
                self.job.machine or ""
            ).files_sha256,
        )
        CellMeasurement(
            self.active,
            self.context.require_cell(),
            confirm_s=self.context.confirm_s,
            steering=steering,
        ).run(order)

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
            self.request,
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

    def _reject_without_estimate(self) -> None:
        if self._is_adaptive:
            raise MeasurementFailed("an adaptive measurement needs its live estimate")

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
            plan = store.read_plan(self.job.id) or {}
            before = select_rows(decode_commanded_json(plan), slice(self.first_row))
            kept = {key: plan[key] for key in plan if key not in _OF_FIRST_PART}
            joined = encode_commanded_json(join_rows([before, rows]))
            store.store_plan(self.job.id, {**kept, **joined})
        except StorageUnavailable:
            log.exception("the extended plan is not stored; the Run holds it")
