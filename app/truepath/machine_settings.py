"""The settings of one machine: its file, and the access to its devices."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from truepath_drivers.interfaces.tracker_records import Light

ONLY_MACHINE = "default"
"""Identifier of the machine whose settings are outside of any table."""
MACHINE_ID = r"^[a-z0-9][a-z0-9-]{0,31}$"
RESERVED_IDS = frozenset({"current", "compare"})
_PATIENCE = ("silent", "dead", "beam", "late", "point", "search")
_LONGEST_S = 3600.0

Options = dict[str, Annotated[Any, Field(description="The driver's own option.")]]
"""What a driver needs, by the names that it gives its options."""


class DeviceConfiguration(BaseModel):
    """How the devices of a machine are reached."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    tracker_driver: str = "streaming"
    """Driver of the tracker; `truepath drivers` lists all."""
    tracker_options: Options = Field(default_factory=dict)
    """What the driver needs: `port = "/dev/serial/by-id/…"`, or `host` and `port`."""
    tracker_patience_s: dict[str, float] = Field(default_factory=dict)
    """What is not usual for this tracker, in seconds: `silent` (0.5), `dead` (5),
    `beam` (0.25), `late` (0.25), `point` (20, beyond the dwell), `search` (10; 0: a
    lost target is not searched for)."""
    motion_driver: str = "modbus"
    """Driver of the CNC; `truepath drivers` lists all."""
    motion_options: Options = Field(default_factory=dict)
    """What the driver needs: `host`, `port` and `unit`, or `serial_port`."""
    tracker_light: dict[str, float] = Field(default_factory=dict)
    """Of a tracker that does not correct its distances for the air: `wavelength_nm`,
    `is_group` (1 of modulated light), `assumed_index`. Empty: nothing is corrected."""
    thermometer_driver: str = ""
    """Empty: no thermometers but those that the tracker has."""
    thermometer_options: Options = Field(default_factory=dict)
    """What the driver needs: its list of registers."""
    allow_no_watchdog: bool = False
    """Move a machine that does not hold the feed by itself when the service dies, if
    its driver says that it stops where it is not asked."""

    @field_validator("tracker_patience_s")
    @classmethod
    def _require_patience(cls, given: dict[str, float]) -> dict[str, float]:
        for name, value in given.items():
            if name not in _PATIENCE:
                raise ValueError(f"{name} is none of {', '.join(_PATIENCE)}")
            is_off = name == "search" and value == 0.0
            if not (is_off or 0.0 < value < _LONGEST_S):
                raise ValueError(f"{name} is {value:g} s, not in 0 to {_LONGEST_S:g} s")
        return given

    @model_validator(mode="after")
    def _require_light(self) -> Self:
        self.light  # noqa: B018, refuses what is no light
        return self

    @property
    def light(self) -> Light | None:
        """Light of `tracker_light`, None if empty. Raises ValueError."""
        stated = dict(self.tracker_light)
        if not stated:
            return None
        is_group = bool(stated.pop("is_group", True))
        try:
            return Light(**stated, is_group=is_group)
        except (TypeError, ValueError) as error:
            raise ValueError(f"tracker_light: {error}") from error


class MachineSettings(DeviceConfiguration):
    """One machine of several: its file and its devices."""

    model_config = ConfigDict(extra="forbid", frozen=True, str_max_length=4096)

    machine_file: Path


def check_machine_id(machine_id: str) -> str:
    """The identifier, unchanged; raises ValueError for an invalid or reserved one."""
    if machine_id in RESERVED_IDS or not re.match(MACHINE_ID, machine_id):
        raise ValueError(
            f"{machine_id!r} cannot name a machine; use up to 32 of a-z, 0-9 and -, "
            f"and none of {', '.join(sorted(RESERVED_IDS))}"
        )
    return machine_id
