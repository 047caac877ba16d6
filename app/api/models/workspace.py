"""What limits a plan, as in a workspace file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from truepath.app.api.models.base import Mm, RequestBody
from truepath.app.errors import BundleError
from truepath.app.files.workspace_file import workspace_from_json

_MOST_BOXES = 100
_Place = Annotated[list[Mm], Field(min_length=3, max_length=3)]
_Range = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class Box(RequestBody):
    """A closed box."""

    name: str | None = Field(None, min_length=1)
    min_mm: _Place
    max_mm: _Place


class Area(RequestBody):
    """A box that may be flat."""

    name: str | None = Field(None, min_length=1)
    min_mm: _Place
    max_mm: _Place


class Specification(RequestBody):
    """What the tracker may be off by: standard uncertainties, usual if left out."""

    eccentricity_urad: _Range = 1.0
    index_urad: _Range = 1.0
    range_offset_um: _Range = 1.0
    bending_urad_per_m: _Range = 0.3


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
