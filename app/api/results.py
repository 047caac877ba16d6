"""What jobs found: the estimate on the way, tables, reports, discoveries, trends."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse, JSONResponse

from truepath.app.api.models.base import CompensationName, JobId, RunId, TargetUm
from truepath.app.api.models.discovery import DiscoveryOut
from truepath.app.api.models.estimate import EstimateOut
from truepath.app.api.models.reanalysis import ReanalysisOut
from truepath.app.api.models.result import ErrorTablesOut, ResultOut
from truepath.app.api.models.tables import TablesOut
from truepath.app.api.models.trend import TrendOut
from truepath.app.api.models.verification import VerificationOut
from truepath.app.api.models.volumetric_error import (
    VolumetricErrorOfResult,
    VolumetricMapOut,
)
from truepath.app.api.problems import declare_problems
from truepath.app.api.service import Service, ServiceDep
from truepath.app.api.tolerances import find_machine_tolerance_um, hold_against
from truepath.app.errors import NotFound
from truepath.app.files.verdict import Verdict, verdict_from_json, verdict_json
from truepath.app.jobs.reanalysis import RUNS, SUMMARY

router = APIRouter(prefix="/jobs", tags=["results"])

_REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-popups; default-src 'none'; "
    "script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)


def _serve_file(path: str, media_type: str, kind: str, *refusals: int) -> Any:
    """Return the decorator of a route that answers with a file."""
    content = {media_type: {"schema": {"type": kind}}}
    responses = {200: {"content": content}, **declare_problems(404, *refusals)}
    return router.get(path, response_class=FileResponse, responses=responses)


def send_page(report: Path) -> FileResponse:
    """Return a report as a page that may ask for nothing and do nothing outside."""
    return FileResponse(report, headers={"Content-Security-Policy": _REPORT_POLICY})


@router.get(
    "/{job_id}/estimate",
    responses={
        204: {"description": "A measurement that has no estimate yet."},
        **declare_problems(404),
    },
    response_model=EstimateOut,
)
def get_estimate(job_id: JobId, service: ServiceDep) -> Response | EstimateOut:
    """Return the latest estimate of a measurement under way, or of one just ended.

    Values in µm and µrad with standard uncertainties; `volumetric_uncertainty_um` is
    the root mean square, over the axis travel, of the standard uncertainty of the
    volumetric error; `course` says how it came down. What counts in the end is
    `/result`.
    """
    job = service.store.get(job_id)
    estimates = service.event_bus.estimates
    newest = estimates.newest(job.id)
    if newest is None and job.kind.measures:
        return Response(status_code=204)
    if newest is None:
        raise NotFound(f"job {job_id} ({job.kind}) measures nothing: no live estimate")
    course = estimates.course(job.id)
    return EstimateOut.model_validate({"job_id": job.id, **newest, "course": course})


@router.get(
    "/{job_id}/result", response_model=ResultOut, responses=declare_problems(404)
)
def get_result(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return `result.json`: error tables, squareness, uncertainty, observability."""
    return FileResponse(_find_file(service, job_id, "result.json"))


@router.get(
    "/{job_id}/result/error-tables.json",
    response_model=ErrorTablesOut,
    responses=declare_problems(404),
)
def get_error_tables(job_id: JobId, service: ServiceDep) -> JSONResponse:
    """Return the error tables and squarenesses alone, with the verdict on them."""
    result = _read_result(service, job_id)
    tables = {key: result[key] for key in TablesOut.model_fields if key in result}
    verdict = result.get("verdict", verdict_json(Verdict()))
    head = {"schema": "error-tables/1", "machine": result["machine"]}
    return JSONResponse({**head, "verdict": verdict, **tables})


@_serve_file("/{job_id}/result/error-tables.csv", "text/csv", "string", 422)
def download_error_tables(
    job_id: JobId,
    service: ServiceDep,
    accept_verdict: Annotated[
        bool, Query(description="Have the tables of a result that is not to be used.")
    ] = False,
) -> FileResponse:
    """Return the error tables as `error_tables.csv`.

    Refused where the result says that it is not to be used; `accept_verdict` has it.
    """
    file = _find_file(service, job_id, "error_tables.csv")
    verdict = _read_verdict(_read_result(service, job_id))
    if not accept_verdict:
        verdict.require_usable(f"the result of job {job_id}")
    return FileResponse(file, filename=file.name)


@_serve_file("/{job_id}/result/report.html", "text/html", "string")
def get_report(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return the report, one page that needs nothing else."""
    return send_page(_find_file(service, job_id, "report.html"))


@router.get("/{job_id}/result/volumetric-error", responses=declare_problems(404, 422))
def get_volumetric_error(
    job_id: JobId,
    service: ServiceDep,
    tolerance_um: Annotated[
        TargetUm | None, Query(description="Of the mean length over the travel.")
    ] = None,
) -> VolumetricErrorOfResult:
    """Return the size of the volumetric error before and as expected after.

    With a tolerance each mean is held against it, with its expanded uncertainty; what
    95 % of the places err by at most is held against the tolerance of the machine.
    """
    result = _read_result(service, job_id)
    stated = result.get("volumetric_error")
    if stated is None:
        raise NotFound(f"the result of job {job_id} states no volumetric error")
    machine_um = find_machine_tolerance_um(service, job_id)
    before, after = (
        hold_against(stated[state], tolerance_um, machine_um)
        for state in ("before", "after_expected")
    )
    return VolumetricErrorOfResult(
        job_id=job_id,
        verdict=_read_verdict(result).state,
        tolerance_um=tolerance_um,
        machine_tolerance_um=machine_um,
        before=before,
        after_expected=after,
        on=stated["on"],
    )


@router.get("/{job_id}/result/volumetric-map", responses=declare_problems(404, 422))
def get_volumetric_map(
    job_id: JobId,
    service: ServiceDep,
    grid: Annotated[int, Query(ge=2, le=11, description="Points an axis.")] = 9,
    state: Annotated[
        Literal["before", "after"], Query(description="Of the compensation.")
    ] = "before",
    compensation: Annotated[
        CompensationName | None,
        Query(description="Kept files of the state after; full correction without."),
    ] = None,
) -> VolumetricMapOut:
    """Return the volumetric error on a grid over the travel, with its uncertainty.

    After compensation it is what is left: by kept files as their controller reads them
    back, or of a full correction, where only the uncertainty of the result remains.
    Computed once and kept with the result.
    """
    file = _find_file(service, job_id, "result.json")
    # Imported where it computes: the service itself carries no science.
    from truepath.app.compensation.map_in_volume import MapOrder, keep_map

    order = MapOrder(grid, state, compensation)
    found = keep_map(file, file.parent / "maps", order, file.parent / "compensations")
    verdict = found["verdict"]["state"]
    return VolumetricMapOut(**{**found, "verdict": verdict}, job_id=job_id)


@router.get(
    "/{job_id}/discovery", response_model=DiscoveryOut, responses=declare_problems(404)
)
def get_discovery(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return `discovery.json`: the missing effects, the gap, where they disagree."""
    return FileResponse(_find_file(service, job_id, "discovery.json", of="discovery"))


@_serve_file("/{job_id}/discovery/report.html", "text/html", "string")
def get_discovery_report(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return the report of a discovery, one page that needs nothing else."""
    return send_page(_find_file(service, job_id, "report.html", of="discovery"))


@router.get("/{job_id}/trend", response_model=TrendOut, responses=declare_problems(404))
def get_trend(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return `trend.json`: tables at each Run and later, when to calibrate again."""
    return FileResponse(_find_file(service, job_id, "trend.json", of="trend"))


@_serve_file("/{job_id}/trend/report.html", "text/html", "string")
def get_trend_report(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return the report of a machine over time, one page that needs nothing else."""
    return send_page(_find_file(service, job_id, "report.html", of="trend"))


@router.get(
    "/{job_id}/reanalysis",
    response_model=ReanalysisOut,
    responses=declare_problems(404),
)
def get_reanalysis(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return what has become of every Run: before, after, or why it failed."""
    return FileResponse(_find_file(service, job_id, SUMMARY, of="reanalysis"))


@router.get(
    "/{job_id}/reanalysis/runs/{run_id}",
    response_model=ResultOut,
    responses=declare_problems(404),
)
def get_reanalysed_run(
    job_id: JobId, run_id: RunId, service: ServiceDep
) -> FileResponse:
    """Return the `result.json` of one Run of a reanalysis."""
    record = service.runs.get(run_id)
    summary = _find_file(service, job_id, SUMMARY, of="reanalysis")
    file = summary.parent / RUNS / record.id / "result.json"
    if not file.is_file():
        raise NotFound(f"reanalysis {job_id} has no result of run {run_id}")
    return FileResponse(file)


@router.get(
    "/{job_id}/verification",
    response_model=VerificationOut,
    responses=declare_problems(404),
)
def get_verification(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return `verification.json`: what a measurement says of the result it proves."""
    return FileResponse(
        _find_file(service, job_id, "verification.json", of="verification")
    )


@_serve_file("/{job_id}/verification/report.html", "text/html", "string")
def get_verification_report(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return the report of a verification, one page that needs nothing else."""
    return send_page(_find_file(service, job_id, "report.html", of="verification"))


def _read_result(service: Service, job_id: str) -> dict[str, Any]:
    file = _find_file(service, job_id, "result.json")
    return json.loads(file.read_text(encoding="utf-8"))


def _read_verdict(result: dict[str, Any]) -> Verdict:
    stated = result.get("verdict")
    return verdict_from_json(stated) if stated else Verdict()


def _find_file(service: Service, job_id: str, name: str, of: str = "result") -> Path:
    job = service.store.get(job_id)
    file = service.results / job.id / name
    made = {
        "result": job.has_result,
        "discovery": job.has_discovery,
        "trend": job.has_trend,
        "reanalysis": job.has_reanalysis,
        "verification": job.has_verification,
    }
    if not made[of] or not file.is_file():
        raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no {name}")
    return file
