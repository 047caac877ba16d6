"""The machine and its devices; the service itself."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal

from fastapi import APIRouter
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from truepath.catalogue.errors import NoMachine
from truepath.catalogue.job import format_utc_now
from truepath.errors import NotFound
from truepath.files.bundle.machine_file import machine_to_json
from truepath.machines.cell_status import CellStatus, Devices
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.conditions import ConditionType, Level
from truepath.machines.machine_cells import MachineCell
from truepath.service.api.models.machine_files import (
    MachineCoreOut,
    MotionLimitsOut,
    TrackerNoiseOut,
)
from truepath.service.api.problems import declare_problems
from truepath.service.api.service import (
    CONNECTING,
    LEAST_FREE_BYTES,
    Service,
    ServiceDep,
    on_threads,
)
from truepath_drivers.interfaces.thermometers import ReadingTry

_NO_MACHINE = "no machine is set up; give the service a machine_file"

machines = APIRouter(prefix="/machines", tags=["machines"])
system = APIRouter(prefix="/system", tags=["system"])
probes = APIRouter(tags=["system"])


class TemperatureOut(BaseModel):
    """What one thermometer shows."""

    channel: str = Field(examples=["X_degC"])
    value_degC: float  # noqa: N815
    change_degC: float = Field(  # noqa: N815
        description="Highest less lowest reading in the last `over_s`."
    )
    over_s: float = Field(description="600 s at most; less since the first reading.")


class ConditionOut(BaseModel):
    """Something that has to be so before the machine moves, as it is now."""

    type: ConditionType
    level: Level = Field(description="`unknown` where no device tells it.")
    reason: str = Field(examples=["estop"], description="For programs; may be empty.")
    message: str = Field(
        examples=["a door is open; close it"],
        description="What is wrong and what to do; empty where nothing is.",
    )
    is_required: bool = Field(
        description="While this is `false`, no job is armed on this machine."
    )
    since: str = Field(description="When the level became what it is, UTC.")
    temperatures: list[TemperatureOut] = Field(
        default_factory=list["TemperatureOut"],
        description="Of `temperature-steady`: what the thermometers show.",
    )


class ConditionList(BaseModel):
    """All conditions of a machine."""

    items: list[ConditionOut]


class DeviceIdentity(BaseModel):
    """Who answers on a port."""

    maker: str
    model: str
    serial_number: str
    firmware: str
    has_watchdog: bool = Field(
        description="A controller that holds the feed when the service dies."
    )
    drives_arcs: bool = Field(
        False, description="A controller whose paths may have arcs."
    )


class Connection(BaseModel):
    """The devices, once they have answered."""

    connected: bool
    tracker: DeviceIdentity | None
    motion: DeviceIdentity | None
    thermometers: DeviceIdentity | None = None
    sensors: tuple[ReadingTry, ...] = Field(
        (), description="By both orders of words and addresses beside, at connect."
    )
    sensors_refused: str = Field("", description="Why no sensor is read.")


class MachineOut(MachineCoreOut, Connection):
    """The machine file, and whether its devices have answered."""

    schema_: Literal["machine/1"] = Field(alias="schema")
    motion_limits: MotionLimitsOut | None = Field(
        None, description="`motion` of the machine file: what the machine can."
    )
    tracker_noise: TrackerNoiseOut = Field(description="`tracker` of the machine file.")


class MachineSummary(BaseModel):
    """The machine in short."""

    name: str
    kinematic_chain: str
    axes: list[str]


class CellOut(BaseModel):
    """The cell process, which holds the devices."""

    state: str = Field(
        examples=["ready"], description="none, starting, down, disconnected, ready, …"
    )
    text: str
    connected: bool
    restarts: int


class SystemOut(BaseModel):
    """The service."""

    version: str
    simulated: bool
    machine: MachineSummary | None
    cell: CellOut
    current_job: str | None = Field(description="The job that holds the machine.")
    time: str


class Alive(BaseModel):
    """The process answers."""

    status: str = "ok"


class Ready(BaseModel):
    """What the service needs is there."""

    status: str = Field(examples=["ready"])
    checks: dict[str, bool]


@machines.get("/current", responses=declare_problems(404))
def get_machine(service: ServiceDep) -> MachineOut:
    """Return the machine file, and who answers on the ports."""
    one = _require_first(service)
    content = machine_to_json(one.machine)
    # Here `tracker` and `motion` are who answers.
    content["tracker_noise"] = content.pop("tracker")
    content["motion_limits"] = content.pop("motion", None)
    connection = describe_connection(one.cell, one.cell.status.devices)
    return MachineOut(**content, **connection.model_dump())


@machines.post("/current:connect", responses=declare_problems(409, 502, 503, 504))
@on_threads(CONNECTING)
def connect_machine(service: ServiceDep) -> Connection:
    """Open the ports and return who answers. Moves nothing; again is harmless."""
    if service.machines.first is None:
        raise NoMachine
    cell = service.machines.first.cell
    return describe_connection(cell, cell.connect())


@machines.get("/current/conditions", responses=declare_problems(404))
def list_conditions(service: ServiceDep) -> ConditionList:
    """Return what has to be so before the machine moves. Asks no device, so is quick.

    The controller is read once a second while nothing is measured.
    """
    return list_conditions_of(_require_first(service))


@system.get("")
def get_system(service: ServiceDep) -> SystemOut:
    """Return what the service is and what holds the machine."""
    status, first = _read_status(service), service.machines.first
    unfinished = [
        job
        for job in service.store.list_unfinished()
        if job.kind.measures and first is not None and job.machine == first.id
    ]
    return SystemOut(
        version=service.version,
        simulated=service.simulated,
        machine=_summarise_machine(service.machines.first),
        cell=CellOut(**asdict(status), connected=status.connected),
        current_job=next((job.id for job in unfinished), None),
        time=format_utc_now(),
    )


@probes.get("/healthz")
def get_health() -> Alive:
    """Say that the process answers."""
    return Alive()


@probes.get("/readyz", responses=declare_problems(503))
def get_readiness(service: ServiceDep) -> Ready:
    """Say whether catalogue and disk are there, and whether a cell process runs."""
    needed = {
        "catalogue": service.database.ready(),
        "disk": service.free_bytes() > LEAST_FREE_BYTES,
    }
    running = _read_status(service).state not in ("none", "starting", "down")
    missing = ", ".join(name for name, good in needed.items() if not good)
    if missing:
        raise HTTPException(503, f"not ready: {missing}")
    return Ready(status="ready", checks={**needed, "cell": running})


def _require_first(service: Service) -> MachineCell:
    if service.machines.first is None:
        raise NotFound(_NO_MACHINE)
    return service.machines.first


def _summarise_machine(one: MachineCell | None) -> MachineSummary | None:
    if one is None:
        return None
    name, axes = one.machine.name, list(one.machine.axis_names)
    return MachineSummary(name=name, kinematic_chain=one.machine.chain, axes=axes)


def _read_status(service: Service) -> CellStatus:
    first = service.machines.first
    return CellStatus("none") if first is None else first.cell.status


def list_conditions_of(one: MachineCell) -> ConditionList:
    """Present state of all conditions of a machine."""
    found = [] if one.conditions is None else one.conditions.read()
    return ConditionList(items=[ConditionOut(**asdict(each)) for each in found])


def describe_connection(cell: CellSupervisor, devices: Devices) -> Connection:
    """Identities of the devices, and readings of the sensors at connect."""
    none = dict.fromkeys(("tracker", "motion"))
    tried = {"sensors": cell.sensors.tries, "sensors_refused": cell.sensors.refused}
    known = {**none, **devices, **tried, "connected": bool(devices)}
    return Connection.model_validate(known)
