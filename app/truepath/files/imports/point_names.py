"""Names of points in a file to the rows of `points.csv`: whole, one to one."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BundleError
from truepath.files.imports.cells import Cells
from truepath.files.imports.columns import Column
from truepath.motion.configurations import Commanded, Configurations

STREAM_ROWS = 10  # a point; fewer rows are no stream
_ONE_NUMBER = re.compile(r"\D*?0*(\d+)\D*")
_REMEDY = (
    "name points by one number, the row of points.csv from 1, or name its rows in a "
    "column `name`"
)


def find_points(
    cells: Cells,
    columns: list[Column],
    commanded: Commanded,
    time_s: NDArray[np.float64],
    names: Sequence[str],
) -> tuple[NDArray[np.int64] | None, dict[str, int]]:
    """Return the commanded point of each row, and of each name its row from 1.

    No point and no name: the file is a stream.
    """
    if not isinstance(commanded, Configurations):
        return None, {}
    rows, points = len(cells), len(commanded)
    is_stream = rows >= STREAM_ROWS * points and np.median(np.diff(time_s)) < 1.0
    known = {name.casefold(): row for row, name in enumerate(names, 1)}
    if len(known) < len(names):
        remedy = "give every row of points.csv a name of its own"
        raise BundleError(
            "cannot be told: names repeat", file=cells.file, remedy=remedy
        )
    found: dict[tuple[int, ...], dict[str, int]] = {}
    for column in columns:
        if column.role != "point" or _counts_rows(cells, column, points):
            continue
        try:
            row_of = _match_names(cells, column, points, known)
        except BundleError:
            if not is_stream:
                raise
            continue
        if row_of:
            texts = cells.columns[column.index]
            found.setdefault(tuple(row_of[text] for text in texts), row_of)
    if len(found) > 1:
        raise BundleError(
            "numbers points in several columns, differently",
            file=cells.file,
            remedy="choose one by --column point=NUMBER",
        )
    for row, row_of in found.items():
        return np.array(row) - 1, row_of
    if is_stream:
        return None, {}
    if rows == points:
        return np.arange(points), {}
    raise BundleError(
        f"has {rows} rows for {points} points and no column that names them",
        file=cells.file,
        remedy=f"say --column point=NUMBER; {_REMEDY}",
    )


def _counts_rows(cells: Cells, column: Column, points: int) -> bool:
    texts = cells.columns[column.index]
    if len(texts) == points or not all(text.isdecimal() for text in texts):
        return False
    return bool((np.diff(np.array(texts, float)) == 1).all())


def _match_names(
    cells: Cells, column: Column, points: int, known: dict[str, int]
) -> dict[str, int]:
    """Return the row of each name; nothing where names hold no number.

    What stands before the last `::` is collection and group.
    """
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
