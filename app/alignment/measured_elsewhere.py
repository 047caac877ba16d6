"""Lines and points that one Run lacks and another has measured.

A measurement that was cut short and went on is several Runs; what the first did not get
to is missing only if none of the others has it either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truepath.app.alignment.observations import Driving, Observations
from truepath.app.files.run import Run
from truepath.drivers.interfaces.records import Path

_MISSING = frozenset({"no-pass", "no-stop"})
_DECIMALS = 6  # mm or deg

Place = tuple[object, ...]


def drop_measured_elsewhere(
    runs: Sequence[Run], observed: Sequence[Observations]
) -> list[Observations]:
    """Return the observations without the missing rows that other Runs have."""
    measured = [
        {_describe_row(run, row) for row in seen.measured_rows}
        for run, seen in zip(runs, observed, strict=True)
    ]
    found: list[Observations] = []
    for number, (run, seen) in enumerate(zip(runs, observed, strict=True)):
        others = set[Place]()
        others.update(*(measured[k] for k in range(len(runs)) if k != number))
        kept = tuple(
            each
            for each in seen.left_out
            if each.cause not in _MISSING or _describe_row(run, each.row) not in others
        )
        driving = _add_driven_elsewhere(number, runs, observed)
        found.append(replace(seen, left_out=kept, driving=driving))
    return found


def _add_driven_elsewhere(
    number: int, runs: Sequence[Run], observed: Sequence[Observations]
) -> Driving | None:
    """Return what was driven of a path, on to where other Runs of it begin and end."""
    driving = observed[number].driving
    if driving is None or driving.is_whole:
        return driving
    others = {
        _describe_row(run, row)
        for k, (run, seen) in enumerate(zip(runs, observed, strict=True))
        if k != number and seen.driving is not None
        for row in range(max(seen.driving.first, 1), seen.driving.last + 1)
    }
    first, last, run = driving.first, driving.last, runs[number]
    while first > 1 and _describe_row(run, first - 1) in others:
        first -= 1
    while last < driving.rows - 1 and _describe_row(run, last + 1) in others:
        last += 1
    return replace(driving, first=first, last=last)


def _describe_row(run: Run, row: int) -> Place:
    """Return what a line or point is: its ends or place, and its target."""
    path = run.commanded
    first = row - 1 if isinstance(path, Path) else row
    ends = np.round(path.position[max(first, 0) : row + 1], _DECIMALS)
    target = path.target[row] if path.target else ""
    return (run.mode, path.axes, target, *map(tuple, ends.tolist()))
