"""Jobs: create, follow, arm, pause, resume, abort; what they command.

The version of a job stands in ETag and If-Match.
"""

from __future__ import annotations

import re
from typing import Annotated

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Header, Query, Response
from pydantic import BaseModel, StringConstraints
from pydantic.json_schema import SkipJsonSchema
from starlette.exceptions import HTTPException

from app.api.models.base import PREFIX
from app.api.models.job import JobOut, JobPage, Stopped, describe_job
from app.api.models.job_request import JobRequest
from app.api.models.plan import PlanOut
from app.api.paging import PagingDep
from app.api.problems import declare_problems
from app.api.service import ServiceDep
from app.errors import NotFound
from app.jobs.job import Job
from app.jobs.store import IdempotencyKey
from app.jobs.transitions import State

router = APIRouter(prefix="/jobs", tags=["jobs"])
stop = APIRouter(tags=["jobs"])

IdempotencyKeyHeader = Annotated[
    Annotated[
        str, StringConstraints(min_length=1, max_length=200, pattern=r"^[\x21-\x7e]+$")
    ]
    | SkipJsonSchema[None],
    Header(description="Of your choice: the same key and body make one job, once."),
]
_TAG = re.compile(r'^(?:W/)?"?(\d{1,9})"?$')
# Threads of their own: those of other requests may all wait for a device or a disk.
_STOPPING = CapacityLimiter(8)


def make_key(key: str | None, kind: str, request: BaseModel) -> IdempotencyKey | None:
    """Return the key of a request with the body it came with."""
    body = f"{kind}{request.model_dump_json(exclude_defaults=True)}".encode()
    return IdempotencyKey(key, body) if key else None


def format_etag(job: Job) -> str:
    """Return the ETag of a job: its version."""
    return f'"{job.version}"'


def _version(
    if_match: Annotated[
        str,
        Header(description='Version that was read, `"<version>"`.', examples=['"3"']),
    ] = "",
) -> int:
    """Return the version that If-Match names. 428 without, 412 if it names none."""
    if not if_match or if_match.strip() == "*":
        raise HTTPException(
            428, "this moves the machine: say which version you have read"
        )
    match = _TAG.match(if_match.strip())
    if match is None:
        raise HTTPException(412, f"If-Match {if_match!r} is no version of a job")
    return int(match[1])


Version = Annotated[int, Depends(_version)]


@router.post("", status_code=202, responses=declare_problems(404, 409, 422))
def create_job(
    request: JobRequest,
    response: Response,
    service: ServiceDep,
    idempotency_key: IdempotencyKeyHeader = None,
) -> JobOut:
    """Take on a job. A measuring job then waits, `ready`, until it is armed."""
    key = make_key(idempotency_key, "", request)
    job, _ = service.dispatcher.create(request.to_requested_job(), key)
    response.headers["Location"] = f"{PREFIX}/jobs/{job.id}"
    return _describe(job, response)


@router.get("", responses=declare_problems(422))
def list_jobs(
    paging: PagingDep,
    service: ServiceDep,
    state: Annotated[list[State], Query(description="Only in these states.")] = [],  # noqa: B006
) -> JobPage:
    """List jobs, the newest first."""
    jobs, after = paging.read(
        lambda limit, seq: service.store.list_page(limit, before_seq=seq, states=state)
    )
    return JobPage(items=[describe_job(job) for job in jobs], next=after)


@router.get("/{job_id}", responses=declare_problems(404))
def get_job(job_id: str, response: Response, service: ServiceDep) -> JobOut:
    """Return a job; its version is the ETag."""
    return _describe(service.store.get(job_id), response)


@router.post(
    "/{job_id}/arm", status_code=202, responses=declare_problems(404, 409, 412, 428)
)
def arm_job(
    job_id: str, version: Version, response: Response, service: ServiceDep
) -> JobOut:
    """Let a ready job move the machine. From here on it moves."""
    return _describe(service.dispatcher.arm(job_id, version), response)


@router.post("/{job_id}/pause", status_code=202, responses=declare_problems(404, 409))
def pause_job(job_id: str, response: Response, service: ServiceDep) -> JobOut:
    """Hold the feed; `paused` once the machine has confirmed. Twice is once."""
    return _describe(service.dispatcher.pause(job_id), response)


@router.post(
    "/{job_id}/resume", status_code=202, responses=declare_problems(404, 409, 412, 428)
)
def resume_job(
    job_id: str, version: Version, response: Response, service: ServiceDep
) -> JobOut:
    """Go on after a hold. The machine moves again."""
    return _describe(service.dispatcher.resume(job_id, version), response)


@router.post("/{job_id}/abort", status_code=202, responses=declare_problems(404))
async def abort_job(job_id: str, response: Response, service: ServiceDep) -> JobOut:
    """End a job now, in any state. A job that has ended stays as it is."""
    job = await run_sync(service.dispatcher.abort, job_id, limiter=_STOPPING)
    return _describe(job, response)


@stop.post("/stop", status_code=202)
async def stop_motion(service: ServiceDep) -> Stopped:
    """Stop all motion and end the jobs behind it. Needs nothing, is never refused."""
    jobs = await run_sync(service.dispatcher.stop, limiter=_STOPPING)
    return Stopped(jobs=[describe_job(job) for job in jobs])


@router.get("/{job_id}/plan", responses=declare_problems(404))
def get_job_plan(job_id: str, service: ServiceDep) -> PlanOut:
    """Return what the job commands, or what the Run it analyses was commanded."""
    job = service.store.get(job_id)
    plan = service.store.read_plan(job_id)
    if plan is None and job.run_id is None:
        raise NotFound(f"job {job_id} ({job.state}) has no plan")
    if plan is None:
        plan = service.runs.get(job.run_id or "").plan
    return PlanOut(**{**plan, "target_um": job.target_um})


def _describe(job: Job, response: Response) -> JobOut:
    response.headers["ETag"] = format_etag(job)
    return describe_job(job)
