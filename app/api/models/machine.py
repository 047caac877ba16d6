"""A machine of the catalogue as clients see it, and what they send of one."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    field_validator,
)

from truepath.app.api.models.base import (
    JOB_ID,
    AsKept,
    Identifier,
    MachineId,
    RequestBody,
)
from truepath.app.api.models.machine_file import MachineFileOut
from truepath.app.api.models.naming import Name
from truepath.app.files.machine_file import MachineFile
from truepath.app.machine_settings import (
    DeviceConfiguration,
    Options,
    check_machine_id,
)

_TRACKER: dict[str, JsonValue] = {"port": "/dev/serial/by-id/usb-tracker-if00-port0"}


class MachineIdentity(RequestBody):
    """Who a machine is, as certificates state it. What is left out stays as it is."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "maker": "Example Works",
                    "model": "VMC 400",
                    "serial_number": "4711",
                    "customer": "Example Ltd",
                    "place": "hall 3",
                    "tolerance_um": 15.0,
                }
            ]
        },
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

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"machine_file": _FILE}]}
    )

    machine_file: Annotated[dict[str, Any], AsKept(MachineFile)] = Field(
        description="The content of machine.json."
    )


class NewMachine(MachineDescription):
    """A machine to add. Its devices are chosen afterwards."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "id": "mill-3",
                    "machine_file": _FILE,
                    "identity": {"serial_number": "4711"},
                }
            ]
        },
    )

    id: MachineId
    identity: MachineIdentity = Field(default_factory=MachineIdentity)

    @field_validator("id")
    @classmethod
    def _require_free_word(cls, given: str) -> str:
        check_machine_id(given)
        return given


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


class DevicesOut(BaseModel):
    """How the devices are reached: nothing where they have not been chosen.

    Further keys are those of the settings of a machine.
    """

    model_config = ConfigDict(extra="allow")

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
