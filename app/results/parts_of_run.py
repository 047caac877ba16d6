"""The parts of a verification that was cut short and went on, aligned each for itself.

Every standstill counts once, in the last part that begins before it: a standstill is
come to as it was planned only where the one before it was driven as well, so the first
of a further part that an earlier part has measured only leads to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truepath.app.alignment.align import align_all
from truepath.app.alignment.observations import Observations
from truepath.app.files.run import Run

_MISSING = frozenset({"no-pass", "no-stop"})


@dataclass(frozen=True)
class PartOfRun:
    """One part.

    seen : all of it, which tells its pose; own : what counts, by the rows of the plan
    """

    seen: Observations
    own: Observations


def align_parts(runs: Sequence[Run], first_row: Sequence[int]) -> list[PartOfRun]:
    """Return the parts of a Run, or the one that is all of it.

    first_row : of the plan, that each begins with

    Raises AlignmentError.
    """
    seen = [align_all([run], [run.name])[0] for run in runs]
    begins: list[int] = []
    parts: list[PartOfRun] = []
    for number, first in enumerate(first_row):
        rows_before = (
            row + first_row[k] for k in range(number) for row in seen[k].measured_rows
        )
        begins.append(first + (first in rows_before))
    for number, (one, first) in enumerate(zip(seen, first_row, strict=True)):
        end = min(begins[number + 1 :], default=np.inf)
        parts.append(PartOfRun(one, _select(one, first, begins[number], end)))
    return parts


def _select(seen: Observations, first: int, begin: int, end: float) -> Observations:
    """Return the rows of a part that count, from `begin` to before `end` of the plan.

    first : row of the plan that the part begins with
    """
    row = seen.row + first
    counts = np.flatnonzero((row >= begin) & (row < end))
    own = replace(seen, row=row).select(counts)
    left_out = (
        replace(each, row=each.row + first if each.row >= 0 else each.row)
        for each in seen.left_out
        if each.cause not in _MISSING or begin <= each.row + first < end
    )
    return replace(own, left_out=tuple(left_out))
