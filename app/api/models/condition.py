"""What has to be so before a machine moves, as clients see it."""

from __future__ import annotations

from pydantic import BaseModel, Field

from truepath.app.jobs.conditions import ConditionType, Level


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
