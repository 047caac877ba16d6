"""Names of points in a file to the rows of `points.csv`: whole, one to one."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truepath.app.errors import BundleError
from truepath.app.files.tracker_text.cells import Cells
from truepath.app.files.tracker_text.columns import Column
from truepath.app.motion.configurations import Commanded, Configurations

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
    read: dict[str, dict[str, int]] = {}
    for column in columns:
        if column.role == "point" and not _counts_rows(cells, column, points):
            try:
                read[column.name] = _match_names(cells, column, points, known)
            except BundleError:
                if not is_stream:
                    raise
    read = {name: row_of for name, row_of in read.items() if row_of}
    by_row = {
        tuple(read[c.name][text] for text in cells.columns[c.index])
        for c in columns
        if c.role == "point" and c.name in read
    }
    if len(by_row) > 1:
        raise BundleError(
            f"numbers points in {', '.join(read)}, differently",
            file=cells.file,
            remedy="choose one by --column point=NUMBER",
        )
    if by_row:
        return np.array(by_row.pop()) - 1, next(iter(read.values()))
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
        found = _ONE_NUMBER.fullmatch(last)
        row = known.get(text.casefold()) or known.get(last.casefold(), 0)
        if not known:
            if not any(map(str.isdigit, last)):
                return {}
            row = int(found[1]) if found else 0
        if 1 <= row <= points and row not in name_of:
            row_of[text], name_of[row] = row, text
            continue
        problem = f"{text!r} is no point of {points}"
        if row in name_of:
            problem = f"{text!r} and {name_of[row]!r} are both point {row}"
        elif known or not found:
            problem = f"{text!r} " + (
                "is not in points.csv" if known else "has two numbers"
            )
        raise cells.error(problem, index, column.index, _REMEDY)
    return row_of
