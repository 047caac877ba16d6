"""Rows that are driven again: back along what was driven, and forth to where it ended.

What was driven once is free to be driven again, wherever keep-out boxes are.
"""

from __future__ import annotations

from dataclasses import replace

from truepath.app.motion.configurations import Commanded, join_rows, select_rows
from truepath.drivers.interfaces.records import Arc, Path


def drive_again(driven: Commanded, first: int) -> Commanded:
    """Return a part that measures the last rows again.

    driven : all rows so far, at the last of which the machine stands
    first : row of the first line, or point, to be measured again
    """
    again = select_rows(driven, slice(first, None))
    if not isinstance(driven, Path) or not isinstance(again, Path):
        return again
    way = select_rows(driven, slice(first - 1, None))
    back = replace(
        select_rows(way, slice(None, None, -1)),
        feed_mm_min=again.feed_mm_min[[-1, *range(len(again))[::-1]]],
        arc=(None, *map(_turn_back, again.arc[::-1])) if again.arc else (),
    )
    return join_rows([back, again])


def _turn_back(arc: Arc | None) -> Arc | None:
    return None if arc is None else replace(arc, turn_deg=-arc.turn_deg)
