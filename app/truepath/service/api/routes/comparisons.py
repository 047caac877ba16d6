"""Comparison of a result with an uploaded direct measurement; stored."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, File, Query, Response, UploadFile
from fastapi import Path as InPath
from fastapi.responses import FileResponse, HTMLResponse
from pydantic import BaseModel, Field

from truepath.answers.machine_history import find_model_file
from truepath.errors import BundleError, NotFound
from truepath.files.bundle.recorded_files import decode_reference
from truepath.service.api.models.base import AsKept, JobId, Links, address
from truepath.service.api.models.tables import VerdictOut
from truepath.service.api.problems import declare_problems
from truepath.service.api.routes.results import send_page
from truepath.service.api.service import Service, ServiceDep

router = APIRouter(prefix="/jobs/{job_id}/comparisons", tags=["results"])

_LARGEST_BYTES = 4 << 20
_REFERENCE, _COMPARISON, _PAGE = "reference.csv", "comparison.json", "comparison.html"
ComparisonId = Annotated[
    str, InPath(description="`id` of the comparison.", examples=["5e3a9c0d1b2f4a6c"])
]
Micrometres = Annotated[
    float,
    Query(ge=0.0, le=1e6, description="Its standard uncertainty of displacements, µm."),
]
Microradians = Annotated[
    float,
    Query(ge=0.0, le=1e6, description="Its standard uncertainty of angles, µrad."),
]


Kind = Literal["positioning", "straightness", "turns"]
Numbers = float | list[float]
Directed = list[float | None]


class ComparisonLinks(Links):
    """Where a comparison is."""

    self: Annotated[str, "/jobs/{job}/comparisons/{id}"]
    report_html: Annotated[str, "/jobs/{job}/comparisons/{id}/report.html"]


class ComparedColumnsOut(BaseModel):
    """What both state, µm or µrad: of each position, or of the one number."""

    result_um: Numbers | None = None
    result_urad: Numbers | None = None
    result_uncertainty_um: Numbers | None = None
    result_uncertainty_urad: Numbers | None = None
    reference_um: Numbers | None = None
    reference_urad: Numbers | None = None
    reference_uncertainty_um: Numbers | None = None
    reference_uncertainty_urad: Numbers | None = None
    difference_um: Numbers | None = None
    difference_urad: Numbers | None = None
    combined_uncertainty_um: Numbers | None = None
    combined_uncertainty_urad: Numbers | None = None
    en: Numbers = Field(description="The difference over its expanded uncertainty.")


class ComparedErrorOut(ComparedColumnsOut):
    """An error motion along its axis."""

    position_mm: list[float] | None = None
    position_deg: list[float] | None = None
    forward_um: Directed | None = None
    forward_urad: Directed | None = None
    backward_um: Directed | None = None
    backward_urad: Directed | None = None
    largest_difference_um: float | None = None
    largest_difference_urad: float | None = None
    mean_difference_um: float | None = None
    mean_difference_urad: float | None = None
    largest_en: float
    share_within: float = Field(description="Of the positions: |en| at most 1.")
    merged: list[str] = Field(
        description="Error motions whose share is merged into the direct values."
    )
    missing: list[str] = Field(
        description="Those whose share the reference does not know."
    )


class ComparedKindOut(BaseModel):
    """All error motions of a kind."""

    motions: int
    largest_difference_um: float | None = None
    largest_difference_urad: float | None = None
    mean_difference_um: float | None = None
    mean_difference_urad: float | None = None
    largest_expanded_um: float | None = None
    largest_expanded_urad: float | None = None
    share_within: float


class ComparedVolumeOut(BaseModel):
    """Volumetric errors by what both know, over the range of the reference."""

    points: int
    result_mean_um: float
    reference_mean_um: float
    difference_mean_um: float
    difference_largest_um: float
    note: str


class ComparisonOut(BaseModel):
    """A result less a direct measurement; uncertainties are standard ones (k = 1)."""

    id: str
    schema_: Literal["comparison/1"] = Field(alias="schema")
    machine: str
    result: str
    reference: str
    verdict: Annotated[dict[str, Any], AsKept(VerdictOut)] = Field(
        description="That of the result."
    )
    convention: str
    errors: dict[str, Annotated[dict[str, Any], AsKept(ComparedErrorOut)]] = Field(
        description="By symbol."
    )
    numbers: dict[str, Annotated[dict[str, Any], AsKept(ComparedColumnsOut)]] = Field(
        description="Squarenesses, locations, by symbol."
    )
    kinds: dict[Kind, Annotated[dict[str, Any], AsKept(ComparedKindOut)] | None] = (
        Field(description="Null where both have no error motion of it.")
    )
    volumetric: Annotated[dict[str, Any], AsKept(ComparedVolumeOut)] | None
    not_compared: dict[str, str] = Field(description="The reason, by symbol.")
    links: ComparisonLinks


@router.post("", status_code=201, responses=declare_problems(404, 422))
def create_comparison(
    job_id: JobId,
    reference: Annotated[UploadFile, File(description="A `reference.csv`.")],
    response: Response,
    service: ServiceDep,
    reference_um: Micrometres = 0.0,
    reference_urad: Microradians = 0.0,
) -> ComparisonOut:
    """Hold a result against a direct measurement, and keep the answer with it.

    The same file with the same uncertainties makes the same comparison.
    """
    # Imported where it computes: the service itself carries no science.
    from truepath.answers.comparison import ReferenceUncertainty
    from truepath.answers.comparison_report import compare_files

    source = find_model_file(service.results, service.store.get(job_id).id)
    data = reference.file.read(_LARGEST_BYTES + 1)
    if len(data) > _LARGEST_BYTES:
        problem = f"is larger than {_LARGEST_BYTES >> 20} MB"
        raise BundleError(problem, file=_REFERENCE, remedy="send fewer positions")
    decode_reference(data, file=_REFERENCE)  # errors name it as it was sent
    told = f"{reference_um!r} {reference_urad!r}".encode()
    name = hashlib.sha256(data + told).hexdigest()[:16]
    folder = _find_folder(service, job_id) / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _REFERENCE).write_bytes(data)
    uncertainty = ReferenceUncertainty(reference_um, reference_urad)
    content = compare_files(source, folder / _REFERENCE, folder, uncertainty)
    response.headers["Location"] = address(f"/jobs/{job_id}/comparisons/{name}")
    return _describe(job_id, name, content)


@router.get("/{comparison_id}", responses=declare_problems(404))
def get_comparison(
    job_id: JobId, comparison_id: ComparisonId, service: ServiceDep
) -> ComparisonOut:
    """Return a comparison: each error motion, the kinds, the volume."""
    file = _find_file(service, job_id, comparison_id, _COMPARISON)
    content = json.loads(file.read_text(encoding="utf-8"))
    return _describe(job_id, comparison_id, content)


@router.get(
    "/{comparison_id}/report.html",
    response_class=HTMLResponse,
    responses=declare_problems(404),
)
def get_comparison_report(
    job_id: JobId, comparison_id: ComparisonId, service: ServiceDep
) -> FileResponse:
    """Return the page of a comparison, which needs nothing else."""
    return send_page(_find_file(service, job_id, comparison_id, _PAGE))


def _find_folder(service: Service, job_id: str) -> Path:
    return service.results / service.store.get(job_id).id / "comparisons"


def _find_file(service: Service, job_id: str, comparison_id: str, name: str) -> Path:
    kept = _find_folder(service, job_id)
    known = {place.parent.name: place for place in kept.glob(f"*/{name}")}
    if comparison_id not in known:
        raise NotFound(f"job {job_id} has no comparison {comparison_id!r}")
    return known[comparison_id]


def _describe(job_id: str, name: str, content: dict[str, Any]) -> ComparisonOut:
    links = ComparisonLinks.of(job=job_id, id=name)
    return ComparisonOut(**content, id=name, links=links)
