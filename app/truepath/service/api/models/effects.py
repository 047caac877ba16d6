"""Effects of a machine, as discoveries, models and results name them."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from truepath.service.api.models.tables import NumberOut


class EffectKeys(BaseModel):
    """What tells an effect from others. Families that plug in may have further keys."""

    model_config = ConfigDict(extra="allow")

    name: str = Field(
        examples=["backlash"], description="Of the catalogue of effects; it may grow."
    )
    axis: str | None = Field(None, examples=["Y"])
    motion: str | None = Field(None, examples=["EYX"])
    by: str | None = Field(None, description="Axis whose carriage bends a guide.")
    direction: str | None = None
    circle: str | None = None
    unit: str | None = Field(None, description="Of the numbers of a motion.")


class EvidenceOut(BaseModel):
    """Why it is believed, on lines that the fit did not see."""

    log_bayes_factor: float
    held_out_log_score: float
    share_of_gap: float


class EffectStatementOut(BaseModel):
    """How sure it is, how large, and what it means in words."""

    grade: Literal["certain", "likely", "possible"]
    parameters: dict[str, NumberOut] = Field(description="The unit is in the name.")
    evidence: EvidenceOut
    indistinguishable_from: list[EffectKeys]
    largest_um: float | None = Field(
        None, description="By which it moves the target in all that was measured."
    )
    is_small: bool = Field(
        default=False, description="Less than a control corrects: nothing to be done."
    )
    cause: str
    looks_like: str
    remedy: str


class EffectOut(EffectKeys, EffectStatementOut):
    """An effect that the model lacked. Further keys are those of its family."""


class UpdatedEffectOut(EffectKeys):
    """An effect of the model in use, with what this measurement makes of it.

    Further keys are those of its family.
    """

    parameters: dict[str, NumberOut]
    known_before: dict[str, NumberOut] | None = Field(
        description="Null where the model was made from the same Run."
    )
    agrees: bool | None = Field(
        None, description="Of this Run with what was known; null where it cannot tell."
    )
