"""What extra lines and verifications keep clear of: boxes that are known of the set-up.

They are planned by the service, from Runs of before. They keep clear of all that the
jobs of these Runs were to keep clear of, and of the boxes that the request adds: a box
that is not stated again is still there, unless the request says that it is gone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from truepath.app.errors import NotFound
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.job import Job, Json

KEEP_OUT_REMEDY = (
    "ask for other lines or points, or, where a box is gone, state those that hold now "
    "as keep_out with keep_out_replaces"
)
_KEYS = ("keep_out", "keep_out_replaces")


def add_workspace(order: Json, based_on: Job, context: JobContext) -> Json:
    """Return the order of a job that is based on another one's answer, with its boxes.

    order : its `keep_out` holds as well; alone with `keep_out_replaces`

    Boxes of an uploaded Run are unknown; so are those of a catalogue that was rebuilt.
    """
    rest = {key: value for key, value in order.items() if key not in _KEYS}
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
    """Yield the job, and those that have recorded its Runs."""
    yield based_on.id
    for run_id in based_on.run_ids:
        yield context.runs.read_job_id(run_id)
