"""Plans, and the commanded rows of jobs: graded, or as an NC program."""

from __future__ import annotations

from typing import Annotated, Any, Self

from fastapi import APIRouter, Query, Response
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, Field, model_validator

from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.errors import NotFound
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.running.plan_requests import check_rows, list_station_rows
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.nc_programs.programs import name_controls, name_file, write_program
from truepath.motion.paths.commanded_rows import MAX_ROWS
from truepath.service.api.models.base import (
    JOB_ID,
    AsKept,
    Feed,
    JobId,
    Links,
    MachineId,
    Mm,
    PlanId,
    Problem,
    RequestBody,
    address,
    examples,
)
from truepath.service.api.models.plan import (
    PlanOut,
    PlanRequest,
    Point,
    Waypoint,
    WorkspaceIn,
)
from truepath.service.api.models.plan_document import GradeOut, PlanDocumentOut
from truepath.service.api.problems import declare_problems, describe_failure
from truepath.service.api.request_parameters import (
    IdempotencyKeyHeader,
    format_etag,
    make_key,
)
from truepath.service.api.service import ActorDep, Service, ServiceDep, owner_of

router = APIRouter(prefix="/plans", tags=["plans"])
of_jobs = APIRouter(tags=["jobs"])

Dialect = Annotated[
    str,
    Query(
        max_length=100,
        description="A `name` of `GET /api/v1/nc-dialects`.",
        examples=["heidenhain"],
    ),
]
Station = Annotated[
    int | None,
    Query(ge=1, description="Of several stations whose rows; the first without it."),
]
_Place = Annotated[
    list[Mm] | None,
    Query(
        alias="tracker_mm",
        min_length=3,
        max_length=3,
        description="Where the tracker stands: x, y and z, each as a parameter of this "
        "name. Without it four usual places are tried and the worst counts.",
    ),
]


class PlanCheck(RequestBody):
    """Rows to check without a job: of `path`, or of `points`."""

    model_config = examples(
        {
            "path": [
                {"x_mm": 10, "y_mm": 10, "z_mm": 10},
                {"x_mm": 400, "y_mm": 300, "z_mm": 200},
                {"x_mm": 90, "y_mm": 350, "z_mm": 40},
                {"x_mm": 450, "y_mm": 20, "z_mm": 250},
            ]
        }
    )

    machine: MachineId | None = Field(
        None, description="The machine to drive; left out where there is only one."
    )
    path: list[Waypoint] | None = Field(None, min_length=2, max_length=MAX_ROWS)
    points: list[Point] | None = Field(None, min_length=1, max_length=MAX_ROWS)
    feed_mm_min: Feed | None = Field(None, description="Of rows that state none.")
    workspace: WorkspaceIn | None = None

    @model_validator(mode="after")
    def _is_of_one_mode(self) -> Self:
        if (self.path is None) == (self.points is None):
            raise ValueError("give path or points, one of the two")
        return self

    def rows(self) -> list[dict[str, Any]]:
        """Rows in the columns of the bundle."""
        rows = self.path or self.points or ()
        return [row.model_dump(exclude_none=True) for row in rows]


class PlanCheckOut(BaseModel):
    """A measurement takes the rows: they tell where the tracker stands.

    Every swept line keeps to travel and workspace.
    """

    rows: int
    duration_s: float = Field(description="From the first row on, dwells included.")
    stays_open: str = Field(
        description="What an analysis of these rows alone would be refused for, and "
        "which lines would mend it; empty where it determines all errors. The rows are "
        "driven all the same, for several Runs may be analysed together."
    )


class GradeAt(BaseModel):
    """The expected uncertainty of the map over the scatter of one sample."""

    number: float = Field(examples=[0.24])
    verdict: str = Field(examples=["good"], description="good, usable or poor")


class WeakAt(BaseModel):
    """An error motion that is known least."""

    error: str = Field(examples=["ECX"])
    at_tool_um: float = Field(description="Standard uncertainty it puts at the tool.")


class CurvePoint(BaseModel):
    """What is left once the plan has been driven to a row."""

    row: int = Field(examples=[19], description="Rows driven.")
    time_s: float = Field(examples=[43.2], description="Dwells and moves included.")
    volumetric_uncertainty_um: float = Field(description="k = 1.")
    expanded_volumetric_uncertainty_um: float = Field(description="k = 2.")
    grade: GradeAt | None = Field(None, description="Null in plans of older versions.")
    weakest: list[WeakAt] = Field([], description="The weakest first.")


class PlanCurve(BaseModel):
    """Uncertainty against time: how far any beginning of a plan comes.

    A plan that is made for a shorter time leaves about as much, or less.
    """

    plan_id: str = Field(examples=[JOB_ID])
    points: list[CurvePoint]
    tracker_mm: list[float] = Field(
        description="Where the tracker stands, in the frame that it stands on."
    )
    tracker_is_assumed: bool
    unobservable: list[str] = Field(description="What the plan cannot tell, in words.")


class PlanLinks(Links):
    """Where else to look."""

    self: Annotated[str, "/plans/{id}"]
    job: Annotated[str, "/jobs/{id}"]
    events: Annotated[str, "/jobs/{id}/events"]
    nc_program: Annotated[str, "/plans/{id}/nc-program"]
    curve: Annotated[str, "/plans/{id}/curve"]


class PlanResource(BaseModel):
    """A plan. It is made by a job of its own identifier, of kind `plan`."""

    id: str = Field(examples=[JOB_ID])
    state: State = Field(
        examples=["succeeded"], description="Of its job; `succeeded` once it is there."
    )
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    progress: float = Field(description="From 0 to 1.")
    request: Annotated[dict[str, Any], AsKept(PlanRequest)] = Field(
        description="What was asked."
    )
    commanded: PlanOut | None = Field(description="The rows; null until they are.")
    document: Annotated[dict[str, Any], AsKept(PlanDocumentOut)] | None = Field(
        description="The content of `plan.json`: predicted uncertainty of each error "
        "and of the volume, what stays unobservable, the curve of uncertainty against "
        "time; and the `grade` of the set-up."
    )
    error: Problem | None = Field(description="Why there is none.")
    links: PlanLinks


class DialectOut(BaseModel):
    """A control that programs can be written for."""

    name: str = Field(examples=["heidenhain"])
    control: str = Field(examples=["Heidenhain TNC"])


class DialectList(BaseModel):
    """The controls, by name."""

    items: list[DialectOut]


@router.post("", status_code=202, responses=declare_problems(404, 409, 422))
def create_plan(
    request: PlanRequest,
    response: Response,
    service: ServiceDep,
    actor: ActorDep,
    idempotency_key: IdempotencyKeyHeader = None,
) -> PlanResource:
    """Choose the measurement that tells most in its time. Nothing moves.

    A job of the same identifier computes it; follow that one's events, or ask again.
    """
    requested = RequestedJob(
        JobKind.PLAN,
        machine=request.machine,
        perpendicular_only=request.perpendicular_only,
        target_um=request.target_um,
        model_id=request.model_id,
        plan_request=request.order(),
    )
    owner = owner_of(actor)
    key = make_key(idempotency_key, "plan ", request, owner)
    job, _ = service.dispatcher.create(requested, key, owner=owner)
    response.headers["Location"] = address(f"/plans/{job.id}")
    return _describe(job, response, service)


@router.get("/{plan_id}", responses=declare_problems(404))
def get_plan(plan_id: PlanId, response: Response, service: ServiceDep) -> PlanResource:
    """Return a plan: rows, predicted uncertainty, what stays unobservable, grade."""
    return _describe(_require_plan_job(plan_id, service), response, service)


@router.get("/{plan_id}/curve", responses=declare_problems(404))
def get_plan_curve(plan_id: PlanId, service: ServiceDep) -> PlanCurve:
    """Return uncertainty against time along a plan, its grade and what is known least.

    Any beginning of the plan can be driven alone: its rows are the first ones.
    """
    job = _require_plan_job(plan_id, service)
    plan = service.store.read_plan(job.id)
    document = plan["document"] if plan else None
    if document is None:
        raise NotFound(f"plan {plan_id} ({job.state}) has no curve")
    return PlanCurve(
        plan_id=job.id,
        points=[CurvePoint(**point) for point in document["curve"]],
        tracker_mm=document["tracker"]["position_mm"],
        tracker_is_assumed=document["tracker"]["assumed"],
        unobservable=document["unobservable"],
    )


@router.get(
    "/{plan_id}/nc-program",
    response_class=PlainTextResponse,
    responses=declare_problems(404, 422),
)
def download_plan_nc_program(
    plan_id: PlanId, dialect: Dialect, service: ServiceDep, station: Station = None
) -> PlainTextResponse:
    """Return a plan as a program of a control, read back before it is given out."""
    job = _require_plan_job(plan_id, service)
    return _send_program(_read_set_up(job, service, "has no rows", station), dialect)


@router.post(":validate", responses=declare_problems(404, 409, 422))
def validate_plan(check: PlanCheck, service: ServiceDep) -> PlanCheckOut:
    """Check rows as the order of a measurement does, over the whole swept path.

    A refusal names row and reason.
    """
    machine = service.machines.choose(check.machine).machine
    workspace = check.workspace.model_dump(exclude_none=True) if check.workspace else {}
    checked = check_rows(
        machine,
        check.rows(),
        check.feed_mm_min,
        workspace,
        is_path=check.path is not None,
    )
    return PlanCheckOut(
        rows=checked.rows,
        duration_s=round(checked.duration_s, 3),
        stays_open=checked.stays_open,
    )


@of_jobs.get("/jobs/{job_id}/plan/grade", responses=declare_problems(404, 422))
def get_plan_grade(
    job_id: JobId, service: ServiceDep, tracker_mm: _Place = None
) -> GradeOut:
    """Grade what a measuring job commands, from geometry alone, before it is armed."""
    job = service.store.get(job_id)
    set_up = _read_set_up(job, service, "commands nothing to be graded")
    # Imported where it computes: the service itself carries no science.
    from truepath.results.grade_json import grade_set_up

    only = job.perpendicular_only
    found = grade_set_up(*set_up, tracker_mm=tracker_mm, perpendicular_only=only)
    return GradeOut(**found)


@of_jobs.get("/nc-dialects")
def list_nc_dialects() -> DialectList:
    """List the controls that NC programs can be written for."""
    named = name_controls().items()
    return DialectList(items=[DialectOut(name=n, control=c) for n, c in named])


@of_jobs.get(
    "/jobs/{job_id}/nc-program",
    response_class=PlainTextResponse,
    responses=declare_problems(404, 422),
)
def download_nc_program(
    job_id: JobId, dialect: Dialect, service: ServiceDep, station: Station = None
) -> PlainTextResponse:
    """Return what a measuring job commands as a program of a control.

    The program moves in machine coordinates, stops exactly at each row and was read
    back, row by row, before it is given out. It needs no link to this service: load it
    at the control, record the tracker's stream, send both in as a bundle.
    """
    job = service.store.get(job_id)
    set_up = _read_set_up(job, service, "commands no path of its own", station)
    return _send_program(set_up, dialect)


def _read_set_up(
    job: Job, service: Service, missing: str, station: int | None = None
) -> tuple[Machine, Commanded]:
    plan = service.store.read_plan(job.id)
    if plan is None:
        raise NotFound(f"job {job.id} ({job.kind}, {job.state}) {missing}")
    if service.machines.first is None:
        raise NotFound("the service has no machine file to check the plan against")
    machine = service.machines.choose(job.machine).machine
    if station is None:
        return machine, decode_commanded_json(plan)
    rows = list_station_rows(plan)
    if station > len(rows):
        raise NotFound(f"job {job.id} has rows of {len(rows)} stations, not {station}")
    return machine, rows[station - 1]


def _send_program(set_up: tuple[Machine, Commanded], dialect: str) -> PlainTextResponse:
    machine, commanded = set_up
    text = write_program(commanded, machine, dialect)
    file = name_file(text, dialect)
    return PlainTextResponse(
        text, headers={"Content-Disposition": f'attachment; filename="{file}"'}
    )


def _require_plan_job(plan_id: str, service: Service) -> Job:
    job = service.store.get(plan_id)
    if job.kind is not JobKind.PLAN:
        raise NotFound(f"job {plan_id} is no plan; its kind is {job.kind}")
    return job


def _describe(job: Job, response: Response, service: Service) -> PlanResource:
    response.headers["ETag"] = format_etag(job)
    plan, failure = service.store.read_plan(job.id), job.failure
    return PlanResource(
        id=job.id,
        state=job.state,
        created=job.created,
        progress=job.progress.done if plan is None else 1.0,
        request=dict(service.store.read_plan_request(job.id)),
        commanded=PlanOut.of(plan, job.target_um) if plan else None,
        document=dict(plan["document"]) if plan else None,
        error=Problem(**describe_failure(failure)) if failure else None,
        links=PlanLinks.of(id=job.id),
    )
