"""Jobs: create, follow, arm, pause, resume, cancel, abort; their commanded rows."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic.json_schema import SkipJsonSchema

from truepath.catalogue.job import Job, JobKind, OnNotice
from truepath.catalogue.transitions import State
from truepath.errors import NotFound
from truepath.service.api.job_description import describe_job
from truepath.service.api.models.base import JobId, MachineId, Time, address
from truepath.service.api.models.jobs.job import JobOut, JobPage
from truepath.service.api.models.jobs.job_request import JobRequest
from truepath.service.api.models.jobs.plan_rows import PlanOut
from truepath.service.api.models.naming import JobNaming, Name
from truepath.service.api.paging import PagingDep
from truepath.service.api.problems import declare_problems
from truepath.service.api.routes.arming import ArmRequest
from truepath.service.api.security.access_control import (
    note_change,
    note_deletion,
    note_naming,
)
from truepath.service.api.security.request_headers import (
    IdempotencyKeyHeader,
    Version,
    format_etag,
    make_key,
)
from truepath.service.api.security.session import ActorDep, owner_of
from truepath.service.api.service import ServiceDep
from truepath.service.api.thread_pools import STOPPING, on_threads

_WHEN = ["2026-01-31T08:00:00Z"]
NamePart = Annotated[
    Name | SkipJsonSchema[None],
    Query(
        description="Only those whose name has this in it, in small letters or "
        "capitals.",
        examples=["spindle"],
    ),
]
Since = Annotated[
    Time | SkipJsonSchema[None],
    Query(description="Created not before this time.", examples=_WHEN),
]
Until = Annotated[
    Time | SkipJsonSchema[None],
    Query(description="Created before this time.", examples=_WHEN),
]

router = APIRouter(prefix="/jobs", tags=["jobs"])


@router.post("", status_code=202, responses=declare_problems(404, 409, 422))
def create_job(
    request: JobRequest,
    response: Response,
    service: ServiceDep,
    actor: ActorDep,
    idempotency_key: IdempotencyKeyHeader = None,
) -> JobOut:
    """Take on a job. A measuring job then waits, `ready`, until it is armed."""
    owner = owner_of(actor)
    key = make_key(idempotency_key, "", request, owner)
    job, _ = service.dispatcher.create(request.to_requested_job(), key, owner=owner)
    response.headers["Location"] = address(f"/jobs/{job.id}")
    return _describe(job, response)


@router.get("", responses=declare_problems(422))
def list_jobs(
    paging: PagingDep,
    service: ServiceDep,
    state: Annotated[list[State], Query(description="Only in these states.")] = [],  # noqa: B006
    kind: Annotated[list[JobKind], Query(description="Only of these kinds.")] = [],  # noqa: B006
    machine: Annotated[
        MachineId | SkipJsonSchema[None], Query(description="Only of this machine.")
    ] = None,
    name: NamePart = None,
    since: Since = None,
    until: Until = None,
) -> JobPage:
    """List jobs, the newest first."""
    list_page = partial(
        service.store.list_page,
        states=state,
        kinds=kind,
        machine=machine,
        name=name,
        since=since,
        until=until,
    )
    jobs, after = paging.read(list_page)
    shown = [service.dispatcher.show(job) for job in jobs]
    return JobPage(items=[describe_job(job) for job in shown], next=after)


@router.get("/{job_id}", responses=declare_problems(404))
def get_job(job_id: JobId, response: Response, service: ServiceDep) -> JobOut:
    """Return a job; its version is the ETag."""
    job = service.dispatcher.show(service.store.get(job_id))
    return _describe(job, response)


@router.patch("/{job_id}", responses=declare_problems(404, 422))
def rename_job(
    job_id: JobId,
    body: JobNaming,
    request: Request,
    response: Response,
    service: ServiceDep,
) -> JobOut:
    """Change name and note of a job, in any state. Its version stays as it is."""
    before = service.store.get(job_id)
    job = service.store.rename(job_id, body.name, body.note)
    note_naming(request, before, job)
    return _describe(service.dispatcher.show(job), response)


@router.delete("/{job_id}", status_code=204, responses=declare_problems(404, 409))
def delete_job(job_id: JobId, request: Request, service: ServiceDep) -> None:
    """Delete a job that has ended, with its answer. Its Runs stay.

    Not one that others were made from, that a machine is held against or that a
    certificate states.
    """
    machine = service.store.get(job_id).machine
    note_deletion(request, [service.deletion.delete_job(job_id)])
    if machine is not None:
        service.calibrations.update_status(machine)


@router.post(
    "/{job_id}/arm",
    status_code=202,
    responses=declare_problems(404, 409, 412, 422, 428),
)
def arm_job(
    job_id: JobId,
    request: ArmRequest,
    version: Version,
    response: Response,
    service: ServiceDep,
    actor: ActorDep,
) -> JobOut:
    """Let a job move the machine that is ready, or has had its tracker moved.

    Only who asked for the job, or has taken control of it, with the token of `arming`.
    """
    by = owner_of(actor)
    job = service.dispatcher.arm(job_id, version, request.token, by=by)
    return _describe(job, response)


@router.post("/{job_id}/pause", status_code=202, responses=declare_problems(404, 409))
@on_threads(STOPPING)
def pause_job(job_id: JobId, response: Response, service: ServiceDep) -> JobOut:
    """Hold the feed; `paused` once the machine has confirmed. Twice is once."""
    return _describe(service.dispatcher.pause(job_id), response)


@router.post(
    "/{job_id}/resume", status_code=202, responses=declare_problems(404, 409, 412, 428)
)
def resume_job(
    job_id: JobId,
    version: Version,
    response: Response,
    service: ServiceDep,
    actor: ActorDep,
    then: Annotated[
        Literal["note", "check", "replan"],
        Query(description="What to do first about the newest notice; see on_notice."),
    ] = "note",
) -> JobOut:
    """Go on after a hold. The machine moves again. Only who has control of the job."""
    by = owner_of(actor)
    job = service.dispatcher.resume(job_id, version, OnNotice(then), by=by)
    return _describe(job, response)


@router.post("/{job_id}/cancel", status_code=202, responses=declare_problems(404, 409))
def cancel_job(job_id: JobId, response: Response, service: ServiceDep) -> JobOut:
    """End a job in order: the line or point under way is finished, its Run is kept.

    One that is held ends where it stands; one that computes ends at once.
    """
    return _describe(service.dispatcher.cancel(job_id), response)


@router.post(
    "/{job_id}/acknowledge", status_code=202, responses=declare_problems(404, 409)
)
def acknowledge_job(
    job_id: JobId, response: Response, service: ServiceDep, actor: ActorDep
) -> JobOut:
    """Prepare a `faulted` or `interrupted` measurement to go on. Moves nothing.

    It is `ready` then, to be armed as any other. Armed, the machine first stands again
    where it stood last; only where the target is seen where it was does it go on.
    """
    job = service.dispatcher.acknowledge(job_id, by=owner_of(actor))
    return _describe(job, response)


@router.post(
    "/{job_id}/take-control", status_code=202, responses=declare_problems(404, 409)
)
def take_control(
    job_id: JobId,
    request: Request,
    response: Response,
    service: ServiceDep,
    actor: ActorDep,
) -> JobOut:
    """Take over who may arm and resume a job. Moves nothing; the audit log says it."""
    now = owner_of(actor)
    job, before = service.dispatcher.take_control(job_id, now)
    note_change(request, old={"controller": before}, new={"controller": now})
    return _describe(job, response)


@router.post("/{job_id}/abort", status_code=202, responses=declare_problems(404))
@on_threads(STOPPING)
def abort_job(job_id: JobId, response: Response, service: ServiceDep) -> JobOut:
    """End a job now, in any state. A job that has ended stays as it is."""
    return _describe(service.dispatcher.abort(job_id), response)


@router.get("/{job_id}/plan", responses=declare_problems(404))
def get_job_plan(job_id: JobId, service: ServiceDep) -> PlanOut:
    """Return what the job commands, or what the Run it analyses was commanded."""
    job = service.store.get(job_id)
    plan = service.store.read_plan(job_id)
    if plan is None and job.run_id is None:
        raise NotFound(f"job {job_id} ({job.state}) has no plan")
    if plan is None:
        plan = service.runs.get(job.run_id or "").plan
    return PlanOut.of(plan, job.target_um)


def _describe(job: Job, response: Response) -> JobOut:
    response.headers["ETag"] = format_etag(job)
    return describe_job(job)
