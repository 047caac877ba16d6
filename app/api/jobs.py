"""Jobs: create, follow, arm, pause, resume, abort; their plans and results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import StringConstraints
from pydantic.json_schema import SkipJsonSchema

from app.api.conditional import Version, etag
from app.api.models.base import PREFIX
from app.api.models.job import JobOut, JobPage, Stopped, job_out
from app.api.models.job_request import JobRequest
from app.api.models.plan import PlanOut
from app.api.paging import After, Limit, cursor, link_next, place
from app.api.problems import answers
from app.api.service import Service, ServiceDep
from app.errors import NotFound
from app.jobs.job import Job
from app.jobs.rows import Key
from app.jobs.transitions import State

router = APIRouter(prefix="/jobs", tags=["jobs"])
results = APIRouter(prefix="/jobs", tags=["results"])
stop = APIRouter(tags=["jobs"])


def _file(media_type: str, kind: str) -> dict[int | str, dict[str, Any]]:
    content = {media_type: {"schema": {"type": kind}}}
    return {200: {"content": content}, **answers(404)}


IdempotencyKey = Annotated[
    Annotated[
        str, StringConstraints(min_length=1, max_length=200, pattern=r"^[\x21-\x7e]+$")
    ]
    | SkipJsonSchema[None],
    Header(description="Of your choice: the same key and body make one job, once."),
]
# Threads of their own: those of other requests may all wait for a device or a disk.
_STOPPING = CapacityLimiter(8)
_REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-popups; default-src 'none'; "
    "script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)


@router.post(
    "",
    operation_id="create_job",
    status_code=202,
    responses=answers(404, 409, 422),
)
def create_job(
    request: JobRequest,
    response: Response,
    service: ServiceDep,
    idempotency_key: IdempotencyKey = None,
) -> JobOut:
    """Take on a job. A measuring job then waits, `ready`, until it is armed."""
    body = request.model_dump_json(exclude_defaults=True).encode()
    key = Key(idempotency_key, body) if idempotency_key else None
    job, _ = service.dispatcher.create(request.wish(), key)
    response.headers["Location"] = f"{PREFIX}/jobs/{job.id}"
    return _out(job, response)


@router.get("", operation_id="list_jobs", responses=answers(422))
def list_jobs(
    request: Request,
    response: Response,
    service: ServiceDep,
    limit: Limit = 50,
    after: After = None,
    state: Annotated[list[State], Query(description="Only in these states.")] = [],  # noqa: B006
) -> JobPage:
    """List jobs, the newest first."""
    jobs = service.store.page(limit + 1, before_seq=place(after), states=state)
    rest = cursor(jobs[limit - 1].seq) if len(jobs) > limit else None
    link_next(request, response, rest)
    return JobPage(items=[job_out(job) for job in jobs[:limit]], next=rest)


@router.get("/{job_id}", operation_id="get_job", responses=answers(404))
def get_job(job_id: str, response: Response, service: ServiceDep) -> JobOut:
    """Return a job; its version is the ETag."""
    return _out(service.store.get(job_id), response)


@router.post(
    "/{job_id}/arm",
    operation_id="arm_job",
    status_code=202,
    responses=answers(404, 409, 412, 428),
)
def arm_job(
    job_id: str, version: Version, response: Response, service: ServiceDep
) -> JobOut:
    """Let a ready job move the machine. From here on it moves."""
    return _out(service.dispatcher.arm(job_id, version), response)


@router.post(
    "/{job_id}/pause",
    operation_id="pause_job",
    status_code=202,
    responses=answers(404, 409),
)
def pause_job(job_id: str, response: Response, service: ServiceDep) -> JobOut:
    """Hold the feed; `paused` once the machine has confirmed. Twice is once."""
    return _out(service.dispatcher.pause(job_id), response)


@router.post(
    "/{job_id}/resume",
    operation_id="resume_job",
    status_code=202,
    responses=answers(404, 409, 412, 428),
)
def resume_job(
    job_id: str, version: Version, response: Response, service: ServiceDep
) -> JobOut:
    """Go on after a hold. The machine moves again."""
    return _out(service.dispatcher.resume(job_id, version), response)


@router.post(
    "/{job_id}/abort",
    operation_id="abort_job",
    status_code=202,
    responses=answers(404),
)
async def abort_job(job_id: str, response: Response, service: ServiceDep) -> JobOut:
    """End a job now, in any state. A job that has ended stays as it is."""
    job = await run_sync(service.dispatcher.abort, job_id, limiter=_STOPPING)
    return _out(job, response)


@stop.post("/stop", operation_id="stop_motion", status_code=202)
async def stop_motion(service: ServiceDep) -> Stopped:
    """Stop all motion and end the jobs behind it. Needs nothing, is never refused."""
    jobs = await run_sync(service.dispatcher.stop, limiter=_STOPPING)
    return Stopped(jobs=[job_out(job) for job in jobs])


@router.get("/{job_id}/plan", operation_id="get_job_plan", responses=answers(404))
def get_plan(job_id: str, service: ServiceDep) -> PlanOut:
    """Return what the job commands, or what the Run it analyses was commanded."""
    job = service.store.get(job_id)
    plan = service.store.plan(job_id)
    if plan is None and job.run_id is None:
        raise NotFound(f"job {job_id} ({job.state}) has no plan")
    if plan is None:
        plan = service.runs.get(job.run_id or "").plan
    return PlanOut(**{**plan, "target_um": job.target_um})


@results.get("/{job_id}/estimate", operation_id="get_estimate", responses=answers(404))
def get_estimate(job_id: str, service: ServiceDep) -> dict[str, Any]:
    """Return the latest estimate of a measurement under way, or of one just ended.

    Values in µm and µrad with standard uncertainties; `volumetric_uncertainty_um` is
    the root mean square, over the axis travel, of the standard uncertainty of the
    volumetric error; `course` says how it came down. What counts in the end is
    `/result`.
    """
    job = service.store.get(job_id)
    estimates = service.feed.estimates
    newest = estimates.newest(job.id)
    if newest is None:
        raise NotFound(f"job {job_id} ({job.state}) has no live estimate yet")
    return {"job_id": job.id, **newest, "course": estimates.course(job.id)}


@results.get(
    "/{job_id}/result",
    operation_id="get_result",
    response_class=FileResponse,
    responses=_file("application/json", "object"),
)
def get_result(job_id: str, service: ServiceDep) -> FileResponse:
    """Return `result.json`: error tables, squareness, uncertainty, observability."""
    return FileResponse(
        _result_file(service, job_id, "result.json"), media_type="application/json"
    )


@results.get(
    "/{job_id}/result/error-tables.json",
    operation_id="get_error_tables",
    responses=answers(404),
)
def get_error_tables(job_id: str, service: ServiceDep) -> dict[str, Any]:
    """Return the error tables and squarenesses alone."""
    file = _result_file(service, job_id, "result.json")
    result = json.loads(file.read_text(encoding="utf-8"))
    return {
        "schema": "error-tables/1",
        "machine": result["machine"],
        "error_tables": result["error_tables"],
        "squareness_urad": result["squareness_urad"],
    }


@results.get(
    "/{job_id}/result/error-tables.csv",
    operation_id="download_error_tables",
    response_class=FileResponse,
    responses=_file("text/csv", "string"),
)
def download_error_tables(job_id: str, service: ServiceDep) -> FileResponse:
    """Return the error tables as `error_tables.csv`."""
    return FileResponse(
        _result_file(service, job_id, "error_tables.csv"),
        media_type="text/csv; charset=utf-8",
        filename="error_tables.csv",
    )


@results.get(
    "/{job_id}/result/report.html",
    operation_id="get_report",
    response_class=FileResponse,
    responses=_file("text/html", "string"),
)
def get_report(job_id: str, service: ServiceDep) -> FileResponse:
    """Return the report, one page that needs nothing else."""
    return FileResponse(
        _result_file(service, job_id, "report.html"),
        media_type="text/html; charset=utf-8",
        headers={"Content-Security-Policy": _REPORT_POLICY},
    )


@results.get(
    "/{job_id}/discovery",
    operation_id="get_discovery",
    response_class=FileResponse,
    responses=_file("application/json", "object"),
)
def get_discovery(job_id: str, service: ServiceDep) -> FileResponse:
    """Return `discovery.json`: the missing effects, the gap, where they disagree."""
    return FileResponse(
        _discovery_file(service, job_id, "discovery.json"),
        media_type="application/json",
    )


@results.get(
    "/{job_id}/discovery/report.html",
    operation_id="get_discovery_report",
    response_class=FileResponse,
    responses=_file("text/html", "string"),
)
def get_discovery_report(job_id: str, service: ServiceDep) -> FileResponse:
    """Return the report of a discovery, one page that needs nothing else."""
    return FileResponse(
        _discovery_file(service, job_id, "report.html"),
        media_type="text/html; charset=utf-8",
        headers={"Content-Security-Policy": _REPORT_POLICY},
    )


def _out(job: Job, response: Response) -> JobOut:
    response.headers["ETag"] = etag(job)
    return job_out(job)


def _discovery_file(service: Service, job_id: str, name: str) -> Path:
    job = service.store.get(job_id)
    file = service.results / job.id / name
    if not job.has_discovery or not file.is_file():
        raise NotFound(f"job {job_id} ({job.kind}, {job.state}) has no {name}")
    return file


def _result_file(service: Service, job_id: str, name: str) -> Path:
    job = service.store.get(job_id)
    file = service.results / job.id / name
    if not job.has_result or not file.is_file():
        raise NotFound(f"job {job_id} ({job.state}) has no {name}")
    return file
