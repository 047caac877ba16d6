"""Compensation files of a result, and those in the control of a simulated machine."""

from __future__ import annotations

from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from truepath.answers.machine_history import find_model_file
from truepath.files.earlier.verdict import State as VerdictState
from truepath.service.api.access_control import note_change
from truepath.service.api.models.base import (
    JOB_ID,
    CompensationId,
    CompensationName,
    Identifier,
    JobId,
    Links,
    MachinePath,
    RequestBody,
    examples,
)
from truepath.service.api.models.tables import EffectKeys, Vector3
from truepath.service.api.problems import declare_file, declare_problems
from truepath.service.api.service import Service, ServiceDep

router = APIRouter(tags=["compensation"])

FileInPath = Annotated[
    str, Path(description="One of `files`.", examples=["compensation-X.tbl"])
]


class SignOut(BaseModel):
    """How a value of the file moves the axis."""

    rule: str
    verified: bool = Field(
        description="From the maker's manual or source; else one deliberate value has "
        "to settle it at the machine before first use."
    )


class FormatOut(BaseModel):
    """A format of a controller."""

    name: str = Field(examples=["linuxcnc"])
    control: str = Field(examples=["LinuxCNC"])
    carries: str = Field(examples=["positioning of each axis, forward and reverse"])
    not_carried: str
    most_rows: int = Field(description="Of a table.")
    resolution_um: float
    sign: SignOut
    note: str = Field(description="What to do with the files at the control.")
    choices: dict[str, list[str]] = Field(
        description="What may be chosen, by name; the first word is usual.",
        examples=[{"control": ["840d-sl", "828d", "808d"]}],
    )
    by_axis: list[str] = Field(
        default_factory=list[str],
        description="Those of `choices` that may be stated axis by axis, as "
        "`X=1,Y=2`; the usual word for the others.",
        examples=[["measuring_system"]],
    )


class FormatList(BaseModel):
    """Every installed format, by name."""

    items: list[FormatOut]


FileText = Annotated[str, Field(max_length=1 << 20)]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,100}$")]


class CompensationRequest(RequestBody):
    """Which files to make of a result."""

    model_config = examples({"format": "linuxcnc"})

    format: str = Field(description="Name of an installed format.", max_length=50)
    spacing_mm: float = Field(
        10.0,
        ge=0.1,
        le=1000.0,
        allow_inf_nan=False,
        description="Of the rows, or the smallest that the controller has room for.",
    )
    unmeasured: Literal["hold", "fade", "refuse"] = Field(
        "hold", description="What tables have where an axis was not measured."
    )
    choices: dict[str, str] = Field(
        default_factory=dict,
        max_length=8,
        description="Of the format's choices, by name; the usual for the others.",
    )
    accept_verdict: bool = Field(
        False, description="Make files of a result that is not to be used."
    )
    active_files: dict[FileName, FileText] = Field(
        default_factory=dict,
        max_length=32,
        json_schema_extra={"additionalProperties": False},
        description="Text by name of the tables that the control had meanwhile, where "
        "the service has not loaded them itself.",
    )
    difference: bool = Field(
        False, description="Files of what the active tables lacked, not of both."
    )


class BasisOut(BaseModel):
    """What the files hold: the whole correction, or what active tables lacked."""

    holds: Literal["as-found", "as-measured", "combined", "difference"]
    control_compensation: Literal["on", "off"] | None = Field(
        description="While it was measured; null where nothing states it."
    )
    text: str


class MapErrorOut(BaseModel):
    """Volumetric error of the machine as it was found, µm."""

    mean: float
    largest: float


class LeftErrorOut(MapErrorOut):
    """Volumetric error that the files leave, of errors that the measurement allows."""

    mean_uncertainty: float = Field(description="Standard uncertainty of the mean.")


class VolumetricErrorOut(BaseModel):
    """Before and with the files, as their controller reads them."""

    before: MapErrorOut
    after: LeftErrorOut
    after_where_measured: LeftErrorOut | None = Field(
        description="Where every axis was measured; null if there is no such place."
    )
    on: str = Field(description="Where it was computed, in words.")


class LeftByReason(BaseModel):
    """What is left by its reasons, µm: root mean squares over the travel."""

    map: float = Field(description="Of the errors as they were found.")
    not_carried: float
    between_rows: float
    rounding: float
    unmeasured_range: float
    not_known_by_the_measurement: float


class HoldsForTargetOut(BaseModel):
    """The target that the files hold for."""

    target: str = Field(description="Its name; empty where there is one only.")
    offset_mm: Vector3
    confounded: list[str] = Field(description="Symbols that it cannot part.")


class TableFactsOut(BaseModel):
    """The table of an axis."""

    points: int
    spacing_mm: float
    from_mm: float
    to_mm: float
    measured_from_mm: float
    measured_to_mm: float
    zero: str


class OverAxesOut(BaseModel):
    """Mean length of the error where all axes move, rotary ones too, µm."""

    before: float
    before_expanded_uncertainty: float | None = None
    after: float = Field(description="That the files leave of the map.")
    after_expected: float | None = Field(
        None, description="That they leave of errors that the measurement allows."
    )
    after_expanded_uncertainty: float | None = Field(
        None, description="Of `after_expected`."
    )
    coverage_factor: float | None = Field(
        None,
        description="Of expanded uncertainties; null of files without them.",
    )
    on: str


class RotaryTableOut(BaseModel):
    """The table of a rotary axis."""

    points: int
    spacing_deg: float
    from_deg: float
    to_deg: float
    repeats_each_turn: bool


class BeforeAfterOut(BaseModel):
    """A root mean square before, and with the files."""

    before: float
    after: float


class RotaryChangeOut(BeforeAfterOut):
    """A root mean square of a rotary axis, with what the measurement allows."""

    after_expected: float | None = Field(
        None, description="That the files leave of errors that the measurement allows."
    )
    after_expanded_uncertainty: float | None = Field(
        None, description="Of `after_expected`, k = 2."
    )


class RotaryLeftOut(BaseModel):
    """What files leave of a rotary axis, root mean squares over the travel."""

    table: RotaryTableOut | None = Field(description="Null where the files have none.")
    positioning_urad: RotaryChangeOut | None = None
    at_tool_um: RotaryChangeOut | None = Field(
        None, description="What that positioning does to the tool."
    )
    location_at_tool_um: RotaryChangeOut | None = Field(
        None, description="What the place of the axis does to the tool."
    )
    lost_motion: str | None = Field(
        None,
        description="Whether the result has it, and the files, in words.",
        examples=["not in the result"],
    )
    lost_motion_urad: RotaryChangeOut | None = Field(
        None,
        description="By how much both directions differ; null without a result of it.",
    )
    not_in_files: list[str] = Field(description="Symbols that no table can have.")


class EffectLeftOut(EffectKeys):
    """What remains of an effect of a model. Further keys are those of its family."""

    rms_um: BeforeAfterOut
    note: str


class LengthsOut(BaseModel):
    """At which temperature lengths of the files hold: no number is normalised."""

    measured_degC: tuple[float, float] | None = Field(  # noqa: N815
        description="Lowest and highest of the axis scales, else of all sensors; null "
        "where unknown."
    )
    reference_degC: float = Field(examples=[20.0])  # noqa: N815
    normalised: bool
    text: str
    warning: str | None = Field(
        description="Where the measurement was more than 1 K off, or nobody knows."
    )


class CompensationLinks(Links):
    """Where the files are."""

    self: Annotated[str, "/jobs/{job}/compensations/{id}"]
    archive: Annotated[str, "/jobs/{job}/compensations/{id}/archive"]
    job: Annotated[str, "/jobs/{job}"]


class CompensationOut(BaseModel):
    """Files of a format and what they leave: the account that stands beside them."""

    id: str = Field(examples=["linuxcnc-10-hold"])
    format: str = Field(examples=["linuxcnc"])
    control: str
    choices: dict[str, str] = Field(
        default_factory=dict, description="Of the format, as they were taken."
    )
    basis: BasisOut | None = Field(None, description="Null of earlier files.")
    files: list[str] = Field(examples=[["compensation-X.tbl", "compensation-Y.tbl"]])
    files_sha256: dict[str, str] = Field(
        default_factory=dict, description="SHA-256 by name."
    )
    machine: str
    verdict: VerdictState = Field(description="Of the result they were made of.")
    carries: str
    not_carried: str
    sign: SignOut
    holds_for: HoldsForTargetOut
    tables: dict[str, TableFactsOut] = Field(description="By axis.")
    over_all_axes_um: OverAxesOut | None = Field(
        None, description="Null for a machine of straight axes."
    )
    rotary: dict[str, RotaryLeftOut] = Field(
        default_factory=dict, description="By rotary axis."
    )
    unmeasured: list[str] = Field(description="Ranges without a measurement, in words.")
    unobservable: list[str] = Field(description="What the data cannot tell.")
    volumetric_error_um: VolumetricErrorOut
    left_um: LeftByReason
    effects: list[EffectLeftOut] = Field(
        description="What remains of each effect of a model."
    )
    note: str
    stamp: list[str] = Field(
        default_factory=list,
        description="Where the files come from, what they are of, the range and the "
        "temperature they hold at: the lines of their comments, where their control "
        "reads any, and here for all.",
    )
    lengths: LengthsOut | None = Field(
        None, description="At which temperature lengths hold."
    )
    links: CompensationLinks


class CompensationList(BaseModel):
    """All files that were made of a result."""

    items: list[CompensationOut]


# What computes is imported where it does: the service itself carries no science.


@router.get("/compensation-formats")
def list_compensation_formats() -> FormatList:
    """List the formats of controllers that files can be made for."""
    from truepath.compensation.format_registry import describe_format, list_formats

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
    from truepath.compensation.active_files import GivenTables
    from truepath.compensation.order import CompensationOrder, store_files
    from truepath.compensation.tables.error_map import Unmeasured

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
        *store_files(source, folder, order, accept_verdict=request.accept_verdict),
    )
    response.headers["Location"] = made.links.self
    return made


@router.get("/jobs/{job_id}/compensations", responses=declare_problems(404))
def list_compensations(job_id: JobId, service: ServiceDep) -> CompensationList:
    """List the files that were made of a result."""
    from truepath.compensation.stored_files import list_accounts

    kept = list_accounts(_find_folder(service, job_id))
    return CompensationList(items=[_describe(job_id, *each) for each in kept])


@router.get(
    "/jobs/{job_id}/compensations/{compensation_id}", responses=declare_problems(404)
)
def get_compensation(
    job_id: JobId, compensation_id: CompensationId, service: ServiceDep
) -> CompensationOut:
    """Return what files leave, and their names."""
    from truepath.compensation.stored_files import read_account

    account = read_account(_find_folder(service, job_id), compensation_id)
    return _describe(job_id, compensation_id, account)


@router.get(
    "/jobs/{job_id}/compensations/{compensation_id}/files/{name}",
    response_class=FileResponse,
    responses=declare_file("application/octet-stream", 404),
)
def download_compensation_file(
    job_id: JobId,
    compensation_id: CompensationId,
    name: FileInPath,
    service: ServiceDep,
) -> FileResponse:
    """Return one file as the control loads it, or `compensation.json`."""
    from truepath.compensation.stored_files import find_file

    file = find_file(_find_folder(service, job_id), compensation_id, name)
    return FileResponse(file, media_type="application/octet-stream", filename=name)


@router.get(
    "/jobs/{job_id}/compensations/{compensation_id}/archive",
    response_class=Response,
    responses=declare_file("application/zip", 404),
)
def download_compensation(
    job_id: JobId, compensation_id: CompensationId, service: ServiceDep
) -> Response:
    """Return all files and their account, zipped."""
    from truepath.compensation.stored_files import pack_files

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


simulated_tables = APIRouter(
    prefix="/machines/{machine_id}/simulated-tables", tags=["compensation"]
)


class SimulatedTablesRequest(RequestBody):
    """Files that were made of a result."""

    model_config = examples({"job_id": JOB_ID, "compensation_id": "isg-csv-10-hold"})

    job_id: Identifier = Field(description="Job of the result.")
    compensation_id: CompensationName = Field(
        description="`id` of files in `GET /jobs/{job_id}/compensations`."
    )


class SimulatedTablesOut(BaseModel):
    """What the control has from this service; nothing of it at first."""

    machine: str = Field(examples=["default"])
    simulated: bool = Field(
        description="Whether the control is a simulated one: no other takes files."
    )
    job_id: str | None = Field(description="Job of the result; null without files.")
    compensation_id: str | None
    files: list[str] = Field(examples=[["compensation.csv"]])


@simulated_tables.get("", responses=declare_problems(404))
def get_simulated_tables(
    machine_id: MachinePath, service: ServiceDep
) -> SimulatedTablesOut:
    """Return the files that a simulated control has from this service."""
    service.machines.get(machine_id)
    return _describe_tables(machine_id, service)


@simulated_tables.put("", responses=declare_problems(404, 409, 422))
def load_simulated_tables(
    machine_id: MachinePath,
    request: SimulatedTablesRequest,
    service: ServiceDep,
    http: Request,
) -> SimulatedTablesOut:
    """Give a simulated control the files of a result in place of those it has.

    Refused for a machine with real devices, and while a job holds the machine.
    """
    machine = service.machines.get(machine_id).machine
    controls = service.setup.simulated_controls
    controls.require(machine_id)  # a real one is refused, whatever else is wrong
    service.setup.reject_while_measuring(machine_id)
    job_id = service.store.get(request.job_id).id
    folder = service.results / job_id / "compensations"
    before = _describe_tables(machine_id, service)
    controls.load(machine_id, machine, folder, job_id, request.compensation_id)
    after = _describe_tables(machine_id, service)
    note_change(http, old=_name_tables(before), new=_name_tables(after))
    return after


@simulated_tables.delete("", status_code=204, responses=declare_problems(404, 409, 422))
def clear_simulated_tables(
    machine_id: MachinePath, service: ServiceDep, http: Request
) -> Response:
    """Take the tables of a simulated control away: it is as it was found again."""
    service.machines.get(machine_id)
    controls = service.setup.simulated_controls
    controls.require(machine_id)
    service.setup.reject_while_measuring(machine_id)
    before = _describe_tables(machine_id, service)
    controls.clear(machine_id)
    note_change(http, old=_name_tables(before), new={})
    return Response(status_code=204)


def _name_tables(tables: SimulatedTablesOut) -> dict[str, str | None]:
    return {"job_id": tables.job_id, "compensation_id": tables.compensation_id}


def _describe_tables(machine_id: str, service: Service) -> SimulatedTablesOut:
    controls = service.setup.simulated_controls
    loaded = controls.read(machine_id)
    return SimulatedTablesOut(
        machine=machine_id,
        simulated=controls.is_simulated(machine_id),
        job_id=loaded.job_id,
        compensation_id=loaded.compensation_id,
        files=list(loaded.files),
    )
