"""`workspace.json` (schema `workspace/1`): what limits a plan beside the travel.

    {"schema": "workspace/1",
     "keep_out": [{"name": "probe", "min_mm": [x, y, z], "max_mm": [x, y, z]}],
     "tracker": {"position_mm": [x, y, z], "nearest_mm": 200, "farthest_mm": 5000},
     "blocks_sight": [{"min_mm": [x, y, z], "max_mm": [x, y, z]}]}

All keys but the schema may be left out. Boxes of `keep_out` are axis positions; the
tracker and `blocks_sight` are in the frame that the tracker stands on.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, Strict, model_validator

from app.files.file_model import (
    FileModel,
    Text,
    Vector,
    parse_json,
    refuse,
    validate,
)
from app.files.whole_files import read_whole
from app.motion.workspace import Box, Workspace


class BoxFile(FileModel):
    """A box."""

    min_mm: Vector
    max_mm: Vector
    name: Text | None = None

    @model_validator(mode="after")
    def _require_order(self) -> BoxFile:
        if any(h <= low for h, low in zip(self.max_mm, self.min_mm, strict=True)):
            low, high = (
                "[" + ", ".join(f"{v:g}" for v in place) + "]"
                for place in (self.min_mm, self.max_mm)
            )
            raise refuse(f"is {high}", f"each must exceed min_mm, {low}", "max_mm")
        return self

    def box(self) -> Box:
        """Return the box."""
        return Box(self.min_mm, self.max_mm, self.name or "")


class TrackerPlaceFile(FileModel):
    """Where the tracker stands, and its range."""

    position_mm: Vector
    nearest_mm: Annotated[float, Field(ge=0.0)] = 0.0
    farthest_mm: float | None = None

    @model_validator(mode="after")
    def _require_range(self) -> TrackerPlaceFile:
        farthest = self.farthest_mm
        if farthest is not None and farthest <= self.nearest_mm:
            remedy = f"it must be above {self.nearest_mm:g}"
            raise refuse(f"is {farthest:g}", remedy, "farthest_mm")
        return self


class WorkspaceFile(FileModel):
    """A workspace file."""

    schema_: Literal["workspace/1"] = Field("workspace/1", alias="schema")
    keep_out: Annotated[tuple[BoxFile, ...], Strict(False)] = ()
    tracker: TrackerPlaceFile | None = None
    blocks_sight: Annotated[tuple[BoxFile, ...], Strict(False)] = ()

    @model_validator(mode="after")
    def _require_tracker_of_sight(self) -> WorkspaceFile:
        if self.blocks_sight and self.tracker is None:
            problem = "needs to know where the tracker stands"
            raise refuse(problem, "state tracker.position_mm", "blocks_sight")
        return self

    def workspace(self) -> Workspace:
        """Return the workspace."""
        keep_out = tuple(file.box() for file in self.keep_out)
        tracker = self.tracker
        if tracker is None:
            return Workspace(keep_out)
        return Workspace(
            keep_out,
            tracker.position_mm,
            tracker.nearest_mm,
            math.inf if tracker.farthest_mm is None else tracker.farthest_mm,
            tuple(file.box() for file in self.blocks_sight),
        )


def read_workspace(path: str | Path) -> Workspace:
    """Read a workspace file from disk."""
    name = Path(path).name
    return workspace_from_json(parse_json(read_whole(path), name), file=name)


def workspace_from_json(content: object, *, file: str = "workspace.json") -> Workspace:
    """Return the workspace that parsed JSON states. Raises BundleError."""
    return validate(WorkspaceFile, content, file).workspace()
