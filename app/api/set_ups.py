"""What a job commands: its grade before anything moves, and its NC program."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, Field

from app.api.problems import declare_problems
from app.api.service import ServiceDep
from app.errors import NotFound
from app.jobs.plans import commanded_from_plan
from app.kinematics.machine import Machine
from app.motion.configurations import Commanded
from app.motion.nc_programs.programs import (
    list_dialects,
    name_control,
    name_file,
    write_program,
)
from app.results.grading import graded

grades = APIRouter(prefix="/jobs", tags=["jobs"])
router = APIRouter(prefix="/jobs", tags=["jobs"])
dialects = APIRouter(tags=["jobs"])

Dialect = Annotated[
    str,
    Query(
        max_length=100,
        description="A `name` of `GET /api/v1/nc-dialects`.",
        examples=["heidenhain"],
    ),
]
PROGRAM: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {"schema": {"type": "string"}}}}
}
_Place = Annotated[
    list[Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]] | None,
    Query(
        alias="tracker_mm",
        min_length=3,
        max_length=3,
        description="Where the tracker stands: x, y and z, each as a parameter of this "
        "name. Without it four usual places are tried and the worst counts.",
    ),
]


class Thresholds(BaseModel):
    """Numbers up to which a set-up is good, and usable."""

    good: float = Field(examples=[0.25])
    usable: float = Field(examples=[1.0])


class TrackerPlace(BaseModel):
    """Where the tracker stands for this grade."""

    position_mm: list[float]
    assumed: bool = Field(description="Nobody has said so: the worst of usual places.")
    best_number: float = Field(description="At the best of the places.")


class WeakMotionOut(BaseModel):
    """One of the weakest error motions."""

    error: str = Field(examples=["EBZ"])
    meaning: str = Field(examples=["turn of Z about Y"])
    at_tool_um: float = Field(description="Standard uncertainty it puts at the tool.")
    remedy: str | None


class GradeOut(BaseModel):
    """The grade of a set-up from geometry alone; uncertainties are standard ones."""

    number: float = Field(
        examples=[0.11],
        description="Expected uncertainty of the map over the scatter of one sample.",
    )
    verdict: str = Field(examples=["good"], description="good, usable or poor")
    thresholds: Thresholds
    text: str
    expected_uncertainty_um: float
    sample_sigma_um: float
    tracker: TrackerPlace
    improved_number: float | None = Field(
        description="With the line that the weakest motion asks for."
    )
    weakest: list[WeakMotionOut]
    weak_shapes: list[str]
    unobservable: list[str]


@grades.get("/{job_id}/plan/grade", responses=declare_problems(404, 422))
def get_plan_grade(
    job_id: str, service: ServiceDep, tracker_mm: _Place = None
) -> GradeOut:
    """Grade what a measuring job commands, from geometry alone, before it is armed."""
    job = service.store.get(job_id)
    plan = service.store.read_plan(job.id)
    if plan is None:
        raise NotFound(f"job {job_id} ({job.kind}) commands nothing to be graded")
    if service.machine is None:
        raise NotFound("the service has no machine file to grade the plan with")
    found = graded(
        service.machine,
        commanded_from_plan(plan),
        tracker_mm=tracker_mm,
        perpendicular_only=job.perpendicular_only,
    )
    return GradeOut(**found)


class DialectOut(BaseModel):
    """A control that programs can be written for."""

    name: str = Field(examples=["heidenhain"])
    control: str = Field(examples=["Heidenhain TNC"])


class DialectList(BaseModel):
    """The controls, by name."""

    items: list[DialectOut]


@dialects.get("/nc-dialects")
def list_nc_dialects() -> DialectList:
    """List the controls that NC programs can be written for."""
    return DialectList(
        items=[
            DialectOut(name=name, control=name_control(name))
            for name in list_dialects()
        ]
    )


@router.get(
    "/{job_id}/nc-program",
    response_class=PlainTextResponse,
    responses={**declare_problems(404, 422), **PROGRAM},
)
def download_nc_program(
    job_id: str, dialect: Dialect, service: ServiceDep
) -> PlainTextResponse:
    """Return what a measuring job commands as a program of a control.

    The program moves in machine coordinates, stops exactly at each row and was read
    back, row by row, before it is given out. It needs no link to this service: load it
    at the control, record the tracker's stream, send both in as a bundle.
    """
    job = service.store.get(job_id)
    plan = service.store.read_plan(job.id)
    if plan is None:
        raise NotFound(f"job {job_id} ({job.kind}) commands no path of its own")
    if service.machine is None:
        raise NotFound("the service has no machine file to check the path against")
    return make_program_response(commanded_from_plan(plan), service.machine, dialect)


def make_program_response(
    commanded: Commanded, machine: Machine, dialect: str
) -> PlainTextResponse:
    """Return a program as a download, under the name its control wants."""
    text = write_program(commanded, machine, dialect)
    file = name_file(text, dialect)
    return PlainTextResponse(
        text, headers={"Content-Disposition": f'attachment; filename="{file}"'}
    )
