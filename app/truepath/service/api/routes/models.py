"""Models of the machine: list, download, history."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field
from pydantic.json_schema import SkipJsonSchema

from truepath.answers.machine_history import (
    find_model_file,
    read_difference,
    read_model_summary,
    read_versions,
)
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.errors import NotFound
from truepath.files.earlier.verdict import State as VerdictState
from truepath.service.api.models.base import JOB_ID, AsKept, Identifier, Links, ModelId
from truepath.service.api.models.machine_files import ChangeOut, ModelFileOut, ParentOut
from truepath.service.api.models.tables import EffectOut
from truepath.service.api.problems import declare_problems
from truepath.service.api.request_parameters import PagingDep
from truepath.service.api.service import Service, ServiceDep

router = APIRouter(prefix="/models", tags=["models"])


class ModelLinks(Links):
    """Where else to look."""

    self: Annotated[str, "/models/{id}"]
    versions: Annotated[str, "/models/{id}/versions"]
    difference: Annotated[str, "/models/{id}/difference"]
    report_html: Annotated[str, "/jobs/{id}/discovery/report.html"]
    run: Annotated[str | None, "/runs/{run_id}"]


class ModelOut(BaseModel):
    """A model that a discovery has made: the one it was held against, and more."""

    id: str = Field(examples=[JOB_ID], description="That of the job that made it.")
    version: int = Field(examples=[2])
    parent: ParentOut
    created: str
    verdict: VerdictState | None = Field(
        description="What it says of itself; null where it says nothing."
    )
    run_id: str | None
    effects: Annotated[list[dict[str, Any]], AsKept(EffectOut, many=True)] = Field(
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


@router.get("", responses=declare_problems(422))
def list_models(paging: PagingDep, service: ServiceDep) -> ModelPage:
    """List models, the newest first."""
    kinds = [kind for kind in JobKind if kind.discovers]
    list_page = partial(service.store.list_page, states=[State.SUCCEEDED], kinds=kinds)
    jobs, after = paging.read(list_page)
    items = [
        _describe(job, read_model_summary(service.results, job.id)) for job in jobs
    ]
    return ModelPage(items=items, next=after)


@router.get("/{model_id}", response_model=ModelFileOut, responses=declare_problems(404))
def get_model(model_id: ModelId, service: ServiceDep) -> FileResponse:
    """Return `model.json`; `truepath predict`, `export` and `discover` take it."""
    job = _require_discovery(service, model_id)
    return FileResponse(
        find_model_file(service.results, job.id),
        media_type="application/json",
        filename="model.json",
    )


@router.get("/{model_id}/versions", responses=declare_problems(404))
def list_model_versions(model_id: ModelId, service: ServiceDep) -> list[ModelOut]:
    """Return a model and those it came from, the newest first."""
    job = _require_discovery(service, model_id)
    return [
        _describe(service.store.get(one), growth)
        for one, growth in read_versions(service.results, job.id)
    ]


@router.get("/{model_id}/difference", responses=declare_problems(404, 422))
def get_model_difference(
    model_id: ModelId,
    service: ServiceDep,
    against: Annotated[
        Identifier | SkipJsonSchema[None],
        Query(
            description="Job whose model or result to compare with; else its parent."
        ),
    ] = None,
) -> ModelDifference:
    """Return what a model has that another has not, and which numbers differ."""
    job = _require_discovery(service, model_id)
    if against is None:
        growth = read_model_summary(service.results, job.id)
        changes, before = growth["difference"], growth["parent"]["source"]
    else:
        before = service.store.get(against).id
        files = (find_model_file(service.results, i) for i in (before, job.id))
        changes: Any = read_difference(*files)
    return ModelDifference(before=before, after=job.id, changes=changes)


def _require_discovery(service: Service, model_id: str) -> Job:
    job = service.store.get(model_id)
    if job.answer != "discovery":
        raise NotFound(f"job {model_id} ({job.kind}, {job.state}) has no model")
    return job


def _describe(job: Job, growth: Mapping[str, Any]) -> ModelOut:
    return ModelOut(
        **growth,
        id=job.id,
        created=job.ended or job.created,
        verdict=job.verdict,
        run_id=job.run_id,
        links=ModelLinks.of(id=job.id, run_id=job.run_id),
    )
