"""Leica GSI-8 and GSI-16: blocks of words, each an index, a unit, a sign and digits."""

from __future__ import annotations

import re
from collections.abc import Sequence

from truepath.app.errors import BundleError

_WORD = re.compile(r"(\d\d)[\d.]{3}([\d.])([+-])(\S{8}(?:\S{8})?)(?=\s|$)")
_LINE = re.compile(r"\*?(?:\d\d[\d.]{4}[+-]\S{8}(?:\S{8})?\s*)+")
_AXES = ("81", "82", "83")  # easting, northing, height
_MM = {"0": 1.0, "1": 0.3048, "6": 0.1, "7": 0.03048, "8": 0.01}  # of the last digit
_SHARE = 0.5


def is_gsi(lines: Sequence[str]) -> bool:
    """Tell whether most lines are blocks."""
    found = sum(_LINE.fullmatch(line.strip()) is not None for line in lines)
    return found > _SHARE * len(lines)


def list_points(lines: Sequence[str], file: str) -> list[str]:
    """Return names of columns, and for each block its point; a comment for another."""
    table = ["point\tx [mm]\ty [mm]\tz [mm]"]
    for n, line in enumerate(lines, 1):
        words = {index: rest for index, *rest in _WORD.findall(line)}
        if not words.keys() >= {*_AXES}:
            table.append(f"// GSI words {' '.join(words)}")
            continue
        name = words["11"][2].lstrip("0") if "11" in words else ""
        cells = [name or str(n)]
        for unit, sign, digits in (words[index] for index in _AXES):
            if unit not in _MM or not digits.isdigit():
                problem = f"holds {sign}{digits} in unit {unit}, no coordinate"
                raise BundleError(problem, file=file, row=n, remedy="export m or ft")
            cells.append(f"{sign}{int(digits) * _MM[unit]:.4f}")
        table.append("\t".join(cells))
    if all(row.startswith("//") for row in table[1:]):
        raise BundleError(
            f"holds {table[1][3:]} (21, 22: angles, 31: distance), but no coordinates",
            file=file,
            remedy="export the words 81, 82 and 83 (easting, northing, height)",
        )
    return table
