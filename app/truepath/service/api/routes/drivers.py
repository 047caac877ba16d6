"""The installed drivers, and the options that a machine may give each."""

from __future__ import annotations

import json
from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, Field

from truepath.device_options import DEVICES, DriverOption, read_options
from truepath.plugins import gather

router = APIRouter(prefix="/drivers", tags=["machines"])


class DriverOptionOut(BaseModel):
    """An option of a driver."""

    name: str = Field(examples=["port"])
    type: str = Field(examples=["str | int"], description="As Python writes types.")
    is_required: bool
    default: Any = Field(None, description="Null where it has to be given.")


class DriverOut(BaseModel):
    """A driver that is installed."""

    device: str = Field(
        examples=["tracker"],
        description="`tracker`, `motion` or `thermometer`: which settings name it, as "
        "in `tracker_driver` and `tracker_options`.",
    )
    name: str = Field(examples=["streaming"])
    options: list[DriverOptionOut]


class DriverList(BaseModel):
    """All drivers, those of trackers first."""

    items: list[DriverOut]


@router.get("")
def list_drivers() -> DriverList:
    """List the installed drivers and the options of each."""
    return DriverList(
        items=[
            DriverOut(device=device, name=name, options=options)
            for device, group in DEVICES.items()
            for name, options in gather(group, _describe).items()
        ]
    )


def _describe(name: str, factory: Any) -> list[DriverOptionOut]:
    return [
        DriverOptionOut(
            name=one.name,
            type=one.kind,
            is_required=one.is_required,
            default=_to_json(one),
        )
        for one in read_options(name, factory)
    ]


def _to_json(option: DriverOption) -> Any:
    if option.is_required:
        return None
    return json.loads(json.dumps(option.default, default=str), parse_constant=str)
