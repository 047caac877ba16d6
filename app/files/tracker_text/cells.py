"""An exported text file to rows of cells: header, data, and what was left out."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from truepath.app.errors import BundleError
from truepath.app.files.tracker_text.options import DELIMITERS

_NUMBER = re.compile(r"^[+-]?(\d[\d.,']*|[.,]\d+)([eE][+-]?\d+)?$")
_NONE = re.compile(r"^([+-]?(nan|inf|1\.#\w+)(\(\w+\))?|n/?a|#n/?a|null|none|-+|\*+)?$")
_CLOCK = re.compile(r"\d+:\d\d")
_COMMENT = ("#", "//", "%", "!")
_LEAST_NUMBERS = 3
_SHARE = 0.5  # of the lines that a delimiter must make rows of


@dataclass(frozen=True, slots=True)
class Cells:
    """Rows of the same number of cells.

    preamble : lines before the header; names, units : empty where the file has none
    row_of : line in the file of each data row, from 1
    notes : what was left out, in words
    """

    file: str
    delimiter: str
    preamble: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    row_of: tuple[int, ...]
    notes: tuple[str, ...]

    def column(self, index: int) -> list[str]:
        """Return the cells of a column."""
        return [row[index] for row in self.rows]

    def error(self, problem: str, index: int, column: int, remedy: str) -> BundleError:
        """Return the error at a data row of a column."""
        name = self.names[column] if self.names else f"{column + 1}"
        return BundleError(
            problem,
            file=self.file,
            row=self.row_of[index],
            column=name,
            remedy=remedy,
        )


def read_cells(data: bytes, file: str, delimiter: str = "") -> Cells:
    """Split a file. Raises BundleError naming the line that fits nothing."""
    lines = _decode(data, file).splitlines()
    name = delimiter or _find_delimiter(lines, file)
    split = {n: _split(line, name) for n, line in enumerate(lines)}
    data_lines = [n for n, row in split.items() if _is_data(lines[n], row)]
    if not data_lines:
        raise BundleError(
            f"holds no rows of numbers separated by {name}",
            file=file,
            remedy="name the separator by --delimiter",
        )
    if all(split[n][-1] == "" for n in data_lines):  # a separator ends each line
        split = {n: r[:-1] if r and not r[-1] else r for n, r in split.items()}
    width = Counter(len(split[n]) for n in data_lines).most_common(1)[0][0]
    if name == "comma":
        _refuse_decimal_comma(lines, split, data_lines, file)
    first = next(n for n in data_lines if len(split[n]) == width)
    header, units = _find_header(lines, split, first, width)
    rows, row_of, notes = _gather(lines, split, first, width, header, file)
    head = () if header is None else split[header]
    return Cells(
        file,
        name,
        tuple(lines[: first if header is None else header]),
        tuple(head),
        () if units is None else tuple(split[units]),
        tuple(rows),
        tuple(row_of),
        tuple(notes),
    )


def is_none(cell: str) -> bool:
    """Tell whether a cell says that there is no value."""
    return _NONE.match(cell.lower()) is not None


def _decode(data: bytes, file: str) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")
    if "\0" in text:
        raise BundleError("is no text", file=file, remedy="export it as text or CSV")
    return text


def _find_delimiter(lines: Sequence[str], file: str) -> str:
    """Return the first separator, from the rarest in text, that makes rows of lines."""
    filled = [line for line in lines if line.strip() and not _is_comment(line)]
    for name in DELIMITERS:
        if name != "blank" and not any(DELIMITERS[name] in line for line in filled):
            continue
        rows = sum(_is_data(line, _split(line, name)) for line in filled)
        if rows and rows >= _SHARE * len(filled):
            return name
    raise BundleError(
        "holds no rows of three or more numbers separated by tab, semicolon, comma or "
        "blank",
        file=file,
        remedy="export it as text or CSV, or name the separator by --delimiter",
    )


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == "blank":
        return line.split()
    cells = next(csv.reader([line], delimiter=DELIMITERS[delimiter]), [])
    return [cell.strip() for cell in cells]


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENT)


def _is_data(line: str, cells: Sequence[str]) -> bool:
    numbers = sum(_NUMBER.match(cell) is not None for cell in cells)
    return not _is_comment(line) and numbers >= _LEAST_NUMBERS


def _refuse_decimal_comma(
    lines: Sequence[str],
    split: dict[int, list[str]],
    data_lines: Sequence[int],
    file: str,
) -> None:
    """Refuse commas that could be both: rows of whole numbers, or of many widths."""
    quoted = any('"' in lines[n] for n in data_lines)
    points = any(re.search(r"\d\.\d", lines[n]) for n in data_lines)
    if points or quoted:
        return
    row = data_lines[0]
    raise BundleError(
        f"{', '.join(split[row])[:40]}: commas separate columns, or whole digits "
        "from decimals, or both",
        file=file,
        row=row + 1,
        remedy="export with a decimal point, or with semicolons between columns",
    )


def _find_header(
    lines: Sequence[str], split: dict[int, list[str]], first: int, width: int
) -> tuple[int | None, int | None]:
    """Return the lines of names and of units above the first row."""
    above = [n for n in range(first) if lines[n].strip()]
    fitting = [n for n in above if len(split[n]) == width and not _is_comment(lines[n])]
    units = None
    if fitting and _is_units(split[fitting[-1]]):
        units = fitting.pop()
    if not fitting or fitting[-1] < (first if units is None else units) - 2:
        return None, units
    header = fitting[-1]
    if units is None and split[header] == split[fitting[0]]:
        header = fitting[0]
    return header, units


def _is_units(cells: Sequence[str]) -> bool:
    known = re.compile(r"^[\[(]?(mm|m|in|inch|s|ms|us|µs|°?[CF]|hpa|%|-|)[\])]?$", re.I)
    return any(cells) and all(known.match(cell) for cell in cells)


def _gather(
    lines: Sequence[str],
    split: dict[int, list[str]],
    first: int,
    width: int,
    header: int | None,
    file: str,
) -> tuple[list[tuple[str, ...]], list[int], list[str]]:
    last = max(n for n, row in split.items() if _fits(lines[n], row, width))
    rows: list[tuple[str, ...]] = []
    row_of: list[int] = []
    left = Counter[str]()
    for n in range(first, last + 1):
        cells = split[n]
        if not lines[n].strip():
            continue
        if _is_comment(lines[n]) or (header is not None and cells == split[header]):
            left["comment" if _is_comment(lines[n]) else "header once more"] += 1
        elif _fits(lines[n], cells, width):
            rows.append(tuple(cells))
            row_of.append(n + 1)
        else:
            raise BundleError(
                f"is no row of {width} cells: {lines[n].strip()[:40]!r}",
                file=file,
                row=n + 1,
                remedy="remove the line, or export the recording again",
            )
    footer = [line.strip() for line in lines[last + 1 :] if line.strip()]
    notes = [f"{count} x {what} left out" for what, count in left.items()]
    if footer:
        notes.append(f"{len(footer)} lines at the end left out: {footer[0][:40]!r}")
    return rows, row_of, notes


def _fits(line: str, cells: Sequence[str], width: int) -> bool:
    """Tell whether a line is a row, with or without values."""
    if len(cells) != width or _is_comment(line):
        return False
    if _is_data(line, cells):
        return True
    values = [cell for cell in cells if _NUMBER.match(cell) or _CLOCK.search(cell)]
    return bool(values) and sum(map(is_none, cells)) >= 1
