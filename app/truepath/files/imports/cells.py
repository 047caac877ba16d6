"""An exported text file to columns of cells, and cells to numbers and units."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BundleError

DELIMITERS = {"tab": "\t", "semicolon": ";", "comma": ",", "blank": " "}
NUMBER = re.compile(r"^[+-]?(\d[\d.,']*|[.,]\d+)([eEdD][+-]?\d+)?$")
CLOCK = re.compile(r"\d+:\d\d")
_NONE = re.compile(r"^([+-]?(nan|inf|1\.#\w+)(\(\w+\))?|n/?a|#n/?a|null|none|-+|\*+)?$")
_COMMENT = ("#", "//", "%", "!")
_COMMENT_MARKS = frozenset("".join(_COMMENT))
_DIGITS = frozenset("0123456789.")  # that a number ends with
_LEAST_NUMBERS = 3
_SHARE = 0.5  # of the lines that a delimiter must make rows of
_SAMPLE = 2000  # lines that show how a file is made
_ALIKE = {"\u2019": "'", "\u2212": "-", "\u2013": "-"}
_ALIKE |= dict.fromkeys("\u2007\u2009\u202f", "\u00a0")
_GROUPS = re.compile(r"(?<![\d.,:])(?<!\d-)\d{1,3}(?:\u00a0\d{3})+(?!\d)")
_BLANK_GROUPS = re.compile(_GROUPS.pattern.replace("\u00a0", "[\u00a0 ]"))
_LABEL = re.compile(r"(?<=[A-Za-z)\]])[ \t]*[=:][ \t]*(?=[-+.\d])")
_Shape = tuple[int, int]  # cells that a row needs, and may have
_HALF_DAY = re.compile(r"(:\d\d\S*) ([AP]M)\b", re.IGNORECASE)
# Leica GSI-8 and GSI-16: blocks of words, each an index, a unit, a sign and digits
_GSI_WORD = re.compile(r"(\d\d)[\d.]{3}([\d.])([+-])(\S{8}(?:\S{8})?)(?=\s|$)")
_GSI_LINE = re.compile(r"\*?(?:\d\d[\d.]{4}[+-]\S{8}(?:\S{8})?\s*)+")
_GSI_AXES = ("81", "82", "83")  # easting, northing, height
_GSI_MM = {
    "0": 1.0,
    "1": 0.3048,
    "6": 0.1,
    "7": 0.03048,
    "8": 0.01,
}  # of the last digit
_WORDS = {
    "mm": "mm millimeter millimetre millimeters millimetres milimetros",
    "m": "m meter metre meters metres metros metri",
    "um": "um µm μm micron microns micrometer micrometre mikrometer",
    "cm": "cm centimeter centimetre zentimeter",
    "inch": "inch in inches zoll pouce pouces pulgada pulgadas",
    "ft": "ft foot feet",
    "s": "s sec second seconds sekunden secondes segundos",
    "ms": "ms msec milliseconds millisekunden",
    "us": "us usec microseconds µs μs",
    "degC": "degc °c c celsius",
    "degF": "degf °f f fahrenheit",
    "deg": "deg ° degree degrees grad",
    "gon": "gon",
    "rad": "rad radian radians",
}
_UNIT = {word: unit for unit, words in _WORDS.items() for word in words.split()}
LENGTH_MM = {"mm": 1.0, "m": 1e3, "inch": 25.4, "um": 1e-3, "cm": 10.0, "ft": 304.8}
ANGLES = frozenset(("deg", "gon", "rad"))
_THREES = re.compile(r"^[+-]?[1-9]\d{0,2}(,\d{3})+$")


@dataclass(frozen=True, slots=True)
class Cells:
    """Columns of the same number of cells.

    preamble : lines before the header; names, units : empty where the file has none
    row_of : line in the file of each data row, from 1
    notes : what was left out, in words
    problems : lines that are no rows, if there are any
    """

    file: str
    delimiter: str
    preamble: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: tuple[Sequence[str], ...]
    row_of: Sequence[int]
    notes: tuple[str, ...]
    problems: tuple[BundleError, ...] = ()

    def __len__(self) -> int:
        return len(self.row_of)

    def error(self, problem: str, index: int, column: int, remedy: str) -> BundleError:
        """Counts the data row from 0; the error names the line of the file."""
        name = self.names[column] if self.names else f"{column + 1}"
        row = self.row_of[index]
        return BundleError(problem, file=self.file, row=row, column=name, remedy=remedy)


def read_cells(data: bytes, file: str, delimiter: str = "") -> Cells:
    """Split a file. Raises BundleError naming the line that fits nothing."""
    text = _decode(data, file)
    lines = text.splitlines()
    filled = [n for n, line in enumerate(lines) if line.strip()]
    sample = [lines[n] for n in filled[:: len(filled) // _SAMPLE + 1]]
    ahead = 0  # lines that are not of the file
    gsi = sum(_GSI_LINE.fullmatch(line.strip()) is not None for line in sample)
    if not delimiter and gsi > _SHARE * len(sample):
        lines, ahead, delimiter = _list_gsi_points(lines, file), 1, "tab"
        sample, filled = lines[:_SAMPLE], [*range(len(lines))]
    labelled = sum(len(_LABEL.findall(line)) >= _LEAST_NUMBERS for line in sample)
    if labelled > _SHARE * len(sample):
        mark = next((d for d in "\t;," if d in sample[-1]), " ")
        lines = [_LABEL.sub(mark, line) for line in lines]
        sample = [_LABEL.sub(mark, line) for line in sample]
    name = delimiter or _find_delimiter(sample, file)
    split = _split_lines(lines, name)
    made = [split[n] for n in filled[:: len(filled) // _SAMPLE + 1]]
    made = [row for row in made if _is_data(row)]
    if not made:
        raise BundleError(
            f"holds no rows of numbers separated by {name}",
            file=file,
            remedy="name the separator by --delimiter",
        )
    width = Counter(map(len, made)).most_common(1)[0][0]
    ends = (max(k for k, cell in enumerate(row, 1) if cell) for row in made)
    needed = Counter(ends).most_common(1)[0][0]
    if name == "comma":
        _reject_decimal_comma(lines, split, file)
    shape = (needed, width)
    first = next(n for n in filled if _is_data(split[n]) and _fits(split[n], shape))
    header, units = _find_header(split, first, shape)
    head = [] if header is None else split[header]
    if header is None and first and _is_comment(lines[first - 1]):
        head = _read_names(split[first - 1], width)
    rows, row_of, notes, problems = _select_rows(split, first, shape, head, file)
    columns = [*zip(*rows, strict=True)]
    head = _pad(head, width)
    below = _pad([] if units is None else split[units], width)
    while not head[-1] and not any(columns[-1]):  # a separator ends each line
        columns, head, below = columns[:-1], head[:-1], below[:-1]
    if header is None:
        columns, head, below = _name_by_labels(columns, head, below)
    return Cells(
        file,
        name,
        tuple(lines[: first if header is None else header]),
        tuple(head) if any(head) else (),
        tuple(below) if any(below) else (),
        tuple(columns),
        [n - ahead for n in row_of] if ahead else row_of,
        tuple(notes),
        tuple(problems),
    )


def is_none(cell: str) -> bool:
    """Whether a cell marks a missing value."""
    return _NONE.match(cell.lower()) is not None


def _decode(data: bytes, file: str) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = data.decode("utf-16", "replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", "replace")
    if "\0" in text:
        raise BundleError("is no text", file=file, remedy="export it as text or CSV")
    return text if text.isascii() else text.translate(str.maketrans(_ALIKE))


def _find_delimiter(sample: Sequence[str], file: str) -> str:
    """First separator, from the rarest in text, that splits most lines into rows."""
    filled = [line for line in sample if not _is_comment(line)]
    for name in DELIMITERS:
        if name != "blank" and not any(DELIMITERS[name] in line for line in filled):
            continue
        rows = sum(map(_is_data, _split_lines(filled, name)))
        if rows and rows >= _SHARE * len(filled):
            return name
    seen = " and ".join(
        repr(line.strip()[:60]) for line in filled[:: max(len(filled) - 1, 1)]
    )
    raise BundleError(
        "holds no rows of three or more numbers separated by tab, semicolon, comma or "
        f"blank; its lines are such as {seen or 'none'}",
        file=file,
        remedy="export x, y and z as text or CSV, or name the separator by --delimiter",
    )


def _split_lines(lines: Sequence[str], name: str) -> list[list[str]]:
    mark, text = DELIMITERS[name], "\n".join(lines)
    if name in ("tab", "semicolon"):
        text = _BLANK_GROUPS.sub(_close_up, text)
    elif "\u00a0" in text:
        text = _GROUPS.sub(_close_up, text)
    if name == "blank":
        return [line.split() for line in _HALF_DAY.sub(r"\1\2", text).split("\n")]
    if '"' in text:
        split = [next(csv.reader([ln], delimiter=mark), []) for ln in text.split("\n")]
        return [[cell.strip() for cell in row] for row in split]
    for blanks in (f"{mark} ", f" {mark}", "\n ", " \n"):
        while blanks in text:
            text = text.replace(blanks, blanks.strip(" "))
    return [line.split(mark) for line in text.split("\n")]


def _close_up(found: re.Match[str]) -> str:
    return found[0].replace("\u00a0", "").replace(" ", "")


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENT)


def _is_data(cells: Sequence[str]) -> bool:
    if not cells or cells[0].startswith(_COMMENT):
        return False
    return sum(NUMBER.match(cell) is not None for cell in cells) >= _LEAST_NUMBERS


def _pad(row: list[str], width: int) -> list[str]:
    return (row + [""] * width)[:width]


def _reject_decimal_comma(
    lines: Sequence[str], split: Sequence[list[str]], file: str
) -> None:
    """Refuse ambiguous commas: rows of whole numbers, or of many widths."""
    data_lines = [n for n in range(min(len(split), _SAMPLE)) if _is_data(split[n])]
    plain = re.compile(r'"|\d\.\d|\d[eE][+-]?\d')
    if not data_lines or any(plain.search(lines[n]) for n in data_lines):
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
    split: Sequence[list[str]], first: int, shape: _Shape
) -> tuple[int | None, int | None]:
    fitting = [n for n in range(first) if shape[0] <= len(split[n]) <= shape[1]]
    fitting = [n for n in fitting if not _is_comment(split[n][0])]
    units = None
    if fitting and _is_units(split[fitting[-1]]):
        units = fitting.pop()
    if not fitting or fitting[-1] < (first if units is None else units) - 2:
        return None, units
    header = fitting[-1]
    if units is None and split[header] == split[fitting[0]]:
        header = fitting[0]
    return header, units


def _read_names(comment: list[str], width: int) -> list[str]:
    first = comment[0].lstrip("".join(_COMMENT)).strip()
    names = [first, *comment[1:]] if first else comment[1:]
    begins = {name[:1].lower() for name in names}
    return names if len(names) == width and begins >= set("xyz") else []


def _is_units(cells: Sequence[str]) -> bool:
    bare = [cell.strip("[]()") for cell in cells]
    known = (not c or c in "%-" or c.lower() == "hpa" or find_unit(c) for c in bare)
    return any(bare) and all(known)


def _select_rows(
    split: list[list[str]], first: int, shape: _Shape, head: list[str], file: str
) -> tuple[list[list[str]], Sequence[int], list[str], list[BundleError]]:
    body = split[first:]
    plain = _find_plain(body, shape[1])
    if all(plain):
        return body, range(first + 1, len(split) + 1), [], []
    kept: list[int] = []
    left = Counter[str]()
    odd: list[int] = []  # refused if a row follows
    for n, (cells, is_plain) in enumerate(zip(body, plain, strict=True)):
        if is_plain:
            kept.append(n)
        elif cells in ([], [""]):
            continue
        elif _is_comment(cells[0]):
            left["comment"] += 1
        elif cells == head:
            left["header once more"] += 1
        elif not _fits(cells, shape):
            odd.append(n)
        else:
            kept.append(n)
            body[n] = _pad(cells, shape[1])
    notes = [f"{count} x {what} left out" for what, count in left.items()]
    problems: list[BundleError] = []
    within = [n for n in odd if n < kept[-1]]
    if within:
        shown = " ".join(body[within[0]])[:40]
        more = f", and {len(within) - 1} such lines more" if len(within) > 1 else ""
        remedy = "remove the line, or export the recording again"
        problem = f"is no row of {shape[0]} cells: {shown!r}{more}"
        row = first + within[0] + 1
        problems.append(BundleError(problem, file=file, row=row, remedy=remedy))
    elif odd:
        shown = " ".join(body[odd[0]])[:40]
        notes.append(f"{len(odd)} lines at the end left out: {shown!r}")
    row_of = [first + n + 1 for n in kept]
    return [body[n] for n in kept], row_of, notes, problems


def _find_plain(body: Sequence[list[str]], width: int) -> list[bool]:
    """Which lines are rows for certain; checking every cell of all is slow.

    They have all cells, and possible numbers where the first row has the first ones.
    """
    numbers = [k for k, cell in enumerate(body[0]) if NUMBER.match(cell)]
    if len(body[0]) != width or len(numbers) < _LEAST_NUMBERS:
        return [False] * len(body)
    a, b, c = numbers[:_LEAST_NUMBERS]
    return [
        len(row) == width
        and row[a][-1:] in _DIGITS
        and row[b][-1:] in _DIGITS
        and row[c][-1:] in _DIGITS
        and row[0][:1] not in _COMMENT_MARKS
        for row in body
    ]


def _fits(cells: list[str], shape: _Shape) -> bool:
    if len(cells) < shape[0] or any(cells[shape[1] :]):
        return False
    if _is_data(cells):
        return True
    values = [cell for cell in cells if NUMBER.match(cell) or CLOCK.search(cell)]
    return bool(values) and sum(map(is_none, cells)) >= 1


def _name_by_labels(
    columns: list[tuple[str, ...]], head: list[str], below: list[str]
) -> tuple[list[tuple[str, ...]], list[str], list[str]]:
    """Name columns by a word before the number in every row: X,12.5,Y,…"""
    is_number = [NUMBER.match(column[0]) is not None for column in columns]
    label = [
        is_number[k : k + 2] == [False, True] and column.count(column[0]) == len(column)
        for k, column in enumerate(columns)
    ]
    if sum(label) < _LEAST_NUMBERS:
        return columns, head, below
    kept = [k for k in range(len(columns)) if not label[k]]
    names = [columns[k - 1][0] if k and label[k - 1] else "" for k in kept]
    return [columns[k] for k in kept], names, [""] * len(kept)


def _list_gsi_points(lines: Sequence[str], file: str) -> list[str]:
    # A point for each block with coordinates, a comment for another
    table = ["point\tx [mm]\ty [mm]\tz [mm]"]
    for n, line in enumerate(lines, 1):
        words = {index: rest for index, *rest in _GSI_WORD.findall(line)}
        if not words.keys() >= {*_GSI_AXES}:
            table.append(f"// GSI words {' '.join(words)}")
            continue
        name = words["11"][2].lstrip("0") if "11" in words else ""
        cells = [name or str(n)]
        for unit, sign, digits in (words[index] for index in _GSI_AXES):
            if unit not in _GSI_MM or not digits.isdigit():
                problem = f"holds {sign}{digits} in unit {unit}, no coordinate"
                raise BundleError(problem, file=file, row=n, remedy="export m or ft")
            cells.append(f"{sign}{int(digits) * _GSI_MM[unit]:.4f}")
        table.append("\t".join(cells))
    if all(row.startswith("//") for row in table[1:]):
        raise BundleError(
            f"holds {table[1][3:]} (21, 22: angles, 31: distance), but no coordinates",
            file=file,
            remedy="export the words 81, 82 and 83 (easting, northing, height)",
        )
    return table


def find_unit(word: str) -> str:
    """Empty for another word."""
    return _UNIT.get(word.strip().lower(), "")


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
