"""Measurement of fixed rows, without live estimate or further rows."""

from __future__ import annotations

from collections.abc import Collection

from truepath.catalogue.job import Job, Stage
from truepath.catalogue.transitions import State
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.cell_measurement import CellMeasurement
from truepath.jobs.running.context import JobContext
from truepath.measurement.messages import MeasurementOrder
from truepath.motion.configurations import Commanded


def measure_rows(
    job: Job,
    active: ActiveJob,
    context: JobContext,
    commanded: Commanded,
    run_id: str,
    *,
    what: str,
    gives_up: Collection[str] = (),
) -> None:
    """Measure rows; the Run is catalogued in any case.

    what : label in the name of the Run; gives_up : as in `CellMeasurement`

    Raises as `CellMeasurement.run`, and CellDown.
    """
    machine = context.require_machine()
    order = MeasurementOrder(
        run_name=f"{machine.name} {job.created}, {what}",
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
    active.enter(State.RUNNING, Stage.MEASURING)
    try:
        CellMeasurement(
            active,
            context.require_cell(),
            confirm_s=context.confirm_s,
            steering=None,
            gives_up=gives_up,
        ).run(order)
    finally:
        context.runs.add_measured(run_id)
