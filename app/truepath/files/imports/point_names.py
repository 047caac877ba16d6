"""Names of points in a file to the rows of `points.csv`: complete, one to one."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BundleError
from truepath.files.imports.cells import Cells
from truepath.files.imports.columns import Column
from truepath.motion.configurations import Commanded, Configurations

_MOST_SHIFT = 3  # points that names may be off, and times that this changes
_MOST_SHOWN = 12
STREAM_ROWS = 10  # a point; fewer rows are no stream
_ONE_NUMBER = re.compile(r"\D*?0*(\d+)\D*")
_REMEDY = (
    "name points by one number, the row of points.csv from 1, or name its rows in a "
    "column `name`"
)


@dataclass(frozen=True, slots=True)
class Shots:
    """Rows of a file as measured: positions, validity, and times."""

    position_mm: NDArray[np.float64]
    is_valid: NDArray[np.bool_]
    time_s: NDArray[np.float64]


LocateShots = Callable[[Configurations, NDArray[np.float64]], NDArray[np.int64] | None]
"""Point of each position, by order and distance: −1 at none of them; None where the
positions do not follow the points."""


def find_points(
    cells: Cells,
    columns: list[Column],
    commanded: Commanded,
    shots: Shots,
    names: Sequence[str],
    find_locations: LocateShots | None,
) -> tuple[NDArray[np.int64] | None, dict[str, int], tuple[str, ...]]:
    """The commanded point of each row, of each name its row from 1, and notes.

    The point is −1 where a row is at none. No point and no name: the file is a stream.
    """
    if not isinstance(commanded, Configurations):
        return None, {}, ()
    rows, points = len(cells), len(commanded)
    is_stream = rows >= STREAM_ROWS * points and np.median(np.diff(shots.time_s)) < 1.0
    known = {name.casefold(): row for row, name in enumerate(names, 1)}
    if len(known) < len(names):
        remedy = "give every row of points.csv a name of its own"
        raise BundleError(
            "cannot be told: names repeat", file=cells.file, remedy=remedy
        )
    by_position = None
    if find_locations is not None and not is_stream:
        at = find_locations(commanded, shots.position_mm[shots.is_valid])
        if at is not None:
            by_position = np.full(len(shots.is_valid), -1)
            by_position[shots.is_valid] = at
    slack = 0 if by_position is None else _MOST_SHIFT
    found: dict[tuple[int, ...], tuple[Column, dict[str, int]]] = {}
    for column in columns:
        if column.role != "point" or _counts_rows(cells, column, points):
            continue
        try:
            row_of = _match_names(cells, column, points + slack, known)
        except BundleError:
            if not is_stream:
                raise
            continue
        if row_of:
            texts = cells.columns[column.index]
            found.setdefault(tuple(row_of[t] for t in texts), (column, row_of))
    if len(found) > 1:
        raise BundleError(
            "numbers points in several columns, differently",
            file=cells.file,
            remedy="choose one by --column point=NUMBER",
        )
    for row, (column, row_of) in found.items():
        by_name = np.array(row) - 1
        notes = _describe_shifts(cells, by_name, by_position)
        if by_position is not None and notes:
            return by_position, {}, notes
        if by_name.max() >= points:
            index = int(by_name.argmax())
            text = cells.columns[column.index][index]
            problem = f"{text!r} is no point of {points}"
            raise cells.error(problem, index, column.index, _REMEDY)
        return by_name, row_of, ()
    if is_stream:
        return None, {}, ()
    if by_position is not None:
        return by_position, {}, _describe_positions(cells, by_position, shots, points)
    if rows == points:
        return np.arange(points), {}, ()
    raise BundleError(
        f"has {rows} rows for {points} points, no column that names them, and their "
        "places are not those of the points in order",
        file=cells.file,
        remedy=f"say --column point=NUMBER; {_REMEDY}",
    )


def _describe_shifts(
    cells: Cells, by_name: NDArray[np.int64], by_position: NDArray[np.int64] | None
) -> tuple[str, ...]:
    if by_position is None:
        return ()
    at = np.flatnonzero(by_position >= 0)
    shift = by_name[at] - by_position[at]
    begins = np.flatnonzero(np.diff(np.append(0, shift)))
    if (
        not len(begins)
        or len(begins) > _MOST_SHIFT
        or np.abs(shift).max() > _MOST_SHIFT
    ):
        return ()
    return tuple(
        f"names are shifted by {shift[k]:+d} from row {cells.row_of[at[k]]} on: "
        "points are taken by order and place"
        for k in begins.tolist()
    )


def _describe_positions(
    cells: Cells, by_position: NDArray[np.int64], shots: Shots, points: int
) -> tuple[str, ...]:
    told: list[str] = []
    times = np.bincount(by_position[by_position >= 0], minlength=points)
    stray = np.asarray(cells.row_of)[shots.is_valid & (by_position < 0)]
    for what, rows in (
        ("points without a shot", np.flatnonzero(times == 0) + 1),
        (
            "points with more shots than most",
            np.flatnonzero(times > np.median(times)) + 1,
        ),
        ("rows at no point, left out", stray),
    ):
        if len(rows):
            more = ", …" if len(rows) > _MOST_SHOWN else ""
            told.append(f"{what}: {', '.join(map(str, rows[:_MOST_SHOWN]))}{more}")
    if len(cells) != points or told:
        told.insert(0, "points are taken by order and place")
    return tuple(told)


def _counts_rows(cells: Cells, column: Column, points: int) -> bool:
    texts = cells.columns[column.index]
    if len(texts) == points or not all(text.isdecimal() for text in texts):
        return False
    return bool((np.diff(np.array(texts, float)) == 1).all())


def _match_names(
    cells: Cells, column: Column, points: int, known: dict[str, int]
) -> dict[str, int]:
    row_of: dict[str, int] = {}
    name_of: dict[int, str] = {}
    for index, text in enumerate(cells.columns[column.index]):
        if text in row_of:
            continue
        last = text.rpartition("::")[2]
        row, problem = 0, "has two numbers"
        if known:
            row = known.get(text.casefold()) or known.get(last.casefold(), 0)
            problem = "is not in points.csv"
        elif not any(map(str.isdigit, last)):
            return {}
        elif found := _ONE_NUMBER.fullmatch(last):
            row, problem = int(found[1]), f"is no point of {points}"
        if row in name_of:
            problem = f"and {name_of[row]!r} are both point {row}"
        elif 1 <= row <= points:
            row_of[text], name_of[row] = row, text
            continue
        raise cells.error(f"{text!r} {problem}", index, column.index, _REMEDY)
    return row_of
