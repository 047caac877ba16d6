"""The machine and its devices as clients see them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class DeviceIdentity(BaseModel):
    """Who answers on a port."""

    maker: str
    model: str
    serial_number: str
    firmware: str


class Connection(BaseModel):
    """The devices, once they have answered."""

    connected: bool
    tracker: DeviceIdentity | None
    motion: DeviceIdentity | None


class MachineOut(Connection):
    """The machine file, and whether its devices have answered."""

    model_config = ConfigDict(extra="allow")

    name: str = Field(examples=["mill-3"])
    kinematic_chain: str = Field(examples=["w-X-b-Y-Z-t"])
    axes: dict[str, Any]
    tracker_noise: dict[str, Any] = Field(
        description="What the machine file says of the tracker."
    )


class MachineSummary(BaseModel):
    """The machine in short."""

    name: str
    kinematic_chain: str
    axes: list[str]


def describe_connection(devices: Mapping[str, Mapping[str, str]]) -> Connection:
    """Return who answers, as clients see it."""
    known = {
        name: DeviceIdentity(**devices[name])
        for name in ("tracker", "motion")
        if name in devices
    }
    return Connection(
        connected=bool(devices),
        tracker=known.get("tracker"),
        motion=known.get("motion"),
    )
