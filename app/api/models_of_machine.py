"""Models of the machine: list them, take them away, see how they grew."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse
from pydantic.json_schema import SkipJsonSchema

from app.api.models.base import Identifier
from app.api.models.machine_model import (
    ChangeOut,
    ModelDifference,
    ModelOut,
    ModelPage,
    describe_model,
)
from app.api.paging import PagingDep
from app.api.problems import declare_problems
from app.api.service import Service, ServiceDep
from app.errors import NotFound
from app.jobs.job import Job, JobKind
from app.jobs.transitions import State
from app.results.model_history import (
    find_model_file,
    read_difference,
    read_growth,
    read_versions,
)

router = APIRouter(prefix="/models", tags=["models"])

_OBJECT = {"application/json": {"schema": {"type": "object"}}}


@router.get("", responses=declare_problems(422))
def list_models(paging: PagingDep, service: ServiceDep) -> ModelPage:
    """List models, the newest first."""
    kinds = [kind for kind in JobKind if kind.discovers]
    jobs, after = paging.read(
        lambda limit, seq: service.store.list_page(
            limit, before_seq=seq, states=[State.SUCCEEDED], kinds=kinds
        )
    )
    return ModelPage(items=[_describe(service, job) for job in jobs], next=after)


@router.get(
    "/{model_id}",
    response_class=FileResponse,
    responses={**declare_problems(404), 200: {"content": _OBJECT}},
)
def get_model(model_id: str, service: ServiceDep) -> FileResponse:
    """Return `model.json`; `truepath predict`, `export` and `discover` take it."""
    job = _require_discovery(service, model_id)
    return FileResponse(
        find_model_file(service.results, job.id),
        media_type="application/json",
        filename="model.json",
    )


@router.get("/{model_id}/versions", responses=declare_problems(404))
def list_model_versions(model_id: str, service: ServiceDep) -> list[ModelOut]:
    """Return a model and those it came from, the newest first."""
    job = _require_discovery(service, model_id)
    return [
        describe_model(service.store.get(one), growth)
        for one, growth in read_versions(service.results, job.id)
    ]


@router.get("/{model_id}/difference", responses=declare_problems(404, 422))
def get_model_difference(
    model_id: str,
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
        growth = read_growth(service.results, job.id)
        changes, before = growth["difference"], growth["parent"]["source"]
    else:
        other = service.store.get(against)
        files = (find_model_file(service.results, i) for i in (other.id, job.id))
        changes, before = read_difference(*files), other.id
    return ModelDifference(
        before=before,
        after=job.id,
        changes=[ChangeOut(**change) for change in changes],
    )


def _require_discovery(service: Service, model_id: str) -> Job:
    job = service.store.get(model_id)
    if not job.has_discovery:
        raise NotFound(f"job {model_id} ({job.kind}, {job.state}) has no model")
    return job


def _describe(service: Service, job: Job) -> ModelOut:
    return describe_model(job, read_growth(service.results, job.id))
