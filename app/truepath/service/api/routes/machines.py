"""The machines: identity, configuration, trial of their devices."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue

from truepath.catalogue.machine_registry import IDENTITY, MachineRecord
from truepath.files.bundle.machine_file import MachineFile
from truepath.machine_settings import DeviceConfiguration, Options, check_machine_id
from truepath.machines.machine_setup import show_devices
from truepath.measurement.messages import TrackerTried
from truepath.service.api.access_control import note_change
from truepath.service.api.models.base import (
    JOB_ID,
    AsKept,
    Identifier,
    MachineId,
    MachinePath,
    Name,
    RequestBody,
    address,
    examples,
)
from truepath.service.api.models.machine_files import MachineFileOut
from truepath.service.api.problems import declare_problems
from truepath.service.api.request_parameters import Version, VersionIfGiven
from truepath.service.api.routes.machine import (
    ConditionList,
    Connection,
    describe_connection,
    list_conditions_of,
)
from truepath.service.api.service import CONNECTING, Service, ServiceDep, on_threads

router = APIRouter(prefix="/machines", tags=["machines"])

_PLAIN = str, int, float, type(None)
_JUDGED_BY = "tolerance_um", "reference_job"


_TRACKER: dict[str, JsonValue] = {"port": "/dev/serial/by-id/usb-tracker-if00-port0"}


class MachineIdentity(RequestBody):
    """Who a machine is, as certificates state it. What is left out stays as it is."""

    model_config = examples(
        {
            "maker": "Example Works",
            "model": "VMC 400",
            "serial_number": "4711",
            "customer": "Example Ltd",
            "place": "hall 3",
            "tolerance_um": 15.0,
        }
    )

    name: Name | None = None
    maker: Name | None = None
    model: Name | None = None
    serial_number: Name | None = None
    control: Name | None = Field(default=None, description="The numerical control.")
    customer: Name | None = None
    place: Name | None = None
    tolerance_um: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        allow_inf_nan=False,
        description="What 95 % of the places in its travel may err by at most. Null "
        "takes it back.",
    )
    reference_job: Identifier | None = Field(
        default=None,
        description="Job whose result later ones are held against, a usable "
        "calibration of this machine. Null: the one before.",
    )


_FILE = {
    "schema": "machine/1",
    "name": "VMC 400",
    "kinematic_chain": "w-X-b-Y-Z-t",
    "axes": {
        "X": {"type": "linear", "min_mm": 0, "max_mm": 400},
        "Y": {"type": "linear", "min_mm": 0, "max_mm": 300},
        "Z": {"type": "linear", "min_mm": 0, "max_mm": 200},
    },
    "tool_offset_mm": [20, 30, -150],
}


class MachineDescription(RequestBody):
    """A machine described anew."""

    model_config = examples({"machine_file": _FILE})

    machine_file: Annotated[dict[str, Any], AsKept(MachineFile)] = Field(
        description="The content of machine.json."
    )


class NewMachine(MachineDescription):
    """A machine to add. Its devices are chosen afterwards."""

    model_config = examples(
        {
            "id": "mill-3",
            "machine_file": _FILE,
            "identity": {"serial_number": "4711"},
        }
    )

    id: Annotated[MachineId, AfterValidator(check_machine_id)]
    identity: MachineIdentity = Field(default_factory=MachineIdentity)


class MachineDevices(DeviceConfiguration):
    """Drivers and their options, as in the settings."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        str_max_length=4096,
        json_schema_extra={
            "examples": [
                {
                    "tracker_driver": "streaming",
                    "tracker_options": _TRACKER,
                    "motion_driver": "modbus",
                    "motion_options": {"host": "192.0.2.10", "port": 502},
                }
            ]
        },
    )


class DevicesOut(BaseModel, extra="allow"):
    """How the devices are reached: nothing where they have not been chosen.

    Further keys are those of the settings of a machine.
    """

    simulated: bool | None = Field(None, description="The devices are simulated ones.")
    tracker_driver: str | None = Field(None, examples=["streaming"])
    tracker_options: Options | None = None
    motion_driver: str | None = Field(None, examples=["modbus"])
    motion_options: Options | None = None
    thermometer_driver: str | None = Field(
        None, description="Empty: no thermometers but those that the tracker has."
    )
    thermometer_options: Options | None = None
    allow_no_watchdog: bool | None = None


class MachineVersionOut(BaseModel):
    """One configuration of a machine."""

    number: int = Field(examples=[1])
    sha256: str = Field(description="Of machine file and devices.")
    since: str = Field(examples=["2026-05-04T09:30:00.000Z"])


class MachineEntry(BaseModel):
    """A machine: who it is, how it is configured, what holds it."""

    id: str = Field(examples=["mill-3"])
    origin: str = Field(
        examples=["settings"],
        description="Where it is configured: `settings`, or `catalogue` where it was "
        "added over this interface; `removed` where its history alone is left.",
    )
    name: str = Field(examples=["VMC 400"])
    maker: str
    model: str
    serial_number: str
    control: str
    customer: str
    place: str
    tolerance_um: float | None
    reference_job: str | None = Field(examples=[JOB_ID])
    created: str
    cell: str = Field(
        examples=["ready"],
        description="State of its cell; `none` where the service does not drive it.",
    )
    connected: bool
    current_job: str | None = Field(description="The job that holds it.")
    in_control: str | None = Field(
        None,
        examples=["anna"],
        description="The user who may arm and resume that job; null where nobody logs "
        "in and where no job holds the machine.",
    )
    version: int | None = Field(description="Of its configuration, the one in use.")


class MachineDetail(MachineEntry):
    """A machine with its configuration and those that it had."""

    machine_file: Annotated[dict[str, Any], AsKept(MachineFileOut)] = Field(
        description="The content of machine.json."
    )
    devices: Annotated[dict[str, Any], AsKept(DevicesOut)] = Field(
        description="Drivers and options, without passwords."
    )
    versions: list[MachineVersionOut] = Field(description="The newest first.")


class MachineList(BaseModel):
    """All machines, the first one first."""

    items: list[MachineEntry]


class TrialOut(BaseModel):
    """What the tracker has sent in a moment."""

    text: str = Field(examples=["42 samples, 0 lost, target 1.2 m away"])
    samples: int
    usable: int = Field(description="Samples that the tracker calls valid.")
    lost_samples: int
    distance_mm: float | None = Field(
        description="Mean distance of the target; null where it sees none."
    )


@router.get("")
def list_machines(service: ServiceDep) -> MachineList:
    """List the machines that the service knows, those it drives first."""
    holders = _find_holders(service)
    driven = [one.id for one in service.machines.list_all()]
    records = {record.id: record for record in service.setup.registry.list_all()}
    order = [*driven, *(i for i in records if i not in driven)]
    items = [
        MachineEntry(**_describe(records[i], service, holders))
        for i in order
        if i in records
    ]
    return MachineList(items=items)


@router.post("", status_code=201, responses=declare_problems(409, 422))
def add_machine(
    request: NewMachine, response: Response, service: ServiceDep, http: Request
) -> MachineDetail:
    """Add a machine by its machine file. Its devices are chosen next."""
    _check_reference(request.id, request.identity, service)
    texts = request.identity.model_dump(include=set(IDENTITY), exclude_none=True)
    service.setup.add(request.id, request.machine_file, texts)
    _change(request.id, request.identity, service)
    _note_change(http, None, service.setup.registry.get(request.id))
    response.headers["Location"] = address(f"/machines/{request.id}")
    return _read_detail(request.id, service)


@router.get("/{machine_id}", responses=declare_problems(404))
def get_machine_record(machine_id: MachinePath, service: ServiceDep) -> MachineDetail:
    """Return a machine with its configuration and the versions of it."""
    return _read_detail(machine_id, service)


@router.patch("/{machine_id}", responses=declare_problems(404, 422))
def change_machine(
    machine_id: MachinePath,
    request: MachineIdentity,
    service: ServiceDep,
    http: Request,
) -> MachineDetail:
    """Say who the machine is, what it may err by, and what it is held against."""
    before = service.setup.registry.get(machine_id)
    _check_reference(machine_id, request, service)
    _change(machine_id, request, service)
    _note_change(http, before, service.setup.registry.get(machine_id))
    return _read_detail(machine_id, service)


@router.delete(
    "/{machine_id}",
    status_code=204,
    responses=declare_problems(404, 409, 412, 428),
)
def remove_machine(
    machine_id: MachinePath, version: Version, service: ServiceDep, http: Request
) -> None:
    """Drive a machine no more. Its Runs, results and history stay.

    By the version of its configuration that was read. Not while a job holds it, or it
    moves. The same identifier can be added again.
    """
    before = service.setup.registry.get(machine_id)
    service.setup.remove(machine_id, version)
    _note_change(http, before, None)


@router.put(
    "/{machine_id}/machine-file", responses=declare_problems(404, 409, 412, 422)
)
def set_machine_file(
    machine_id: MachinePath,
    request: MachineDescription,
    version: VersionIfGiven,
    service: ServiceDep,
    http: Request,
) -> MachineDetail:
    """Describe a machine anew, as a new version; its cell is started anew."""
    before = service.setup.registry.get(machine_id)
    after = service.setup.set_machine_file(machine_id, request.machine_file, version)
    _note_change(http, before, after)
    service.calibrations.update_status(machine_id)
    return _read_detail(machine_id, service)


@router.put("/{machine_id}/devices", responses=declare_problems(404, 409, 412, 422))
def set_machine_devices(
    machine_id: MachinePath,
    request: MachineDevices,
    version: VersionIfGiven,
    service: ServiceDep,
    http: Request,
) -> MachineDetail:
    """Choose drivers and options; the cell is started anew. No port is opened yet."""
    before = service.setup.registry.get(machine_id)
    after = service.setup.set_devices(machine_id, request, version)
    _note_change(http, before, after)
    return _read_detail(machine_id, service)


@router.post(
    "/{machine_id}/devices:try", responses=declare_problems(404, 409, 502, 503, 504)
)
@on_threads(CONNECTING)
def try_machine_devices(machine_id: MachinePath, service: ServiceDep) -> TrialOut:
    """Connect, and listen to the tracker for a second. Moves nothing."""
    return _describe_trial(service.setup.try_devices(machine_id))


@router.post(
    "/{machine_id}:connect", responses=declare_problems(404, 409, 502, 503, 504)
)
@on_threads(CONNECTING)
def connect_one_machine(machine_id: MachinePath, service: ServiceDep) -> Connection:
    """Open the ports of a machine and return who answers. Moves nothing."""
    cell = service.machines.get(machine_id).cell
    return describe_connection(cell, cell.connect())


@router.get("/{machine_id}/conditions", responses=declare_problems(404))
def list_machine_conditions(
    machine_id: MachinePath, service: ServiceDep
) -> ConditionList:
    """Return what has to be so before the machine moves. Asks no device."""
    return list_conditions_of(service.machines.get(machine_id))


def _check_reference(
    machine_id: str, request: MachineIdentity, service: Service
) -> None:
    if request.reference_job is not None:
        service.calibrations.find_usable(machine_id, request.reference_job)


def _change(machine_id: str, request: MachineIdentity, service: Service) -> None:
    given = request.model_dump(exclude_unset=True)
    values = {k: "" if v is None and k in IDENTITY else v for k, v in given.items()}
    service.setup.registry.change(machine_id, **values)
    service.calibrations.update_status(machine_id)


def _note_change(
    request: Request, before: MachineRecord | None, after: MachineRecord | None
) -> None:
    """Passwords are omitted."""
    old, new = _list_values(before), _list_values(after)
    changed = {key for key in old | new if old.get(key) != new.get(key)}
    note_change(
        request,
        old={key: old[key] for key in sorted(changed & set(old))},
        new={key: new[key] for key in sorted(changed & set(new))},
    )


def _list_values(record: MachineRecord | None) -> dict[str, Any]:
    if record is None:
        return {}
    values = {key: getattr(record, key) for key in (*IDENTITY, *_JUDGED_BY)}
    for version in record.versions[:1]:
        devices = show_devices(version.devices)
        values["version"] = version.number
        values |= {f"machine_file.{k}": v for k, v in version.machine_file.items()}
        values |= {f"devices.{k}": v for k, v in devices.items()}
    return {
        key: value if isinstance(value, _PLAIN) else json.dumps(value, sort_keys=True)
        for key, value in values.items()
    }


def _find_holders(service: Service) -> Mapping[str | None, str]:
    unfinished = service.store.list_unfinished()
    return {job.machine: job.id for job in unfinished if job.kind.measures}


def _read_detail(machine_id: str, service: Service) -> MachineDetail:
    record = service.setup.registry.get(machine_id)
    newest = record.versions[0]
    return MachineDetail(
        **_describe(record, service, _find_holders(service)),
        machine_file=dict(newest.machine_file),
        devices=show_devices(newest.devices),
        versions=[
            MachineVersionOut(number=v.number, sha256=v.sha256, since=v.since)
            for v in record.versions
        ],
    )


def _describe(
    record: MachineRecord, service: Service, holders: Mapping[str | None, str]
) -> dict[str, Any]:
    cells = {one.id: one for one in service.machines.list_all()}
    one = cells.get(record.id)
    return {
        **{name: getattr(record, name) for name in ("id", "origin", *IDENTITY)},
        "tolerance_um": record.tolerance_um,
        "reference_job": record.reference_job,
        "created": record.created,
        "cell": "none" if one is None else one.cell.status.state,
        "connected": one is not None and one.cell.status.connected,
        "current_job": holders.get(record.id),
        "in_control": service.dispatcher.find_controller(holders.get(record.id)),
        "version": record.versions[0].number if record.versions else None,
    }


def _describe_trial(tried: TrackerTried) -> TrialOut:
    place = "no target seen"
    if tried.distance_mm is not None:
        place = f"target {tried.distance_mm / 1000.0:.1f} m away"
    return TrialOut(
        text=f"{tried.samples} samples, {tried.lost_samples} lost, {place}",
        samples=tried.samples,
        usable=tried.usable,
        lost_samples=tried.lost_samples,
        distance_mm=tried.distance_mm,
    )
