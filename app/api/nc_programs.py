"""NC programs: a job's path for an operator to load into the control by hand."""

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
