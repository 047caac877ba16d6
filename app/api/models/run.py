"""Runs as clients see them."""

from __future__ import annotations

from dataclasses import asdict

from pydantic import BaseModel, Field

from app.api.models.base import PREFIX
from app.jobs.runs import RunRecord


class RunLinks(BaseModel):
    """Where the Run can be had."""

    self: str
    bundle: str


class RunOut(BaseModel):
    """A Run: what was commanded and recorded."""

    id: str
    name: str = Field(examples=["mill-3 2026-05-04T09:30:00.000Z"])
    origin: str = Field(examples=["measured"])
    mode: str = Field(examples=["otf"])
    machine: str = Field(examples=["mill-3"])
    samples: int = Field(examples=[60000])
    lost_samples: int = Field(examples=[0])
    complete: bool = Field(description="Whether it was driven to its end.")
    bytes: int
    sha256: str
    created: str
    links: RunLinks


class RunPage(BaseModel):
    """Runs, the newest first."""

    items: list[RunOut]
    next: str | None = Field(description="`after` of the next page.")


def describe_run(run: RunRecord) -> RunOut:
    """Return a Run as clients see it."""
    at = f"{PREFIX}/runs/{run.id}"
    links = RunLinks(self=at, bundle=f"{at}/bundle")
    return RunOut(**asdict(run), links=links)
