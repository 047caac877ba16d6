"""A path of several targets, cut where the target changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from truepath_drivers.interfaces.records import Path


@dataclass(frozen=True, slots=True)
class Stretch:
    """Rows of one target, starting at `row` of the whole path."""

    row: int
    path: Path


def cut_by_target(path: Path) -> list[Stretch]:
    """Each stretch begins at the row where the one before has ended."""
    name = np.array(path.target or ("",) * len(path))
    changes = (np.flatnonzero(name[1:] != name[:-1]) + 1).tolist()
    bounds = [0, *changes, len(path)]
    return [
        _cut_out(path, max(begin - 1, 0), end, path.target[begin:end][:1])
        for begin, end in pairwise(bounds)
    ]


def _cut_out(path: Path, begin: int, end: int, name: tuple[str, ...]) -> Stretch:
    rows = slice(begin, end)
    stretch = replace(
        path,
        position=path.position[rows],
        feed_mm_min=path.feed_mm_min[rows],
        dwell_s=path.dwell_s[rows],
        target=name * (end - begin),
        arc=path.arc[rows],
    )
    return Stretch(begin, stretch)
