"""`workspace.json` (schema `workspace/1`): limits of a plan in addition to the travel.

    {"schema": "workspace/1",
     "keep_out": [{"name": "probe", "min_mm": [x, y, z], "max_mm": [x, y, z]}],
     "tracker": {"position_mm": [x, y, z], "nearest_mm": 200, "farthest_mm": 5000,
                 "areas": [{"min_mm": [x, y, z], "max_mm": [x, y, z]}],
                 "keep_out": [{"min_mm": [x, y, z], "max_mm": [x, y, z]}],
                 "move_minutes": 10, "specification": {"eccentricity_urad": 1}},
     "reflector": {"direction": [0, -1, 0], "half_angle_deg": 30},
     "blocks_sight": [{"min_mm": [x, y, z], "max_mm": [x, y, z], "carried_by": "Z"}]}

All keys but the schema may be left out. Boxes of `keep_out` are axis positions; the
tracker with its areas and `blocks_sight` are in the frame that the tracker stands on. A
box with `carried_by` moves with that axis' carriage, or with the base; it is stated at
the axis zeros. The reflector faces a direction of the tool. A tracker that has areas
needs no position: the plan chooses one.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, Strict, model_validator

from truepath.documents.file_model import (
    FileModel,
    Text,
    Vector,
    parse_json,
    reject,
    validate,
)
from truepath.documents.whole_files import read_whole
from truepath.files.bundle.machine_file import SpecificationFile
from truepath.motion.workspace import Box, Reflector, StationAreas, Workspace

_NEAREST_MM = 200.0  # of a place that is chosen, where nothing is stated
Size = Annotated[float, Field(ge=0.0)]


class _Area(FileModel):
    """A box that may be flat: a floor, a rail, a nest."""

    min_mm: Vector
    max_mm: Vector
    name: Text | None = None

    @model_validator(mode="after")
    def _require_order(self) -> _Area:
        if any(h < low for h, low in zip(self.max_mm, self.min_mm, strict=True)):
            raise reject("lies below min_mm", "exchange the two", "max_mm")
        return self

    def box(self) -> Box:
        return Box(self.min_mm, self.max_mm, self.name or "")


class _Box(_Area):
    """Of positive size; `carried_by` : the axis that moves it, or the base."""

    carried_by: Literal["X", "Y", "Z", "base"] | None = None

    @model_validator(mode="after")
    def _require_order(self) -> _Box:
        if any(h <= low for h, low in zip(self.max_mm, self.min_mm, strict=True)):
            low, high = (
                "[" + ", ".join(f"{v:g}" for v in place) + "]"
                for place in (self.min_mm, self.max_mm)
            )
            raise reject(f"is {high}", f"each must exceed min_mm, {low}", "max_mm")
        return self

    def box(self) -> Box:
        return Box(self.min_mm, self.max_mm, self.name or "", self.carried_by or "")


class _Reflector(FileModel):
    direction: Vector
    half_angle_deg: Annotated[float, Field(gt=0.0, le=90.0)]

    @model_validator(mode="after")
    def _require_direction(self) -> _Reflector:
        if not any(self.direction):
            raise reject("has no length", "write where it looks", "direction")
        return self


class _TrackerPlace(FileModel):
    position_mm: Vector | None = None
    nearest_mm: Size | None = None
    farthest_mm: float | None = None
    areas: Annotated[tuple[_Area, ...], Strict(False)] = ()
    keep_out: Annotated[tuple[_Area, ...], Strict(False)] = ()
    move_minutes: Size = 10.0
    specification: SpecificationFile | None = None

    @property
    def nearest(self) -> float:
        usual_mm = 0.0 if self.position_mm else _NEAREST_MM
        return usual_mm if self.nearest_mm is None else self.nearest_mm

    def stations(self) -> StationAreas | None:
        if not self.areas:
            return None
        return StationAreas(
            tuple(file.box() for file in self.areas),
            tuple(file.box() for file in self.keep_out),
            60.0 * self.move_minutes,
            self.specification and self.specification.specification(),
        )

    @model_validator(mode="after")
    def _require_place(self) -> _TrackerPlace:
        if self.position_mm is None and not self.areas:
            raise reject(
                "is missing", "state it, or areas to choose from", "position_mm"
            )
        return self

    @model_validator(mode="after")
    def _require_range(self) -> _TrackerPlace:
        farthest = self.farthest_mm
        if farthest is not None and farthest <= self.nearest:
            remedy = f"it must be above {self.nearest:g}"
            raise reject(f"is {farthest:g}", remedy, "farthest_mm")
        return self


class _Workspace(FileModel):
    schema_: Literal["workspace/1"] = Field("workspace/1", alias="schema")
    keep_out: Annotated[tuple[_Box, ...], Strict(False)] = ()
    tracker: _TrackerPlace | None = None
    reflector: _Reflector | None = None
    blocks_sight: Annotated[tuple[_Box, ...], Strict(False)] = ()

    @model_validator(mode="after")
    def _require_tracker_of_sight(self) -> _Workspace:
        if self.blocks_sight and self.tracker is None:
            problem = "needs to know where the tracker stands"
            raise reject(problem, "state tracker.position_mm", "blocks_sight")
        return self

    def workspace(self) -> Workspace:
        keep_out = tuple(file.box() for file in self.keep_out)
        tracker = self.tracker
        if tracker is None:
            return Workspace(keep_out)
        return Workspace(
            keep_out,
            tracker.position_mm,
            tracker.nearest,
            math.inf if tracker.farthest_mm is None else tracker.farthest_mm,
            tuple(file.box() for file in self.blocks_sight),
            self.reflector
            and Reflector(self.reflector.direction, self.reflector.half_angle_deg),
            tracker.stations(),
        )


def read_workspace(path: str | Path) -> Workspace:
    """Raises BundleError."""
    name = Path(path).name
    return workspace_from_json(parse_json(read_whole(path), name), file=name)


def workspace_from_json(content: object, *, file: str = "workspace.json") -> Workspace:
    """From parsed JSON. Raises BundleError."""
    return validate(_Workspace, content, file).workspace()
