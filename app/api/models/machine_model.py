"""Models of the machine as clients see them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, Field

from app.api.models.base import JOB_ID, PREFIX
from app.jobs.job import Job


class ParentOut(BaseModel):
    """What a model came from."""

    version: int
    source: str = Field(description="Identifier of a model or job here, or in words.")
    sha256: str | None = Field(description="Of its file; null where it had none.")


class ChangeOut(BaseModel):
    """One difference of two models."""

    kind: str = Field(description="added, removed or changed")
    what: str = Field(examples=["backlash Y"])
    text: str = Field(examples=["backlash Y: width 6.39 ± 0.15 µm"])


class ModelLinks(BaseModel):
    """Where else to look."""

    self: str
    versions: str
    difference: str
    report_html: str
    run: str | None


class ModelOut(BaseModel):
    """A model that a discovery has made: the one it was held against, and more."""

    id: str = Field(examples=[JOB_ID], description="That of the job that made it.")
    version: int = Field(examples=[2])
    parent: ParentOut
    created: str
    run_id: str | None
    effects: list[dict[str, Any]] = Field(
        description="What was found, as in discovery.json."
    )
    difference: list[ChangeOut] = Field(description="To its parent.")
    links: ModelLinks


class ModelPage(BaseModel):
    """Models, the newest first."""

    items: list[ModelOut]
    next: str | None = Field(description="`after` of the next page.")


class ModelDifference(BaseModel):
    """What differs between two models. Changed: by more than U (k = 2)."""

    before: str
    after: str
    changes: list[ChangeOut]


def describe_model(job: Job, growth: Mapping[str, Any]) -> ModelOut:
    """Return a model as clients see it."""
    at = f"{PREFIX}/models/{job.id}"
    return ModelOut(
        id=job.id,
        version=growth["version"],
        parent=ParentOut(**growth["parent"]),
        created=job.ended or job.created,
        run_id=job.run_id,
        effects=growth["effects"],
        difference=[ChangeOut(**change) for change in growth["difference"]],
        links=ModelLinks(
            self=at,
            versions=f"{at}/versions",
            difference=f"{at}/difference",
            report_html=f"{PREFIX}/jobs/{job.id}/discovery/report.html",
            run=f"{PREFIX}/runs/{job.run_id}" if job.run_id else None,
        ),
    )
