"""Jobs: create, follow, arm, pause, resume, abort; what they command.

The version of a job stands in ETag and If-Match.
"""

from __future__ import annotations

import re
from dataclasses import asdict
from functools import partial
from typing import Annotated, Literal

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Header, Query, Response
from pydantic import BaseModel, Field, StringConstraints
from pydantic.json_schema import SkipJsonSchema
from starlette.exceptions import HTTPException

from app.api.models.base import JOB_ID, PREFIX, Links, Problem
from app.api.models.job_request import JobRequest
from app.api.models.plan import PlanOut
from app.api.paging import PagingDep
from app.api.problems import declare_problems, describe_failure
from app.api.service import ServiceDep
from app.errors import NotFound
from app.files.verdict import State as VerdictState
from app.jobs.job import Job
from app.jobs.store import IdempotencyKey
from app.jobs.transitions import State

router = APIRouter(prefix="/jobs", tags=["jobs"])
stop = APIRouter(tags=["jobs"])


class JobProgress(BaseModel):
    """How far the stage is."""

    done: float
    total: float
    unit: str = Field(examples=["lines"])
    eta_s: float | None
    stage: str = Field(examples=["measuring"])
    elapsed_s: float
    position: list[float] = Field(description="Axis positions in mm and deg.")


class JobHealth(BaseModel):
    """What the tracker's link has seen."""

    samples: int
    lost_samples: int
    crc_errors: int


class ResultLinks(Links):
    """Where the result is."""

    result: Annotated[str, "/jobs/{id}/result"]
    error_tables_json: Annotated[str, "/jobs/{id}/result/error-tables.json"]
    error_tables_csv: Annotated[str, "/jobs/{id}/result/error-tables.csv"]
    report_html: Annotated[str, "/jobs/{id}/result/report.html"]


class DiscoveryLinks(Links):
    """Where the answer of a discovery is."""

    discovery: Annotated[str, "/jobs/{id}/discovery"]
    report_html: Annotated[str, "/jobs/{id}/discovery/report.html"]
    model: Annotated[str, "/models/{id}"]


class JobLinks(Links):
    """Where else to look."""

    self: Annotated[str, "/jobs/{id}"]
    events: Annotated[str, "/jobs/{id}/events"]
    plan: Annotated[str, "/jobs/{id}/plan"]
    run: Annotated[str | None, "/runs/{run_id}"]


class EarlyEndOut(BaseModel):
    """Why the rest of the plan was left out."""

    reason: Literal["target-reached"]
    reached_um: float = Field(
        description="`volumetric_uncertainty_um` (k = 1) at that moment."
    )
    done: int = Field(description="Finished lines or points behind that number.")
    total: int = Field(description="Lines or points of the plan.")


class MonteCarloOut(BaseModel):
    """The trials that were asked for."""

    seed: int
    interval: str = Field(examples=["symmetric"])


class StationCheckOut(BaseModel):
    """How a station agrees with the one before, by the known points."""

    station: int
    place_mm: list[float] | None = Field(
        description="Where the tracker was found, in the frame that it stands on."
    )
    moved_mm: float | None
    residual_um: float | None = Field(
        description="Root mean square distance of the known points from where the "
        "last station saw them."
    )
    allowed_um: float | None
    problem: str = Field(
        examples=["not-moved"],
        description="not-seen, not-moved or residual; empty if the station is good.",
    )
    text: str


class StationOut(BaseModel):
    """The station that is measured, or asked for, of several."""

    number: int = Field(examples=[2])
    total: int = Field(examples=[3])
    position_mm: list[float] = Field(
        description="Where the tracker is to stand, in the frame that it stands on."
    )
    checks: list[StationCheckOut]


class JobOut(BaseModel):
    """A job. `version` counts its changes of state; send it as If-Match."""

    id: str = Field(examples=[JOB_ID])
    kind: str = Field(examples=["measure-otf"])
    state: str = Field(examples=["ready"], description="One of " + ", ".join(State))
    desired_state: str = Field(examples=["ready"])
    version: int = Field(examples=[3])
    stage: str = Field(examples=["measuring"])
    progress: JobProgress
    health: JobHealth
    perpendicular_only: bool
    monte_carlo: MonteCarloOut | None = Field(
        description="The trials that the uncertainty is held against."
    )
    target_um: float | None = Field(
        description="`volumetric_uncertainty_um` (k = 1) at which it may end early."
    )
    early_end: EarlyEndOut | None = Field(description="Null if it did not.")
    verdict: VerdictState | None = Field(
        description="What the result says of itself; the reasons are in it. Null "
        "where there is none."
    )
    station: StationOut | None = Field(
        description="Of a plan of several stations. In the state awaiting-move the "
        "tracker is to be set down at position_mm; then arm the job again."
    )
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    started: str | None
    ended: str | None
    run_id: str | None
    run_ids: list[str] = Field(
        description="All its Runs, in order: `run_id` is the first, of extra lines "
        "the last."
    )
    result: ResultLinks | None
    discovery: DiscoveryLinks | None = Field(
        description="Of a job of kind discover or measure-extra that has succeeded."
    )
    error: Problem | None = Field(
        description="Why it ended badly; in an unfinished job, why it stands."
    )
    links: JobLinks


class JobPage(BaseModel):
    """Jobs, the newest first."""

    items: list[JobOut]
    next: str | None = Field(description="`after` of the next page.")


class Stopped(BaseModel):
    """The jobs that a blanket abort has reached."""

    jobs: list[JobOut]


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
    jobs, after = paging.read(partial(service.store.list_page, states=state))
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
    """Let a job move the machine that is ready, or has had its tracker moved."""
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


def describe_job(job: Job) -> JobOut:
    """Return a job as clients see it."""
    content, failure = asdict(job), job.failure
    content["progress"]["stage"] = job.stage
    if job.early_end:
        content["early_end"]["reason"] = "target-reached"
    return JobOut(
        **content,
        run_ids=list(job.run_ids),
        result=ResultLinks.of(id=job.id) if job.has_result else None,
        discovery=DiscoveryLinks.of(id=job.id) if job.has_discovery else None,
        error=Problem(**describe_failure(failure)) if failure else None,
        links=JobLinks.of(id=job.id, run_id=job.run_id),
    )


def _describe(job: Job, response: Response) -> JobOut:
    response.headers["ETag"] = format_etag(job)
    return describe_job(job)
