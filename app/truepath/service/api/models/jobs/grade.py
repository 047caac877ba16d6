"""The grade of a set-up before anything moves."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.tables import Vector3


class Thresholds(BaseModel):
    """Numbers up to which a set-up is good, and usable."""

    good: float = Field(examples=[0.25])
    usable: float = Field(examples=[1.0])


class TrackerPlace(BaseModel):
    """Where the tracker stands for this grade."""

    position_mm: Vector3
    assumed: bool = Field(description="Nobody has said so: the worst of usual places.")
    best_number: float = Field(description="At the best of the places.")


class WeakMotionOut(BaseModel):
    """One of the weakest error motions."""

    error: str = Field(examples=["EBZ"])
    meaning: str = Field(examples=["turn of Z about Y"])
    at_tool_um: float = Field(description="Standard uncertainty it puts at the tool.")
    remedy: str | None


class GradeOut(BaseModel):
    """The grade of a set-up from geometry alone; uncertainties are standard ones."""

    number: float = Field(
        examples=[0.11],
        description="Expected uncertainty of the map over the scatter of one sample.",
    )
    verdict: Literal["good", "usable", "poor"] = Field(examples=["good"])
    thresholds: Thresholds
    text: str
    expected_uncertainty_um: float
    sample_sigma_um: float
    tracker: TrackerPlace
    improved_number: float | None = Field(
        description="With the line that the weakest motion asks for."
    )
    weakest: list[WeakMotionOut]
    weak_shapes: list[str]
    unobservable: list[str]
