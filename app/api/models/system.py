"""The service itself as clients see it."""

from __future__ import annotations

from pydantic import BaseModel, Field

from app.api.models.machine import MachineSummary


class CellOut(BaseModel):
    """The cell process, which holds the devices."""

    state: str = Field(
        examples=["ready"], description="none, starting, down, disconnected, ready, …"
    )
    text: str
    connected: bool
    restarts: int


class SystemOut(BaseModel):
    """The service."""

    version: str
    simulated: bool
    machine: MachineSummary | None
    cell: CellOut
    current_job: str | None = Field(description="The job that holds the machine.")
    time: str


class Alive(BaseModel):
    """The process answers."""

    status: str = "ok"


class Ready(BaseModel):
    """What the service needs is there."""

    status: str = Field(examples=["ready"])
    checks: dict[str, bool]
