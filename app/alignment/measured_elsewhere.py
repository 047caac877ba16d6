"""Lines and points that one Run lacks and another has measured.

A measurement that was cut short and went on is several Runs; what the first did not get
to is missing only if none of the others has it either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from truepath.app.alignment.observations import Observations
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
        found.append(replace(seen, left_out=kept))
    return found


def _describe_row(run: Run, row: int) -> Place:
    """Return what a line or point is: its ends or place, and its target."""
    path = run.commanded
    first = row - 1 if isinstance(path, Path) else row
    ends = np.round(path.position[max(first, 0) : row + 1], _DECIMALS)
    target = path.target[row] if path.target else ""
    return (run.mode, path.axes, target, *map(tuple, ends.tolist()))
