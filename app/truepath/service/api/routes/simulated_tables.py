"""Compensation files in the control of a simulated machine; a real one is refused."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from truepath.service.api.models.base import (
    JOB_ID,
    CompensationName,
    Identifier,
    MachinePath,
    RequestBody,
)
from truepath.service.api.problems import declare_problems
from truepath.service.api.security.access_control import note_change
from truepath.service.api.service import Service, ServiceDep

router = APIRouter(
    prefix="/machines/{machine_id}/simulated-tables", tags=["compensation"]
)


class SimulatedTablesRequest(RequestBody):
    """Files that were made of a result."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [{"job_id": JOB_ID, "compensation_id": "isg-csv-10-hold"}]
        },
    )

    job_id: Identifier = Field(description="Job of the result.")
    compensation_id: CompensationName = Field(
        description="`id` of files in `GET /jobs/{job_id}/compensations`."
    )


class SimulatedTablesOut(BaseModel):
    """What the control has from this service; nothing of it at first."""

    machine: str = Field(examples=["default"])
    simulated: bool = Field(
        description="Whether the control is a simulated one: no other takes files."
    )
    job_id: str | None = Field(description="Job of the result; null without files.")
    compensation_id: str | None
    files: list[str] = Field(examples=[["compensation.csv"]])


@router.get("", responses=declare_problems(404))
def get_simulated_tables(
    machine_id: MachinePath, service: ServiceDep
) -> SimulatedTablesOut:
    """Return the files that a simulated control has from this service."""
    service.machines.get(machine_id)
    return _describe(machine_id, service)


@router.put("", responses=declare_problems(404, 409, 422))
def load_simulated_tables(
    machine_id: MachinePath,
    request: SimulatedTablesRequest,
    service: ServiceDep,
    http: Request,
) -> SimulatedTablesOut:
    """Give a simulated control the files of a result in place of those it has.

    Refused for a machine with real devices, and while a job holds the machine.
    """
    machine = service.machines.get(machine_id).machine
    controls = service.setup.simulated_controls
    controls.require(machine_id)  # a real one is refused, whatever else is wrong
    service.setup.reject_while_measuring(machine_id)
    job_id = service.store.get(request.job_id).id
    folder = service.results / job_id / "compensations"
    before = _describe(machine_id, service)
    controls.load(machine_id, machine, folder, job_id, request.compensation_id)
    after = _describe(machine_id, service)
    note_change(http, old=_name_tables(before), new=_name_tables(after))
    return after


@router.delete("", status_code=204, responses=declare_problems(404, 409, 422))
def clear_simulated_tables(
    machine_id: MachinePath, service: ServiceDep, http: Request
) -> Response:
    """Take the tables of a simulated control away: it is as it was found again."""
    service.machines.get(machine_id)
    controls = service.setup.simulated_controls
    controls.require(machine_id)
    service.setup.reject_while_measuring(machine_id)
    before = _describe(machine_id, service)
    controls.clear(machine_id)
    note_change(http, old=_name_tables(before), new={})
    return Response(status_code=204)


def _name_tables(tables: SimulatedTablesOut) -> dict[str, str | None]:
    return {"job_id": tables.job_id, "compensation_id": tables.compensation_id}


def _describe(machine_id: str, service: Service) -> SimulatedTablesOut:
    controls = service.setup.simulated_controls
    loaded = controls.read(machine_id)
    return SimulatedTablesOut(
        machine=machine_id,
        simulated=controls.is_simulated(machine_id),
        job_id=loaded.job_id,
        compensation_id=loaded.compensation_id,
        files=list(loaded.files),
    )
