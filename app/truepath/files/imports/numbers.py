"""Cells to numbers: decimal point or comma, groups of thousands, missing as NaN."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BundleError
from truepath.files.imports.cells import Cells, is_none

_THREES = re.compile(r"^[+-]?[1-9]\d{0,2}(,\d{3})+$")


def find_decimal(cells: Cells, columns: Iterable[int], usual: str = "") -> str:
    """`point` or `comma`. Raises BundleError where it could be either.

    usual : that of other columns of the file, for where it could be either
    """
    found: dict[str, str] = {}
    threes = ""
    for index in columns:
        column = cells.columns[index]
        joined = "\n".join(column)
        if "," not in joined:  # as most files are
            if "." in joined:
                found.setdefault("point", next(c for c in column if "." in c))
            continue
        if "." not in joined and (
            cell := next((c for c in column if "," in c and not _THREES.match(c)), "")
        ):
            found.setdefault("comma", cell)
            continue
        for cell in column:
            point, comma = cell.rfind("."), cell.rfind(",")
            if point < 0 and comma < 0:
                continue
            if point > comma:
                if comma >= 0 or cell.count(".") == 1:
                    found.setdefault("point", cell)
            elif point >= 0 or not _THREES.match(cell):
                found.setdefault("comma", cell)
            else:
                threes = threes or cell
    if len(found) == 2 and not ("." in found["comma"] or "," in found["point"]):
        shown = " and ".join(found.values())
        problem = f"has decimal points and decimal commas: {shown}"
    elif threes and not found and not usual:
        problem = f"{threes} is a number with a decimal comma, or with thousands"
    else:
        return "comma" if "comma" in found else "point" if found else usual or "point"
    raise BundleError(
        problem,
        file=cells.file,
        remedy="say --decimal comma or --decimal point",
    )


def read_numbers(cells: Cells, index: int, decimal: str) -> NDArray[np.float64]:
    """NaN for cells without a value. Raises BundleError for other texts."""
    group, mark = (".", ",") if decimal == "comma" else (",", ".")
    joined = "\n".join(cells.columns[index])
    texts = joined.replace(group, "").replace("'", "").replace(mark, ".").split("\n")
    try:
        values = np.array(list(map(float, texts)))
    except ValueError:
        values = np.array([_read_number(cells, index, *p) for p in enumerate(texts)])
    values[~np.isfinite(values)] = np.nan
    return values


def _read_number(cells: Cells, index: int, row: int, text: str) -> float:
    try:
        return float(text.replace("D", "e").replace("d", "e"))
    except ValueError as error:
        cell = cells.columns[index][row]
        if is_none(cell):
            return np.nan
        remedy = "correct the cell, or choose another column by --column"
        shown = f"is {cell[:40]!r}, not a number"
        raise cells.error(shown, row, index, remedy) from error
