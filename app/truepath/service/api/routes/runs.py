"""Runs: lists, and bundles in both directions."""

from __future__ import annotations

import re
import shutil
from dataclasses import asdict
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, File, Query, Request, Response, UploadFile
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field
from pydantic.json_schema import SkipJsonSchema

from truepath.catalogue.errors import DiskFull
from truepath.catalogue.runs import RunRecord
from truepath.errors import BundleError, NotFound
from truepath.files.bundle.recorded_files import KNOWN_LENGTHS, decode_known_lengths
from truepath.service.api.access_control import note_deletion, note_naming
from truepath.service.api.models.base import Links, Name, RunId, RunNaming, address
from truepath.service.api.problems import TEXT, declare_file, declare_problems
from truepath.service.api.request_parameters import PagingDep
from truepath.service.api.routes.jobs import NamePart, Since, Until
from truepath.service.api.service import (
    LEAST_FREE_BYTES,
    Service,
    ServiceDep,
    on_threads,
)

router = APIRouter(prefix="/runs", tags=["runs"])
uploads = APIRouter(prefix="/runs", tags=["runs"])

UNPACKED_SHARE = 8
"""Largest ratio of unpacked to packed size: a stream in CSV packs 3:1."""
_LARGEST_TABLE = 1 << 20
_ODD = re.compile(r"[^\w .()+-]+")


# Separate threads: slow reading delays no other request.
_UPLOADING = CapacityLimiter(4)
_PACKING = CapacityLimiter(2)


class RunLinks(Links):
    """Where the Run can be had."""

    self: Annotated[str, "/runs/{id}"]
    bundle: Annotated[str, "/runs/{id}/bundle"]
    known_lengths: Annotated[str, "/runs/{id}/known-lengths"]


class RunOut(BaseModel):
    """A Run: what was commanded and recorded."""

    id: str
    name: str = Field(examples=["mill-3 2026-05-04T09:30:00.000Z"])
    note: str = Field(description="What people remark on it; often nothing.")
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


@router.get("", responses=declare_problems(422))
def list_runs(
    paging: PagingDep,
    service: ServiceDep,
    name: NamePart = None,
    machine: Annotated[
        Name | SkipJsonSchema[None],
        Query(description="Only of this machine: its `id`, or the name in its file."),
    ] = None,
    mode: Annotated[
        list[Literal["otf", "standstill"]], Query(description="Only of these modes.")
    ] = [],  # noqa: B006
    since: Since = None,
    until: Until = None,
) -> RunPage:
    """List Runs, the newest first."""
    list_page = partial(
        service.runs.list_page,
        name=name,
        machines=None if machine is None else _list_names(machine, service),
        modes=mode,
        since=since,
        until=until,
    )
    runs, after = paging.read(list_page)
    return RunPage(items=[_describe(run) for run in runs], next=after)


@router.get("/{run_id}", responses=declare_problems(404))
def get_run(run_id: RunId, service: ServiceDep) -> RunOut:
    """Return a Run."""
    return _describe(service.runs.get(run_id))


@router.patch("/{run_id}", responses=declare_problems(404, 422))
def rename_run(
    run_id: RunId, body: RunNaming, request: Request, service: ServiceDep
) -> RunOut:
    """Change name and note of a Run. What was recorded stays as it is."""
    before = service.runs.get(run_id)
    run = service.runs.rename(run_id, body.name, body.note)
    note_naming(request, before, run)
    return _describe(run)


@router.delete("/{run_id}", status_code=204, responses=declare_problems(404, 409, 422))
def delete_run(
    run_id: RunId,
    request: Request,
    service: ServiceDep,
    with_results: Annotated[
        bool, Query(description="Delete the jobs too whose answers depend on it.")
    ] = False,
) -> None:
    """Delete a Run and its file. Jobs without an answer forget it.

    Not one whose job is under way, nor of a result that a certificate states, that
    other jobs were made from or that a machine is held against.
    """
    deleted = service.deletion.delete_run(run_id, with_results=with_results)
    note_deletion(request, deleted)
    if len(deleted) > 1:
        service.calibrations.assess_all()


@router.get(
    "/{run_id}/bundle",
    response_class=FileResponse,
    responses=declare_file("application/zip", 404, 507),
)
@on_threads(_PACKING)
def download_bundle(run_id: RunId, service: ServiceDep) -> FileResponse:
    """Return the Run as a zipped measurement bundle."""
    record = service.runs.get(run_id)
    _require_space(service, record.bytes)
    return FileResponse(
        service.runs.bundle(run_id),
        media_type="application/zip",
        filename=f"run-{run_id}.zip",
    )


class KnownLengthsOut(BaseModel):
    """Known lengths that are kept with a Run."""

    count: int = Field(examples=[3])


@router.put("/{run_id}/known-lengths", responses=declare_problems(404, 422))
def put_known_lengths(
    run_id: RunId,
    known_lengths: Annotated[
        UploadFile, File(description="A `known_lengths.csv`, as the tracker shows it.")
    ],
    service: ServiceDep,
) -> KnownLengthsOut:
    """Keep lengths that are known otherwise with a Run, in place of earlier ones.

    Analyses from now on settle the scale of all lengths by them.
    """
    data = known_lengths.file.read(_LARGEST_TABLE + 1)
    if len(data) > _LARGEST_TABLE:
        problem = f"is larger than {_LARGEST_TABLE >> 20} MB"
        raise BundleError(problem, file=KNOWN_LENGTHS, remedy="send fewer rows")
    lengths = decode_known_lengths(data)
    service.runs.store_known_lengths(run_id, data)
    return KnownLengthsOut(count=len(lengths))


@router.get(
    "/{run_id}/known-lengths",
    response_class=FileResponse,
    responses=declare_file("text/csv", 404, schema=TEXT),
)
def download_known_lengths(run_id: RunId, service: ServiceDep) -> FileResponse:
    """Return the known lengths that were sent after a Run, as they were sent."""
    kept = service.runs.name_known_lengths(service.runs.get(run_id).id)
    if not kept.is_file():
        raise NotFound(f"run {run_id} has no known lengths")
    return FileResponse(kept, media_type="text/csv", filename=KNOWN_LENGTHS)


@router.delete(
    "/{run_id}/known-lengths", status_code=204, responses=declare_problems(404)
)
def delete_known_lengths(run_id: RunId, service: ServiceDep) -> None:
    """Forget the known lengths that were sent after a Run."""
    service.runs.store_known_lengths(run_id, None)


@uploads.post("", status_code=201, responses=declare_problems(413, 422, 507))
async def upload_bundle(
    bundle: Annotated[UploadFile, File(description="A zipped measurement bundle.")],
    response: Response,
    service: ServiceDep,
) -> RunOut:
    """Take in a bundle that was recorded elsewhere; analyse it with a job."""
    run = await run_sync(_store_upload, bundle, service, limiter=_UPLOADING)
    response.headers["Location"] = address(f"/runs/{run.id}")
    return _describe(run)


def clean_run_name(filename: str | None) -> str:
    """Readable name from a file's name; never used as a path."""
    return (
        _ODD.sub("_", Path(_find_last_part(filename)).stem).strip("_ .")[:100]
        or "bundle"
    )


def _find_last_part(filename: str | None) -> str:
    return PurePosixPath((filename or "").replace("\\", "/")).name


def _store_upload(bundle: UploadFile, service: Service) -> RunRecord:
    _require_space(service, bundle.size or 0)
    upload = service.runs.make_upload_file()
    try:
        with upload.open("wb") as target:
            shutil.copyfileobj(bundle.file, target, 1 << 20)
        name = clean_run_name(bundle.filename)
        largest_bytes = UNPACKED_SHARE * service.max_upload_bytes
        return service.runs.add_uploaded(upload, name, largest_bytes)
    except BundleError as error:
        sent = _ODD.sub("_", _find_last_part(bundle.filename))[:100] or "bundle"
        place = {"row": error.row, "column": error.column, "remedy": error.remedy}
        is_complete = error.file in ("bundle", upload.name, str(upload))
        problem = error.problem.replace(str(upload), sent).replace(upload.name, sent)
        file = sent if is_complete else error.file
        raise BundleError(problem, file=file, **place) from error
    finally:
        upload.unlink(missing_ok=True)


def _require_space(service: Service, size: int) -> None:
    if service.free_bytes() < 2 * size + LEAST_FREE_BYTES:
        raise DiskFull("too little room is left on the disk of the data folder")


def _list_names(machine: str, service: Service) -> list[str]:
    """Names in the files of a machine; Runs know no other."""
    try:
        record = service.setup.registry.get(machine)
    except NotFound:
        return [machine]
    return [machine, *(str(v.machine_file["name"]) for v in record.versions)]


def _describe(run: RunRecord) -> RunOut:
    content = {**asdict(run), "note": run.note or ""}
    return RunOut(**content, links=RunLinks.of(id=run.id))
