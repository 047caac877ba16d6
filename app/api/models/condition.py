"""What has to be so before a machine moves, as clients see it."""

from __future__ import annotations

from pydantic import BaseModel, Field

from truepath.app.jobs.conditions import ConditionType, Level


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


class ConditionList(BaseModel):
    """All conditions of a machine."""

    items: list[ConditionOut]
