"""The rows of a plan, executed part by part, so that others can be inserted."""

from __future__ import annotations

from truepath.motion.configurations import (
    Commanded,
    append_part,
    join_rows,
    select_rows,
)
from truepath.motion.paths.driven_again import IsFree, drive_again
from truepath_drivers.interfaces.records import Path

_PART = 2  # lines or points
_FARTHEST = 6  # lines or points that are repeated
_OFTEN = 3  # times in a measurement: it has to end


def _is_always_free(*_: object) -> bool:
    return True


class PlannedRows:
    """A plan, executed from its first row on.

    driven : rows so far, repetitions included; total : lines or points in all
    rows : these, then the remaining ones of the plan
    is_free : for the straight ways back to points that are repeated
    """

    def __init__(self, plan: Commanded, is_free: IsFree = _is_always_free) -> None:
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
