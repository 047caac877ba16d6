"""Where to go: rows sent in, and the plan of a job."""

from __future__ import annotations

from pydantic import BaseModel, Field

from app.api.models.base import Deg, Dwell, Feed, Mm, RequestBody


class Point(RequestBody):
    """Axis positions to stand at: a row of `points.csv`."""

    x_mm: Mm | None = None
    y_mm: Mm | None = None
    z_mm: Mm | None = None
    a_deg: Deg | None = None
    b_deg: Deg | None = None
    c_deg: Deg | None = None
    dwell_s: Dwell | None = None
    target: str | None = None


class Waypoint(Point):
    """Axis positions to drive to in a straight line: a row of `path.csv`."""

    feed_mm_min: Feed | None = None


class PlanOut(BaseModel):
    """What is or was commanded, a row of `position` for each waypoint or point."""

    kind: str = Field(examples=["path"])
    axes: list[str] = Field(examples=[["X", "Y", "Z"]])
    position: list[list[float]] = Field(
        examples=[[[0.0, 0.0, 0.0], [400.0, 300.0, 200.0]]],
        description="mm for linear axes, deg for rotary axes.",
    )
    feed_mm_min: list[float] = Field(
        examples=[[2500.0, 2500.0]],
        description="Feed towards each row; empty for points.",
    )
    dwell_s: list[float]
    target: list[str]
    target_um: float | None = Field(
        None,
        description="`volumetric_uncertainty_um` (k = 1) at which it may end early.",
    )
    predicted_um: float | None = Field(
        None,
        description="Where it was planned: the predicted volumetric uncertainty "
        "(k = 1).",
    )
    discovery_id: str | None = Field(
        None, description="Of extra lines: the job whose discovery asks for them."
    )
