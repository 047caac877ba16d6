"""Request of a plan, and the plan as a resource."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from truepath.catalogue.transitions import State
from truepath.service.api.models.base import (
    JOB_ID,
    AsKept,
    Feed,
    Identifier,
    Links,
    MachineId,
    Problem,
    RequestBody,
    TargetUm,
)
from truepath.service.api.models.jobs.plan_document import PlanDocumentOut
from truepath.service.api.models.jobs.plan_rows import PlanOut, WorkspaceIn

MOST_MINUTES = 60.0
MOST_STATIONS = 3
_EXAMPLE = {
    "mode": "otf",
    "minutes": 3,
    "workspace": {
        "keep_out": [
            {"name": "probe", "min_mm": [0, 0, 0], "max_mm": [60, 40, 30]},
        ],
        "tracker": {"position_mm": [1200, -300, 200]},
    },
}


class PlanRequest(RequestBody):
    """What a plan is to reach, and within what."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [_EXAMPLE, {"mode": "standstill"}]},
    )

    machine: MachineId | None = Field(
        None, description="The machine to plan for; left out where there is only one."
    )
    mode: Literal["otf", "standstill"] = Field("otf", description="Lines, or points.")
    minutes: float | None = Field(
        None,
        ge=0.1,
        le=MOST_MINUTES,
        allow_inf_nan=False,
        description="At most, dwells included; 3 on the fly and 4 at standstill "
        "without a target.",
    )
    target_um: TargetUm | None = Field(
        None,
        description="`volumetric_uncertainty_um` to reach, a standard uncertainty "
        "(k = 1): the shortest plan found that reaches it.",
    )
    feeds_mm_min: list[Feed] | None = Field(
        None,
        min_length=1,
        max_length=5,
        description="Several, driven in turn, tell dynamic effects from static ones.",
    )
    max_feed_mm_min: Feed | None = Field(
        None, description="Up to which each line's feed is chosen, where none is given."
    )
    dwell_s: float | None = Field(None, ge=0.05, le=60, allow_inf_nan=False)
    perpendicular_only: bool = False
    corner_path: bool = Field(
        False, description="The path of the 2023 paper instead, to compare with."
    )
    workspace: WorkspaceIn | None = None
    stations: int | None = Field(
        None,
        ge=1,
        le=MOST_STATIONS,
        description="Places of the tracker, chosen in the areas of the workspace, "
        "which share the minutes; one without it.",
    )
    seed: int = Field(0, ge=0, le=2**31 - 1)
    model_id: Identifier | None = Field(
        None,
        description="Job whose model, or result, has effects of the machine that the "
        "plan has to separate as well.",
    )

    @model_validator(mode="after")
    def _leaves_a_corner_path_alone(self) -> Self:
        limited = self.minutes is not None or self.target_um is not None
        if self.corner_path and (limited or self.mode != "otf"):
            raise ValueError(
                "corner_path is of mode otf and as long as it is; leave minutes and "
                "target_um out"
            )
        return self

    def order(self) -> dict[str, Any]:
        """The request as stored: without None, `model_id` and `machine`."""
        return self.model_dump(exclude_none=True, exclude={"model_id", "machine"})


class GradeAt(BaseModel):
    """The expected uncertainty of the map over the scatter of one sample."""

    number: float = Field(examples=[0.24])
    verdict: str = Field(examples=["good"], description="good, usable or poor")


class WeakAt(BaseModel):
    """An error motion that is known least."""

    error: str = Field(examples=["ECX"])
    at_tool_um: float = Field(description="Standard uncertainty it puts at the tool.")


class CurvePoint(BaseModel):
    """What is left once the plan has been driven to a row."""

    row: int = Field(examples=[19], description="Rows driven.")
    time_s: float = Field(examples=[43.2], description="Dwells and moves included.")
    volumetric_uncertainty_um: float = Field(description="k = 1.")
    expanded_volumetric_uncertainty_um: float = Field(description="k = 2.")
    grade: GradeAt | None = Field(None, description="Null in plans of older versions.")
    weakest: list[WeakAt] = Field([], description="The weakest first.")


class PlanCurve(BaseModel):
    """Uncertainty against time: how far any beginning of a plan comes.

    A plan that is made for a shorter time leaves about as much, or less.
    """

    plan_id: str = Field(examples=[JOB_ID])
    points: list[CurvePoint]
    tracker_mm: list[float] = Field(
        description="Where the tracker stands, in the frame that it stands on."
    )
    tracker_is_assumed: bool
    unobservable: list[str] = Field(description="What the plan cannot tell, in words.")


class PlanLinks(Links):
    """Where else to look."""

    self: Annotated[str, "/plans/{id}"]
    job: Annotated[str, "/jobs/{id}"]
    events: Annotated[str, "/jobs/{id}/events"]
    nc_program: Annotated[str, "/plans/{id}/nc-program"]
    curve: Annotated[str, "/plans/{id}/curve"]


class PlanResource(BaseModel):
    """A plan. It is made by a job of its own identifier, of kind `plan`."""

    id: str = Field(examples=[JOB_ID])
    state: State = Field(
        examples=["succeeded"], description="Of its job; `succeeded` once it is there."
    )
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    progress: float = Field(description="From 0 to 1.")
    request: Annotated[dict[str, Any], AsKept(PlanRequest)] = Field(
        description="What was asked."
    )
    commanded: PlanOut | None = Field(description="The rows; null until they are.")
    document: Annotated[dict[str, Any], AsKept(PlanDocumentOut)] | None = Field(
        description="The content of `plan.json`: predicted uncertainty of each error "
        "and of the volume, what stays unobservable, the curve of uncertainty against "
        "time; and the `grade` of the set-up."
    )
    error: Problem | None = Field(description="Why there is none.")
    links: PlanLinks
