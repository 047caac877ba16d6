"""Answers of jobs: live estimate, tables, reports, discoveries, trends.

Uncertainties are standard ones (k = 1).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from pydantic import BaseModel, Field

from truepath.answers.verification.conformity import Conformity, decide_conformity
from truepath.errors import NotFound
from truepath.files.earlier.verdict import State as VerdictState
from truepath.files.earlier.verdict import Verdict, verdict_from_json, verdict_json
from truepath.jobs.workers.reanalysis import RUNS, SUMMARY
from truepath.service.api.models.base import (
    JOB_ID,
    CompensationName,
    JobId,
    RunId,
    TargetUm,
)
from truepath.service.api.models.results.discovery import DiscoveryOut, TrendOut
from truepath.service.api.models.results.result import (
    ErrorTablesOut,
    FigureOut,
    ResultOut,
)
from truepath.service.api.models.results.verification import VerificationOut
from truepath.service.api.models.tables import (
    AxisLocationOut,
    LiveTableOut,
    SquarenessOut,
    TablesOut,
    Vector3,
    VerdictOut,
)
from truepath.service.api.problems import TEXT, declare_file, declare_problems
from truepath.service.api.service import Service, ServiceDep

router = APIRouter(prefix="/jobs", tags=["results"])

_REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-popups; default-src 'none'; "
    "script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)


_COVERAGE = 2.0  # k of expanded uncertainties


Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_POSITIONS = [[0.0, 0.0, 0.0], [0.0, 0.0, 62.5]]


class RunFigures(BaseModel):
    """What a result of a Run states in short."""

    verdict: VerdictState | None
    volumetric_error_um: float = Field(
        description="Mean length of the volumetric error over the travel."
    )
    uncertainty_um: float = Field(description="Its standard uncertainty (k = 1).")


class RunFailure(BaseModel):
    """Why a Run has no result."""

    family: str = Field(examples=["AlignmentError"])
    detail: str


class ReanalysedRun(BaseModel):
    """One Run before and after; `before` is of the newest job of that Run alone."""

    run_id: str
    name: str
    truepath: str = Field(description="Version that has analysed it.")
    before_job: str | None
    before: RunFigures | None
    after: RunFigures | None
    failure: RunFailure | None
    took_s: float


class ReanalysisOut(BaseModel):
    """What has become of every Run."""

    schema_: str = Field(alias="schema", examples=["reanalysis/1"])
    truepath: str
    total: int
    analysed: int
    failed: int
    compared: int = Field(description="Runs that have a result before and after.")
    unchanged: int = Field(description="Of these, the same volumetric error.")
    largest_change_um: float | None
    verdict_changes: dict[str, int] = Field(examples=[{"usable -> doubtful": 2}])
    analyses: list[ReanalysedRun]


class CourseOut(BaseModel):
    """How the uncertainty came down: columns, one row an estimate, oldest first."""

    elapsed_s: list[float]
    done: list[int]
    volumetric_uncertainty_um: list[float]


class CommandedPlacesOut(BaseModel):
    """Where the rows of the path about the newest line should be seen.

    As the standstills so far place the machine before the tracker: what lies beside
    the line between two of them is an error of the machine, of the tracker, or noise.
    """

    first_row: int
    tracker_mm: list[Vector3] = Field(description="One place a row.")


class EstimateOut(BaseModel):
    """The newest live estimate."""

    job_id: str = Field(examples=[JOB_ID])
    verdict: VerdictOut
    volumetric_uncertainty_um: float = Field(
        description="Root mean square, over the axis travel, of the standard "
        "uncertainty of the volumetric error."
    )
    done: int = Field(description="Finished lines or points behind it.")
    total: int = Field(description="Lines or points of the plan.")
    cells: int
    device_time_s: float = Field(description="The tracker's clock.")
    elapsed_s: float = Field(description="Since the stream began.")
    is_last: bool
    age_s: float
    dropped_blocks: int = Field(description="Of the stream, for want of time.")
    error_tables: dict[str, LiveTableOut]
    squareness_urad: dict[str, SquarenessOut]
    axis_location: dict[str, AxisLocationOut] | None = Field(
        None, description="Of machines with rotary axes."
    )
    commanded: CommandedPlacesOut | None = Field(
        None,
        description="Of straight lines to one target, once the tracker's pose is "
        "known.",
    )
    course: CourseOut


class SizeOut(FigureOut):
    """A length in µm with its standard uncertainty (k = 1)."""


class SpreadOut(BaseModel):
    """Length of the volumetric error over the travel."""

    mean: SizeOut
    p95: SizeOut = Field(description="Below it lie 95 % of the places.")
    largest: SizeOut
    conformity: Conformity | None = Field(
        description="Of the mean by ISO 14253-1 with k = 2; null without a tolerance."
    )
    conformity_p95: Conformity | None = Field(
        description="Of `p95` against the tolerance of the machine, by ISO 14253-1 "
        "with k = 2; null where the machine has none."
    )


class VolumetricErrorOfResult(BaseModel):
    """The volumetric error before, and as full compensation is expected to leave it."""

    job_id: str = Field(examples=[JOB_ID])
    verdict: VerdictState = Field(description="Of the result.")
    tolerance_um: float | None = Field(description="Of the mean, as asked for.")
    machine_tolerance_um: float | None = Field(
        description="What 95 % of the places in the travel of the machine may err by "
        "at most, as it is set now; null where it has no tolerance.",
        examples=[15.0],
    )
    before: SpreadOut
    after_expected: SpreadOut
    on: str = Field(description="Where it was computed, in words.")


class VolumetricMapOut(BaseModel):
    """The volumetric error on a grid over the travel, mean of both directions.

    Without the rigid motion of the whole volume. Uncertainties are standard ones.
    """

    job_id: str = Field(examples=[JOB_ID])
    state: Literal["before", "after"]
    compensation: str | None = Field(
        description="Kept files whose correction it is; null for a full correction.",
        examples=["linuxcnc-10-hold"],
    )
    verdict: VerdictState = Field(description="Of the result.")
    target: str = Field(description="Whose error it is; empty where it has no name.")
    points: int = Field(description="An axis.", examples=[9])
    axes: list[str] = Field(examples=[["X", "Y", "Z"]])
    position: list[list[float]] = Field(
        description="mm for linear axes, X slowest; rotary axes rest at their zero.",
        examples=[_POSITIONS],
    )
    error_um: list[Vector] = Field(
        description="δ = actual − nominal as far as it is known; 0 after a full "
        "correction.",
        examples=[[[4.1, -2.2, 0.6], [3.9, -2.4, 0.9]]],
    )
    uncertainty_um: list[Vector] = Field(examples=[[[0.3, 0.3, 0.2]]])
    length_um: list[float] = Field(
        description="Of the error; after compensation the expected one of what is "
        "left, over the errors that the measurement allows.",
        examples=[[4.69, 4.67]],
    )
    is_measured: list[bool] = Field(
        description="False far beyond what was measured: extrapolated.",
        examples=[[True, True]],
    )


def get_machine_tolerance_um(service: Service, job_id: str) -> float | None:
    """Tolerance of the machine of a job; None where it is unknown."""
    machine_id = service.store.get(job_id).machine
    if machine_id is None:
        return None
    try:
        return service.setup.registry.get(machine_id).tolerance_um
    except NotFound:
        return None


def _compare_with_tolerances(
    spread: dict[str, Any], mean_um: float | None, machine_um: float | None
) -> SpreadOut:
    """Sizes in µm with their conformity to both tolerances."""
    return SpreadOut(
        **spread,
        conformity=_decide(spread["mean"], mean_um),
        conformity_p95=_decide(spread["p95"], machine_um),
    )


def _decide(size: dict[str, float], tolerance_um: float | None) -> Conformity | None:
    if tolerance_um is None:
        return None
    expanded_um = _COVERAGE * size["uncertainty_um"]
    return decide_conformity(size["value_um"], expanded_um, tolerance_um)


def send_page(report: Path) -> FileResponse:
    """A report as a page without access to anything outside."""
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


@router.get(
    "/{job_id}/result/error-tables.csv",
    response_class=FileResponse,
    responses=declare_file("text/csv", 404, 422, schema=TEXT),
)
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


@router.get(
    "/{job_id}/result/report.html",
    response_class=HTMLResponse,
    responses=declare_problems(404),
)
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
    machine_um = get_machine_tolerance_um(service, job_id)
    before, after = (
        _compare_with_tolerances(stated[state], tolerance_um, machine_um)
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
    from truepath.compensation.volumetric_error_grid import MapOrder, store_map

    order = MapOrder(grid, state, compensation)
    found = store_map(file, file.parent / "maps", order, file.parent / "compensations")
    verdict = found["verdict"]["state"]
    return VolumetricMapOut(**{**found, "verdict": verdict}, job_id=job_id)


@router.get(
    "/{job_id}/discovery", response_model=DiscoveryOut, responses=declare_problems(404)
)
def get_discovery(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return `discovery.json`: the missing effects, the gap, where they disagree."""
    return FileResponse(_find_file(service, job_id, "discovery.json", of="discovery"))


@router.get(
    "/{job_id}/discovery/report.html",
    response_class=HTMLResponse,
    responses=declare_problems(404),
)
def get_discovery_report(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return the report of a discovery, one page that needs nothing else."""
    return send_page(_find_file(service, job_id, "report.html", of="discovery"))


@router.get("/{job_id}/trend", response_model=TrendOut, responses=declare_problems(404))
def get_trend(job_id: JobId, service: ServiceDep) -> FileResponse:
    """Return `trend.json`: tables at each Run and later, when to calibrate again."""
    return FileResponse(_find_file(service, job_id, "trend.json", of="trend"))


@router.get(
    "/{job_id}/trend/report.html",
    response_class=HTMLResponse,
    responses=declare_problems(404),
)
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


@router.get(
    "/{job_id}/verification/report.html",
    response_class=HTMLResponse,
    responses=declare_problems(404),
)
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
    if job.answer != of or not file.is_file():
        raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no {name}")
    return file
