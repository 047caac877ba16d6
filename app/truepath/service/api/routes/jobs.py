"""Jobs: create, follow, arm, pause, resume, cancel, abort; their commanded rows."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field
from pydantic.json_schema import SkipJsonSchema

from truepath.catalogue.job import Job, JobKind, OnNotice, format_utc
from truepath.catalogue.transitions import State
from truepath.errors import NotFound
from truepath.jobs.running.arming import Arming
from truepath.machines.conditions import ConditionType
from truepath.service.api.access_control import note_change, note_deletion, note_naming
from truepath.service.api.job import JobOut, JobPage, describe_job
from truepath.service.api.models.base import (
    JOB_ID,
    JobId,
    JobNaming,
    MachineId,
    Name,
    RequestBody,
    Time,
    address,
    examples,
)
from truepath.service.api.models.job_request import JobRequest
from truepath.service.api.models.plan import PlanOut
from truepath.service.api.problems import declare_problems
from truepath.service.api.request_parameters import (
    IdempotencyKeyHeader,
    PagingDep,
    Version,
    format_etag,
    make_key,
)
from truepath.service.api.routes.machine import ConditionOut
from truepath.service.api.service import (
    STOPPING,
    ActorDep,
    ServiceDep,
    on_threads,
    owner_of,
)

_TOKEN = "Zq3c9xF0mB7sJt2kWvR8yLdPnHe5aUgo"  # noqa: S105 (an example)


class ArmingTarget(BaseModel):
    """A reflector that is measured."""

    name: str = Field(examples=[""], description="Empty for the only one.")
    on: Literal["tool", "workpiece"]
    offset_mm: list[float] = Field(
        examples=[[0.0, 0.0, -120.0]], description="Of the reflector from there."
    )


class AxisRangeOut(BaseModel):
    """How far an axis goes."""

    axis: str = Field(examples=["X"])
    unit: Literal["mm", "deg"]
    low: float = Field(examples=[20.0])
    high: float = Field(examples=[480.0])


class ArmingOut(BaseModel):
    """What the machine will do, and the token to let it: good once, for this only."""

    job: str = Field(examples=[JOB_ID])
    version: int = Field(
        examples=[3], description="Of the job; send it as If-Match when arming."
    )
    machine: str = Field(examples=["default"])
    machine_name: str = Field(examples=["demo mill"])
    machine_version: int = Field(examples=[1])
    targets: list[ArmingTarget]
    envelope: list[AxisRangeOut] = Field(
        description="Swept box of all axes: of the rows, and of the straight way from "
        "where the machine stands to the first of them. Axes that are not named stay "
        "where they are."
    )
    max_feed_mm_min: float = Field(
        examples=[6000.0], description="The largest of the plan."
    )
    duration_s: float = Field(description="As planned, dwells included.")
    rows: int = Field(examples=[23])
    grows: bool = Field(
        description="Further rows are chosen on the way; the envelope is then the "
        "travel of all axes, rows and duration are those known so far."
    )
    conditions: list[ConditionOut]
    obstacles: list[ConditionType] = Field(
        description="Conditions that stand in the way; arming is refused while one does"
    )
    plan_sha256: str = Field(description="Of the rows that the token is for.")
    token: str = Field(examples=[_TOKEN], description="To POST with the arming.")
    expires: str = Field(
        examples=["2026-05-04T09:31:00.000Z"], description="When it can no longer arm."
    )
    expires_in_s: float = Field(examples=[60.0])


class ArmRequest(RequestBody):
    """The token that `arming` has answered with."""

    model_config = examples({"token": _TOKEN})

    token: str = Field(min_length=1, max_length=200, examples=[_TOKEN])


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


@router.post("/{job_id}/arming", responses=declare_problems(404, 409))
def prepare_arming(job_id: JobId, service: ServiceDep, actor: ActorDep) -> ArmingOut:
    """Return what an armed job will move, and the token to arm it. Moves nothing.

    The token is good once, for a short time, for this user and exactly these rows.
    """
    return _describe_arming(
        service.dispatcher.prepare_arming(job_id, by=owner_of(actor))
    )


def _describe(job: Job, response: Response) -> JobOut:
    response.headers["ETag"] = format_etag(job)
    return describe_job(job)


def _describe_arming(arming: Arming) -> ArmingOut:
    driven, motion = arming.machine, arming.motion
    expires = datetime.now(UTC) + timedelta(seconds=arming.valid_s)
    return ArmingOut(
        job=arming.job.id,
        version=arming.job.version,
        machine=driven.id,
        machine_name=driven.machine.name,
        machine_version=driven.version,
        targets=[ArmingTarget.model_validate(asdict(one)) for one in motion.targets],
        envelope=[AxisRangeOut.model_validate(asdict(one)) for one in motion.envelope],
        max_feed_mm_min=motion.max_feed_mm_min,
        duration_s=round(motion.duration_s, 3),
        rows=motion.rows,
        grows=motion.grows,
        conditions=[ConditionOut(**asdict(one)) for one in arming.conditions],
        obstacles=[one.type for one in arming.conditions if one.is_obstacle],
        plan_sha256=arming.plan_sha256,
        token=arming.token,
        expires=format_utc(expires),
        expires_in_s=arming.valid_s,
    )
