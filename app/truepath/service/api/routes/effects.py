"""The effects that discovery looks for."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

router = APIRouter(prefix="/effects", tags=["models"])


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


@router.get("")
def list_effects(
    language: Annotated[Literal["en", "de"], Query(description="Of the words.")] = "en",
) -> EffectKindList:
    """List the effects that discovery looks for, those of other packages included."""
    from truepath.kinematics.effects.family import describe_family, list_families

    found = [describe_family(family, language) for family in list_families()]
    return EffectKindList(items=[EffectKindOut(**one) for one in found])
