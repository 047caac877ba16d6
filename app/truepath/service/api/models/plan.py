"""Rows of a plan: as requested, as commanded, and as checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, Field, create_model, model_validator

from truepath.errors import BundleError
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.service.api.models.base import (
    AsKept,
    Deg,
    Dwell,
    Feed,
    Identifier,
    MachineId,
    Mm,
    RequestBody,
    TargetUm,
    examples,
)
from truepath.service.api.models.plan_document import PlaceOut

_MOST_BOXES = 100
_Place = Annotated[list[Mm], Field(min_length=3, max_length=3)]
_Range = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class Area(RequestBody):
    """A box that may be flat."""

    name: str | None = Field(None, min_length=1)
    min_mm: _Place
    max_mm: _Place


class Box(Area):
    """A closed box."""


_KEYS: dict[str, Any] = {
    one.name: (_Range, 0.0) for one in fields(TrackerSpecification)
}
_Keys = create_model("_Keys", __base__=RequestBody, **_KEYS)


class Specification(_Keys):
    """What the tracker may be off by: standard uncertainties, 0 if left out."""


class TrackerSite(RequestBody):
    """Where the tracker stands, in the frame that it stands on, or may stand."""

    position_mm: _Place | None = Field(
        None, description="If left out, a plan chooses it in `areas`."
    )
    nearest_mm: _Range | None = Field(
        None, description="Where left out 0, or 200 mm for a place that is chosen."
    )
    farthest_mm: _Range | None = None
    areas: list[Area] = Field([], max_length=_MOST_BOXES)
    keep_out: list[Area] = Field(
        [], max_length=_MOST_BOXES, description="In which it must not stand."
    )
    move_minutes: _Range = Field(10.0, description="That another station costs.")
    specification: Specification | None = None


class Reflector(RequestBody):
    """Where the reflector looks, in the frame of the tool."""

    direction: _Place
    half_angle_deg: float = Field(gt=0, le=90, allow_inf_nan=False)


class SightBox(Box):
    """A box that the beam must not touch."""

    carried_by: Literal["X", "Y", "Z", "base"] | None = Field(
        None, description="Axis whose carriage it moves with."
    )


class WorkspaceIn(RequestBody):
    """What limits a plan beside the travel, as in a workspace file."""

    keep_out: list[Box] = Field(
        [], max_length=_MOST_BOXES, description="In axis positions X, Y, Z."
    )
    tracker: TrackerSite | None = None
    reflector: Reflector | None = None
    blocks_sight: list[SightBox] = Field(
        [], max_length=_MOST_BOXES, description="In the frame that the tracker is in."
    )

    @model_validator(mode="after")
    def _is_a_workspace(self) -> Self:
        _require_workspace(self.model_dump(exclude_none=True))
        return self


def _require_boxes(boxes: list[Box]) -> list[Box]:
    _require_workspace(
        {"keep_out": [box.model_dump(exclude_none=True) for box in boxes]}
    )
    return boxes


def _require_workspace(content: dict[str, Any]) -> None:
    try:
        workspace_from_json(content, file="workspace")
    except BundleError as error:
        raise ValueError(str(error)) from error


KeepOut = Annotated[
    list[Box], Field(max_length=_MOST_BOXES), AfterValidator(_require_boxes)
]


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


class StationResumptionOut(BaseModel):
    """How a station goes on whose Run was cut short; its known points come first."""

    first_row: int = Field(description="Of its rows, where the further Run begins.")
    kept_run_ids: list[str] = Field(description="Runs before it that are analysed.")
    points_id: str = Field(description="Run of its known points before.")
    place_mm: list[list[float]] = Field(
        description="Where the target has to be at the last known points, in the "
        "tracker's frame."
    )


class StationRows(BaseModel):
    """What is commanded from one of several stations."""

    position_mm: list[float] = Field(description="Where the tracker is to stand.")
    duration_s: float
    position: list[list[float]]
    feed_mm_min: list[float]
    dwell_s: list[float]
    target: list[str]
    run_id: str | None = Field(
        None, description="Of its Run, the newest one, once that has begun."
    )
    resumption: StationResumptionOut | None = Field(
        None, description="Of a station whose Run was cut short and that goes on."
    )


class ResumptionOut(BaseModel):
    """How a measurement goes on that was cut short."""

    first_row: int = Field(description="Of the plan, where the further Run begins.")
    kept_run_ids: list[str] = Field(description="Runs before it that are analysed.")
    closure_row: list[int] = Field(
        description="Rows to stand at first; at the last ones the target has to be "
        "where it was."
    )
    place_mm: list[list[float]] = Field(
        description="Where it was there, in the tracker's frame."
    )


class PlanOut(BaseModel):
    """What is or was commanded, a row of `position` for each waypoint or point."""

    kind: Literal["path", "points"] = Field(examples=["path"])
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
    arc: list[tuple[str, float, float, float] | None] = Field(
        [],
        description="Of a path with arcs, a row each: plane, centre in both its axes "
        "in mm, turn in deg; null on a straight line. Else empty.",
    )
    target_um: float | None = Field(
        None,
        description="`volumetric_uncertainty_um` (k = 1) at which it may end early.",
    )
    resumption: ResumptionOut | None = Field(
        None, description="Of a measurement that goes on; null where it begins."
    )
    predicted_um: float | None = Field(
        None,
        description="Where it was planned: the predicted volumetric uncertainty "
        "(k = 1).",
    )
    stations: list[StationRows] | None = Field(
        None,
        description="Of a plan of several stations: the rows from each; those above "
        "are the first's.",
    )
    place: Annotated[dict[str, Any], AsKept(PlaceOut)] | None = Field(
        None,
        description="Where the plan has chosen the tracker's place: `tracker`, "
        "`stations` and `at_stations` of its `document`.",
    )
    tracker_mm: list[float] | None = Field(
        None,
        description="Where it was planned: the tracker's place, in the frame that it "
        "stands on; of several stations the first's.",
    )
    discovery_id: str | None = Field(
        None, description="Of extra lines: the job whose discovery asks for them."
    )
    keep_out: Annotated[list[Any], AsKept(Box, many=True)] | None = Field(
        None,
        description="Boxes of axis positions X, Y, Z that no motion of the job "
        "touches; [] where none are stated, null where that is not known, as of an "
        "uploaded Run.",
    )

    @classmethod
    def of(cls, plan: Mapping[str, Any], target_um: float | None) -> Self:
        """From a plan in the form of the store, or from a Run."""
        return cls(**{**plan, "target_um": target_um, "keep_out": _list_keep_out(plan)})


def _list_keep_out(plan: Mapping[str, Any]) -> list[Any] | None:
    if "request" not in plan:
        return None
    workspace = plan["request"].get("workspace") or {}
    return list(workspace.get("keep_out") or ())


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

    model_config = examples(_EXAMPLE, {"mode": "standstill"})

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
