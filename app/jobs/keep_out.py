"""What extra lines and verifications keep clear of: boxes that are known of the set-up.

They are planned by the service, from Runs of before. Where the request states no boxes,
they keep clear of all that the jobs of these Runs were to keep clear of.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from truepath.app.errors import NotFound
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.job import Job, Json

KEEP_OUT_REMEDY = (
    "ask for other lines or points, or state the boxes that hold now as keep_out"
)


def add_workspace(order: Json, based_on: Job, context: JobContext) -> Json:
    """Return the order of a job that is based on another one's answer, with its boxes.

    order : its `keep_out` is what holds, where it has one

    Boxes of an uploaded Run are unknown; so are those of a catalogue that was rebuilt.
    """
    rest = {key: value for key, value in order.items() if key != "keep_out"}
    boxes = order.get("keep_out")
    if boxes is None:
        boxes = _find_boxes(based_on, context)
    return {**rest, "workspace": {"keep_out": boxes}} if boxes else rest


def _find_boxes(based_on: Job, context: JobContext) -> list[Json]:
    boxes: list[Json] = []
    for job_id in _list_jobs(based_on, context):
        with suppress(NotFound):
            workspace = context.store.read_plan_request(job_id).get("workspace") or {}
            known = workspace.get("keep_out") or ()
            boxes += [box for box in known if box not in boxes]
    return boxes


def _list_jobs(based_on: Job, context: JobContext) -> Iterator[str]:
    """Yield the job, and those that have recorded its Runs."""
    yield based_on.id
    for run_id in based_on.run_ids:
        yield context.runs.read_job_id(run_id)
