"""Which compensation files a simulated control has."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from truepath.app.api.models.base import (
    JOB_ID,
    CompensationName,
    Identifier,
    RequestBody,
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
