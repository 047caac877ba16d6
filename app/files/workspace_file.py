"""`workspace.json` (schema `workspace/1`): what limits a plan beside the travel.

    {"schema": "workspace/1",
     "keep_out": [{"name": "probe", "min_mm": [x, y, z], "max_mm": [x, y, z]}],
     "tracker": {"position_mm": [x, y, z], "nearest_mm": 200, "farthest_mm": 5000},
     "blocks_sight": [{"min_mm": [x, y, z], "max_mm": [x, y, z]}]}

All keys but the schema may be left out. Boxes of `keep_out` are axis positions; the
tracker and `blocks_sight` are in the frame that the tracker stands on.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.files.json_fields import Field, Fields, parse_json, shown
from app.files.whole_files import read_whole
from app.motion.workspace import Box, Workspace

SCHEMA = "workspace/1"


def read_workspace(path: str | Path) -> Workspace:
    """Read a workspace file from disk."""
    name = Path(path).name
    return workspace_from_json(parse_json(read_whole(path), name), file=name)


def workspace_from_json(content: object, *, file: str = "workspace.json") -> Workspace:
    """Return the workspace that parsed JSON states."""
    top = Field(file, "", content).mapping()
    schema = top.child("schema", default=SCHEMA)
    if schema.value != SCHEMA:
        raise schema.error(f"is {shown(schema.value)}", f'write "schema": "{SCHEMA}"')
    keep_out, blocks = (_boxes(top, name) for name in ("keep_out", "blocks_sight"))
    if "tracker" not in top:
        if blocks:
            raise top.child("blocks_sight").error(
                "needs to know where the tracker stands", "state tracker.position_mm"
            )
        return Workspace(keep_out)
    tracker = top.child("tracker").mapping()
    nearest = tracker.child("nearest_mm", default=0.0).number(lowest=0.0)
    farthest_mm = np.inf
    if "farthest_mm" in tracker:
        farthest_mm = tracker.child("farthest_mm").number(lowest=nearest, above=True)
    place = tracker.child("position_mm").vector()
    return Workspace(keep_out, place, nearest, farthest_mm, blocks)


def _boxes(top: Fields, name: str) -> tuple[Box, ...]:
    if name not in top:
        return ()
    return tuple(_box(field.mapping()) for field in top.child(name).elements())


def _box(fields: Fields) -> Box:
    low, high = fields.child("min_mm").vector(), fields.child("max_mm")
    if any(h <= lowest for h, lowest in zip(high.vector(), low, strict=True)):
        raise high.error(
            f"is {shown(high.value)}", f"each must exceed min_mm, {list(low)}"
        )
    name = fields.child("name").text() if "name" in fields else ""
    return Box(low, high.vector(), name)
