"""Plans: made, looked at, taken to a control or handed to a measuring job."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse

from app.api.jobs import IdempotencyKeyHeader, format_etag, make_key
from app.api.models.base import PREFIX, Problem
from app.api.models.plan import (
    PlanCheck,
    PlanCheckOut,
    PlanOut,
    PlanRequest,
    PlanResource,
    plan_links,
)
from app.api.problems import declare_problems, describe_failure
from app.api.service import Service, ServiceDep
from app.api.set_ups import PROGRAM, Dialect, make_program_response
from app.errors import NotFound
from app.jobs.errors import NoMachine
from app.jobs.job import Job, JobKind
from app.jobs.plan_orders import check_rows
from app.jobs.plans import commanded_from_plan
from app.jobs.requested_job import RequestedJob

router = APIRouter(prefix="/plans", tags=["plans"])
checks = APIRouter(tags=["plans"])


@router.post("", status_code=202, responses=declare_problems(404, 409, 422))
def create_plan(
    request: PlanRequest,
    response: Response,
    service: ServiceDep,
    idempotency_key: IdempotencyKeyHeader = None,
) -> PlanResource:
    """Choose the measurement that tells most in its time. Nothing moves.

    A job of the same identifier computes it; follow that one's events, or ask again.
    """
    requested = RequestedJob(
        JobKind.PLAN,
        perpendicular_only=request.perpendicular_only,
        target_um=request.target_um,
        model_id=request.model_id,
        plan_request=request.order(),
    )
    key = make_key(idempotency_key, "plan ", request)
    job, _ = service.dispatcher.create(requested, key)
    response.headers["Location"] = f"{PREFIX}/plans/{job.id}"
    return _describe(job, response, service)


@checks.post("/plans:validate", responses=declare_problems(409, 422))
def validate_plan(check: PlanCheck, service: ServiceDep) -> PlanCheckOut:
    """Check rows over the whole swept path; a refusal names row and reason."""
    if service.machine is None:
        raise NoMachine
    kind = JobKind.MEASURE_STANDSTILL if check.path is None else JobKind.MEASURE_OTF
    workspace = check.workspace.model_dump(exclude_none=True) if check.workspace else {}
    rows, duration_s = check_rows(
        service.machine, kind, check.rows(), check.feed_mm_min, workspace
    )
    return PlanCheckOut(rows=rows, duration_s=round(duration_s, 3))


@router.get("/{plan_id}", responses=declare_problems(404))
def get_plan(plan_id: str, response: Response, service: ServiceDep) -> PlanResource:
    """Return a plan: rows, predicted uncertainty, what stays unobservable, grade."""
    return _describe(_require_plan_job(plan_id, service), response, service)


@router.get(
    "/{plan_id}/nc-program",
    response_class=PlainTextResponse,
    responses={**declare_problems(404, 422), **PROGRAM},
)
def download_plan_nc_program(
    plan_id: str, dialect: Dialect, service: ServiceDep
) -> PlainTextResponse:
    """Return a plan as a program of a control, read back before it is given out."""
    job = _require_plan_job(plan_id, service)
    plan = service.store.read_plan(job.id)
    if plan is None or service.machine is None:
        raise NotFound(f"plan {plan_id} ({job.state}) has no rows")
    return make_program_response(commanded_from_plan(plan), service.machine, dialect)


def _require_plan_job(plan_id: str, service: Service) -> Job:
    job = service.store.get(plan_id)
    if job.kind is not JobKind.PLAN:
        raise NotFound(f"job {plan_id} is no plan; its kind is {job.kind}")
    return job


def _describe(job: Job, response: Response, service: Service) -> PlanResource:
    response.headers["ETag"] = format_etag(job)
    plan = service.store.read_plan(job.id)
    failure = job.failure
    commanded = None if plan is None else PlanOut(**plan, target_um=job.target_um)
    return PlanResource(
        id=job.id,
        state=str(job.state),
        created=job.created,
        progress=1.0 if plan is not None else job.progress.done,
        request=dict(service.store.read_plan_request(job.id)),
        commanded=commanded,
        document=None if plan is None else dict(plan["document"]),
        error=Problem(**describe_failure(failure)) if failure else None,
        links=plan_links(job.id),
    )
