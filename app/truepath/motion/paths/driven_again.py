"""Repetition of rows: back along the executed path, and forth to where it ended.

A motion executed once is free to be repeated, wherever keep-out boxes are. Points are
returned to in a straight line where that is free.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.motion.configurations import Commanded, join_rows, select_rows
from truepath_drivers.interfaces.records import Arc, Path

_SAME = 1e-6  # mm or deg

IsFree = Callable[[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]], bool]
"""True if a machine may go straight from one position to another."""


def drive_again(
    driven: Commanded, first: int, is_free: IsFree | None = None
) -> Commanded:
    """A part that measures the last rows again.

    Points come in their order, or, where the straight way back is not free, back in
    turn and forth again.

    driven : all rows so far, at the last of which the machine is
    first : row of the first line, or point, to be measured again
    is_free : True if a straight way is free; None for all of them
    """
    again = select_rows(driven, slice(first, None))
    if not isinstance(driven, Path) or not isinstance(again, Path):
        here, there = driven.position[-1], driven.position[first]
        if first == len(driven) - 1 or is_free is None or is_free(here, there):
            return again
        back = select_rows(driven, slice(first, -1))
        forth = select_rows(driven, slice(first + 1, None))
        return join_rows([select_rows(back, slice(None, None, -1)), forth])
    way = select_rows(driven, slice(first - 1, None))
    back = replace(
        select_rows(way, slice(None, None, -1)),
        feed_mm_min=again.feed_mm_min[[-1, *range(len(again))[::-1]]],
        arc=(None, *map(_turn_back, again.arc[::-1])) if again.arc else (),
    )
    return join_rows([back, again])


def drive_arcs_again(driven: Path, rows: Collection[int]) -> Path:
    """A part that measures some arcs again, each of them whole.

    It goes back along the executed rows, and forth to the last of these arcs. Where it
    returns to a position, the loop is dropped unless an arc of it is to be measured.

    driven : all rows so far, at the last of which the machine is
    rows : of the arcs, counted in `driven`
    """
    first, last = min(rows), max(rows)
    end = len(driven) - 1
    back = [_Step(row - 1, row, is_back=True) for row in range(end, first - 1, -1)]
    forth = [_Step(row, row) for row in range(first, last + 1)]
    steps = _exclude_loops(driven, [_Step(end, end), *back], ())
    steps += _exclude_loops(driven, [_Step(first - 1, 0), *forth], rows)[1:]
    places, lines = [each.place for each in steps], [each.line for each in steps]
    return replace(
        driven,
        position=driven.position[places],
        feed_mm_min=driven.feed_mm_min[lines],
        dwell_s=driven.dwell_s[places],
        target=tuple(driven.target[row] for row in places) if driven.target else (),
        arc=(None, *(each.find_arc(driven) for each in steps[1:])),
    )


@dataclass(frozen=True, slots=True)
class _Step:
    """To the position of row `place`, along the line that led to row `line`."""

    place: int
    line: int
    is_back: bool = False

    def find_arc(self, driven: Path) -> Arc | None:
        arc = driven.arc[self.line]
        return _turn_back(arc) if self.is_back else arc


def _exclude_loops(
    driven: Path, steps: Iterable[_Step], wanted: Collection[int]
) -> list[_Step]:
    """Drops steps that only lead back to a position. wanted : lines that stay"""
    kept: list[_Step] = []
    fixed = 0  # the last one that has to stay
    for step in steps:
        if kept and step.line in wanted:
            fixed = len(kept)
        elif (k := _find_place(driven, kept[fixed:], step)) is not None:
            del kept[fixed + k + 1 :]
            continue
        kept.append(step)
    return kept


def _find_place(driven: Path, steps: Sequence[_Step], step: _Step) -> int | None:
    here = driven.position[step.place]
    for k, each in enumerate(steps):
        is_same = np.abs(driven.position[each.place] - here).max() < _SAME
        targets = {
            driven.target[row] for row in (each.place, step.place) if driven.target
        }
        if is_same and len(targets) <= 1:
            return k
    return None


def _turn_back(arc: Arc | None) -> Arc | None:
    return None if arc is None else replace(arc, turn_deg=-arc.turn_deg)
