"""The installed drivers with their options, and the effects that discovery knows."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from truepath.device_options import DEVICES, DriverOption, read_options
from truepath.plugins import gather

router = APIRouter()


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


@router.get("/drivers", tags=["machines"])
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


class EffectKindOut(BaseModel):
    """An effect that is installed, in words."""

    name: str = Field(examples=["backlash"])
    of: str = Field(
        examples=["direction"],
        description="`machine`, `direction` of approach, `measurement` or `structure`.",
    )
    title: str
    cause: str
    looks_like: str
    remedy: str
    enters_analyse: bool = Field(
        description="A model keeps it for the next analysis; else it ends with its Run."
    )


class EffectKindList(BaseModel):
    """All effects, by name."""

    items: list[EffectKindOut]


@router.get("/effects", tags=["models"])
def list_effects(
    language: Annotated[Literal["en", "de"], Query(description="Of the words.")] = "en",
) -> EffectKindList:
    """List the effects that discovery looks for, those of other packages included."""
    from truepath.kinematics.effects.family import describe_family, list_families

    found = [describe_family(family, language) for family in list_families()]
    return EffectKindList(items=[EffectKindOut(**one) for one in found])
