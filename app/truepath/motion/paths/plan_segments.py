"""The rows of a plan, executed part by part, so that others can be inserted.

Repetition goes back along the executed path, and forth to where it ended: a motion
executed once is free, wherever keep-out boxes are. Points are returned to in a straight
line where that is free.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.motion.configurations import (
    Commanded,
    append_part,
    join_rows,
    select_rows,
)
from truepath_drivers.interfaces.records import Arc, Path

_PART = 2  # lines or points
_FARTHEST = 6  # lines or points that are repeated
_OFTEN = 3  # times in a measurement: it has to end
_SAME = 1e-6  # mm or deg

IsFree = Callable[[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]], bool]
"""True if a machine may go straight from one position to another."""


class PlannedRows:
    """A plan, executed from its first row on.

    driven : rows so far, repetitions included; total : lines or points in all
    rows : these, then the remaining ones of the plan
    is_free : for the straight ways back to points that are repeated; None for all
    """

    def __init__(self, plan: Commanded, is_free: IsFree | None = None) -> None:
        self._is_free = is_free
        self._plan, self._next = plan, _PART + isinstance(plan, Path)
        self._first: int | None = None
        self._times = 0
        self.driven = select_rows(plan, slice(self._next))
        self.total = len(plan) - isinstance(plan, Path)

    @property
    def rows(self) -> Commanded:
        """All rows, if nothing more is repeated."""
        left = select_rows(self._plan, slice(self._next, None))
        return join_rows([self.driven, left])

    def repeat(self, first: int) -> None:
        """Measure again from a row on, before anything else.

        Ignored after three repetitions.
        """
        if self._times < _OFTEN:
            self._first = first if self._first is None else min(self._first, first)

    def next(self) -> Commanded | None:
        """The next part, None after the last row."""
        part = self._take_again() or self._take_planned()
        if part is not None:
            self.driven = append_part(self.driven, part)
        return part

    def _take_again(self) -> Commanded | None:
        if self._first is None:
            return None
        least = max(int(isinstance(self._plan, Path)), len(self.driven) - _FARTHEST)
        first, self._first = max(self._first, least), None
        self._times += 1
        if first >= len(self.driven):
            return None
        part = drive_again(self.driven, first, self._is_free)
        self.total += len(part) - isinstance(part, Path)
        return part

    def _take_planned(self) -> Commanded | None:
        begin, end = self._next, self._next + _PART
        if begin >= len(self._plan):
            return None
        self._next = end
        return select_rows(self._plan, slice(begin - isinstance(self._plan, Path), end))


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
