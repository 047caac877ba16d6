"""The estimate of a measurement under way; uncertainties are standard ones (k = 1)."""

from __future__ import annotations

from pydantic import BaseModel, Field

from truepath.app.api.models.base import JOB_ID
from truepath.app.api.models.tables import (
    AxisLocationOut,
    LiveTableOut,
    SquarenessOut,
    Vector3,
    VerdictOut,
)


class CourseOut(BaseModel):
    """How the uncertainty came down: columns, one row an estimate, oldest first."""

    elapsed_s: list[float]
    done: list[int]
    volumetric_uncertainty_um: list[float]


class CommandedPlacesOut(BaseModel):
    """Where the rows of the path about the newest line should be seen.

    As the standstills so far place the machine before the tracker: what lies beside
    the line between two of them is an error of the machine, of the tracker, or noise.
    """

    first_row: int
    tracker_mm: list[Vector3] = Field(description="One place a row.")


class EstimateOut(BaseModel):
    """The newest live estimate."""

    job_id: str = Field(examples=[JOB_ID])
    verdict: VerdictOut
    volumetric_uncertainty_um: float = Field(
        description="Root mean square, over the axis travel, of the standard "
        "uncertainty of the volumetric error."
    )
    done: int = Field(description="Finished lines or points behind it.")
    total: int = Field(description="Lines or points of the plan.")
    cells: int
    device_time_s: float = Field(description="The tracker's clock.")
    elapsed_s: float = Field(description="Since the stream began.")
    is_last: bool
    age_s: float
    dropped_blocks: int = Field(description="Of the stream, for want of time.")
    error_tables: dict[str, LiveTableOut]
    squareness_urad: dict[str, SquarenessOut]
    axis_location: dict[str, AxisLocationOut] | None = Field(
        None, description="Of machines with rotary axes."
    )
    commanded: CommandedPlacesOut | None = Field(
        None,
        description="Of straight lines to one target, once the tracker's pose is "
        "known.",
    )
    course: CourseOut
