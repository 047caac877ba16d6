"""Compensation files of a result: formats, what they leave, the files themselves."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Annotated, Any

from fastapi import APIRouter, Path, Response
from fastapi.responses import FileResponse

from truepath.app.api.models.base import CompensationId, JobId
from truepath.app.api.models.compensation import (
    CompensationLinks,
    CompensationList,
    CompensationOut,
    CompensationRequest,
    FormatList,
    FormatOut,
)
from truepath.app.api.problems import declare_problems
from truepath.app.api.service import Service, ServiceDep
from truepath.app.results.model_history import find_model_file

# What computes is imported where it does: the service itself carries no science.

router = APIRouter(tags=["compensation"])

FileName = Annotated[
    str, Path(description="One of `files`.", examples=["compensation-X.tbl"])
]
_BINARY = {"schema": {"type": "string", "format": "binary"}}
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/octet-stream": _BINARY}}
}
_ZIP: dict[int | str, dict[str, Any]] = {200: {"content": {"application/zip": _BINARY}}}


@router.get("/compensation-formats")
def list_compensation_formats() -> FormatList:
    """List the formats of controllers that files can be made for."""
    from truepath.app.compensation.installed import describe_format, list_formats

    found = list_formats().items()
    return FormatList(items=[FormatOut(**describe_format(*each)) for each in found])


@router.post(
    "/jobs/{job_id}/compensations",
    status_code=201,
    responses=declare_problems(404, 422),
)
def create_compensation(
    job_id: JobId, request: CompensationRequest, response: Response, service: ServiceDep
) -> CompensationOut:
    """Make the files of a format, and say what they leave before anybody loads them.

    Of a job with error tables, or of a discovery's model. The same request makes the
    same files, which are kept with the result. Where the control compensated while it
    was measured, they are combined with the tables that it had, or the difference.
    """
    from truepath.app.compensation.active_files import GivenTables
    from truepath.app.compensation.kept_files import CompensationOrder, keep_files
    from truepath.app.compensation.unmeasured import Unmeasured

    folder = _find_folder(service, job_id)
    source = find_model_file(service.results, service.store.get(job_id).id)
    choice = Unmeasured(request.unmeasured)
    data = {name: text.encode() for name, text in request.active_files.items()}
    given = GivenTables(data, is_difference=request.difference)
    order = CompensationOrder(
        request.format, request.spacing_mm, choice, request.choices, given
    )
    made = _describe(
        job_id,
        *keep_files(source, folder, order, accept_verdict=request.accept_verdict),
    )
    response.headers["Location"] = made.links.self
    return made


@router.get("/jobs/{job_id}/compensations", responses=declare_problems(404))
def list_compensations(job_id: JobId, service: ServiceDep) -> CompensationList:
    """List the files that were made of a result."""
    from truepath.app.compensation.kept_files import list_accounts

    kept = list_accounts(_find_folder(service, job_id))
    return CompensationList(items=[_describe(job_id, *each) for each in kept])


@router.get(
    "/jobs/{job_id}/compensations/{compensation_id}", responses=declare_problems(404)
)
def get_compensation(
    job_id: JobId, compensation_id: CompensationId, service: ServiceDep
) -> CompensationOut:
    """Return what files leave, and their names."""
    from truepath.app.compensation.kept_files import read_account

    account = read_account(_find_folder(service, job_id), compensation_id)
    return _describe(job_id, compensation_id, account)


@router.get(
    "/jobs/{job_id}/compensations/{compensation_id}/files/{name}",
    response_class=FileResponse,
    responses={**declare_problems(404), **_FILE},
)
def download_compensation_file(
    job_id: JobId, compensation_id: CompensationId, name: FileName, service: ServiceDep
) -> FileResponse:
    """Return one file as the control loads it, or `compensation.json`."""
    from truepath.app.compensation.kept_files import find_file

    file = find_file(_find_folder(service, job_id), compensation_id, name)
    return FileResponse(file, media_type="application/octet-stream", filename=name)


@router.get(
    "/jobs/{job_id}/compensations/{compensation_id}/archive",
    response_class=Response,
    responses={**declare_problems(404), **_ZIP},
)
def download_compensation(
    job_id: JobId, compensation_id: CompensationId, service: ServiceDep
) -> Response:
    """Return all files and their account, zipped."""
    from truepath.app.compensation.kept_files import pack_files

    packed = pack_files(_find_folder(service, job_id), compensation_id)
    name = f'attachment; filename="{compensation_id}.zip"'
    return Response(
        packed, media_type="application/zip", headers={"Content-Disposition": name}
    )


def _find_folder(service: Service, job_id: str) -> FilePath:
    return service.results / service.store.get(job_id).id / "compensations"


def _describe(job_id: str, name: str, account: dict[str, Any]) -> CompensationOut:
    verdict = account["verdict"]["state"]
    links = CompensationLinks.of(job=job_id, id=name)
    return CompensationOut(**{**account, "verdict": verdict}, id=name, links=links)
