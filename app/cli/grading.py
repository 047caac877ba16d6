"""The grade of a set-up, printed before anything moves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.cli.terminal import print_json
from app.errors import BadInput
from app.results.grading import graded, read_set_up

_PLACE = 3  # coordinates


def grade_set_up(
    machine: Path,
    commanded: Path,
    tracker: str | None,
    *,
    perpendicular_only: bool,
    as_json: bool,
) -> None:
    """Grade a path or points of a machine and print what comes of it."""
    place = None if tracker is None else _place(tracker)
    found = graded(
        *read_set_up(machine, commanded),
        tracker_mm=place,
        perpendicular_only=perpendicular_only,
    )
    if as_json:
        print_json({"schema": "grade/1", **found})
    else:
        for line in worded(found):
            print(line)


def worded(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the grade and what is weak about the set-up, a line each."""
    yield f"grade of the set-up: {found['text']}"
    for motion in found["weakest"]:
        if motion["remedy"] is not None:
            yield (
                f"weak: {motion['error']} ({motion['meaning']}), "
                f"{motion['at_tool_um']:.1f} µm at the tool: {motion['remedy']}"
            )
    for shape in found["weak_shapes"]:
        yield f"weak: {shape}"
    for statement in found["unobservable"]:
        yield f"cannot be seen: {statement}"


def _place(text: str) -> list[float]:
    try:
        place = [float(part) for part in text.split(",")]
    except ValueError:
        place = []
    if len(place) != _PLACE or not np.isfinite(place).all():
        raise BadInput(
            f"--tracker {text}: not a place; write X,Y,Z in mm, as 1200,0,300"
        )
    return place
