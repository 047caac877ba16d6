"""Commands for a machine: standstill points, or a path, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath_drivers.interfaces.records import Arc, Path


@dataclass(frozen=True, slots=True)
class Configurations:
    """Axis positions of standstills.

    position : (n, axes), mm for linear and deg for rotary axes
    dwell_s : (n,)
    target : name of the target measured at each row; empty for a single target
    """

    axes: tuple[str, ...]
    position: Float64[np.ndarray, "n a"]
    dwell_s: Float64[np.ndarray, " n"]
    target: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


Commanded = Path | Configurations
_SAME = 1e-6  # mm or deg


def name_columns(axes: Sequence[str]) -> list[str]:
    """Column names of a CSV file: `x_mm` for X, Y and Z, `c_deg` for others."""
    return [f"{axis.lower()}_{'mm' if axis in 'XYZ' else 'deg'}" for axis in axes]


def select_rows(commanded: Commanded, rows: slice) -> Commanded:
    """All fields of some rows, arcs and targets included."""
    chosen = replace(
        commanded,
        position=commanded.position[rows],
        dwell_s=commanded.dwell_s[rows],
        target=commanded.target[rows],
    )
    if isinstance(chosen, Path):
        feed_mm_min, arc = chosen.feed_mm_min[rows], chosen.arc[rows]
        return replace(chosen, feed_mm_min=feed_mm_min, arc=arc)
    return chosen


def split_by_target(commanded: Commanded) -> list[Commanded]:
    """Consecutive rows of one target each, without shared rows."""
    name = np.array(commanded.target or ("",) * len(commanded))
    bounds = [0, *(np.flatnonzero(name[1:] != name[:-1]) + 1).tolist(), len(commanded)]
    return [select_rows(commanded, slice(*pair)) for pair in pairwise(bounds)]


def join_rows(blocks: Sequence[Commanded]) -> Commanded:
    """Concatenates paths, or points, of the same axes."""
    joined = replace(
        blocks[0],
        position=np.concatenate([block.position for block in blocks]),
        dwell_s=np.concatenate([block.dwell_s for block in blocks]),
        target=tuple(name for block in blocks for name in block.target),
    )
    if isinstance(joined, Path):
        paths = [block for block in blocks if isinstance(block, Path)]
        feeds = np.concatenate([path.feed_mm_min for path in paths])
        arc: tuple[Arc | None, ...] = ()
        if any(path.arc for path in paths):
            arc = tuple(a for path in paths for a in path.arc or (None,) * len(path))
        return replace(joined, feed_mm_min=feeds, arc=arc)
    return joined


def append_part(before: Commanded, part: Commanded) -> Commanded:
    """All rows: those before, then the new ones.

    Of a path the part repeats the last row. Raises PlanningError if the part does not
    continue where the rows before have ended.
    """
    if part.axes != before.axes or isinstance(part, Path) != isinstance(before, Path):
        raise PlanningError("a part has the axes and the mode of what it goes on from")
    if isinstance(before, Path) and isinstance(part, Path):
        if np.abs(part.position[0] - before.position[-1]).max() > _SAME:
            raise PlanningError(
                "the first row of a part is where the machine stands: "
                f"{before.position[-1].tolist()}, not {part.position[0].tolist()}"
            )
        part = select_rows(part, slice(1, None))
    return join_rows([before, part])
