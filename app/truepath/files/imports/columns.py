"""Columns to roles: by the options of the user, names in many languages, content."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from truepath.errors import BadInput, BundleError
from truepath.files.imports.cells import (
    ANGLES,
    CLOCK,
    LENGTH_MM,
    NUMBER,
    Cells,
    find_unit,
    is_none,
    read_numbers,
)

ROLES = ("x", "y", "z", "time", "date", "status", "point")


def _list_words(text: str) -> set[str]:
    return set(text.split())


_OTHER = _list_words(
    "nominal nom soll dev deviation abweichung sigma std rms delta offset vel velocity "
    "accuracy uncertainty error weight dx dy dz i j k"
)
_AXIS_BESIDE = _list_words(
    "pos position coord coordinate coordinates koordinate koordinaten coordenada "
    "coordonnee coordinata coordinaat meas measured measurement actual ist gemessen "
    "mess mesure mesuree medido misurato value wert target reflector smr"
)
_WORDS = {
    "time": "t time timestamp zeit zeitstempel messzeit temps heure horodatage tiempo "
    "hora marca tempo ora tijd tijdstip elapsed datetime 時間 时间",
    "date": "date datum fecha",
    "status": "status state valid validity quality locked statut etat estado stato "
    "gultig zustand",
    "point": "point points name pointname id nr no number index punkt punktname "
    "punktnummer punkt-id pt punto nom-du-point cnt count counter",
}
_KNOWN = {w: role for role, words in _WORDS.items() for w in words.split()}
_TIME_BESIDE = _list_words(
    "stamp of day tag des sample system utc gps de la du del rel"
)
_HEAT = _list_words("temp temperature temperatur temperatura temperatuur t")
_AIR = _list_words("air luft lufttemperatur ambient umgebung aire aria lucht")
_BRACKET = re.compile(r"[\[(/<]\s*([^\])>]*?)\s*[\])>]?\s*$")
_STATED = re.compile(
    r"\b(?:linear |length |distance )?(?:units?|einheit(?:en)?|unit[eé]s?|unidad(?:es)?"
    r"|unit[aà])\b[\s:;,=\t\"]*([a-zµ]+)",
    re.IGNORECASE,
)
_STATED_RATE = re.compile(
    r"(?:rate|frequency|frequenz|fréquence|frecuencia|frequenza)\b\W*"
    r"(\d+(?:[.,]\d+)?)\s*(k?Hz)\b",
    re.IGNORECASE,
)
_STATED_STEP = re.compile(
    r"(?:interval|period|intervall|abstand)\b\W*(\d*[1-9]\d*(?:[.,]\d+)?)\s*(ms|s)\b",
    re.IGNORECASE,
)
_AXES_COMMENT = re.compile(r"AXES\s*=\s*(\w+)\s*:([^(]*)\(([^)]*)\)", re.IGNORECASE)
_POLAR = _list_words(
    "hz v az azimuth zenith elevation el horizontal vertical theta phi r d sd angle "
    "distance range direction azimut zenit winkel distanz strecke richtung"
)
DATE = re.compile(r"(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})")
_AXES = 3
_RISING = 0.995  # of its steps: so a time rises, maybe with a wrap
_KINDS = 200  # rows that show what a column without a name holds


@dataclass(frozen=True, slots=True)
class Column:
    """A column and its role, of `ROLES` or `NAME_degC`; empty if it is not used."""

    index: int
    name: str
    role: str
    unit: str


def recognise_columns(
    cells: Cells, given: Mapping[str, str]
) -> tuple[list[Column], list[BundleError]]:
    """All columns of a file, and which roles several claim: the first has it.

    given : by the user, role to name or number

    Raises BundleError where nothing can be read, or `given` names no column.
    """
    fixed = {_find(cells, role, word): role for role, word in given.items()}
    names = cells.names or ("",) * len(cells.columns)
    columns: list[Column] = []
    for index, name in enumerate(names):
        bare, unit = _split_unit(name, cells.units[index] if cells.units else "")
        role = fixed.get(index) or _name_role(bare, unit)
        if index not in fixed and role in given:
            role = ""
        columns.append(Column(index, name or f"column {index + 1}", role, unit))
    doubles = _reject_repeated_roles(cells, columns)
    return _infer_unnamed(cells, columns), doubles


def describe_columns(cells: Cells, columns: list[Column]) -> str:
    """Sentence on the columns of a file without positions."""
    polar = [c.name for c in columns if c.unit in ANGLES or _is_polar(c.name)]
    if len(polar) >= _AXES:
        return f"polar coordinates ({', '.join(polar)}): export x, y and z"
    if any(cells.names):
        return ", ".join(column.name for column in columns)
    first = ", ".join(column[0] for column in cells.columns)
    return f"{len(columns)} columns without names, first {first}"


def find_column(columns: list[Column], role: str) -> Column | None:
    """None where no column has the role."""
    return next((column for column in columns if column.role == role), None)


def state_unit(cells: Cells) -> str:
    """Stated above the header; empty if none. Raises BundleError for several."""
    found = {
        unit
        for line in cells.preamble
        for word in _STATED.findall(line)
        if (unit := find_unit(word)) in LENGTH_MM
    }
    if len(found) > 1:
        raise BundleError(
            f"states more than one unit: {', '.join(sorted(found))}",
            file=cells.file,
            remedy="name the one of the positions by --unit",
        )
    return next(iter(found), "")


def state_rate(cells: Cells) -> float | None:
    """Rows per second stated above the header, None without."""
    for line in cells.preamble:
        if found := _STATED_RATE.search(line):
            times = 1e3 if found[2].lower() == "khz" else 1.0
            return times * float(found[1].replace(",", "."))
        if found := _STATED_STEP.search(line):
            times = 1e3 if found[2].lower() == "ms" else 1.0
            return times / float(found[1].replace(",", "."))
    return None


def _find(cells: Cells, role: str, word: str) -> int:
    plain = [name.casefold() for name in cells.names]
    named = [i for i, name in enumerate(cells.names) if name == word]
    named = named or [i for i, n in enumerate(plain) if n == word.casefold()]
    if len(named) == 1:
        return named[0]
    if not named and word.isdigit() and 1 <= int(word) <= len(cells.columns):
        return int(word) - 1
    found = ", ".join(cells.names) or f"{len(cells.columns)} columns without names"
    problem = "names several columns" if named else "is not in the file"
    raise BundleError(
        f"--column {role}={word} {problem}",
        file=cells.file,
        remedy=f"give a number from 1; the file has {found[:120]}",
    )


def _split_unit(name: str, below: str) -> tuple[str, str]:
    """A name without its unit, and the unit; `below` is of a line of units."""
    bracket = _BRACKET.search(name)
    if bracket and (unit := find_unit(bracket.group(1))):
        return name[: bracket.start()], unit
    head, cut, tail = re.sub(r"\s+", "_", name.strip()).rpartition("_")
    if cut and (unit := find_unit(tail)):
        return head, unit
    return name, find_unit(below.strip("[]() "))


def _name_role(bare: str, unit: str) -> str:
    plain = unicodedata.normalize("NFKD", bare)
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    plain = re.sub(r"([a-z])([A-Z])", r"\1 \2", plain).lower()
    words = [w for w in re.split(r"[^\w]+|_", plain) if w]
    if not words or _OTHER.intersection(words):
        return ""
    if unit in ("degC", "degF") or _HEAT.difference("t").intersection(words):
        rest = [w for w in words if w not in _HEAT | _AIR | {"sensor"}]
        letter = rest[0].upper() if rest and rest[0] in ("x", "y", "z") else ""
        return f"{letter or '_'.join(rest) or 'air'}_degC"
    axes = [w for w in words if w in ("x", "y", "z")]
    if len(axes) == 1 and all(w in _AXIS_BESIDE for w in words if w not in axes):
        return axes[0]
    roles = {_KNOWN[w] for w in words if w in _KNOWN}
    if {"date", "time"} == roles:
        return "time"
    rest = [w for w in words if w not in _KNOWN and w not in _TIME_BESIDE]
    return roles.pop() if len(roles) == 1 and not rest else ""


def _is_polar(name: str) -> bool:
    words = re.findall(r"[a-z]+", name.lower())
    return bool(words) and words[0] in _POLAR


def _infer_unnamed(cells: Cells, columns: list[Column]) -> list[Column]:
    """Give columns without names roles by their content and their order.

    Only a time rises; x, y and z are three adjacent decimals; a word or whole number
    before them names the point. A comment may state the axes. Whether it fits the
    commanded rows is checked by the alignment.
    """
    stated = next(filter(None, map(_AXES_COMMENT.search, cells.preamble)), None)
    if stated and stated[1].upper() != "CARTESIAN":
        raise BundleError(
            f"states {stated[0]!r}",
            file=cells.file,
            remedy="export the points in Cartesian coordinates",
        )
    above = next(iter(cells.preamble[-1:]), "").split("//")[0]
    named = [_name_role(*_split_unit(w, "")) for w in re.split(r"[\t;, ]+", above)]
    if not cells.names and len({"x", "y", "z"}.intersection(named)) > 1:
        raise BundleError(
            f"{above.strip()[:60]!r} are not the names of {len(columns)} columns",
            file=cells.file,
            remedy="export it again, or remove that line and say --column x=NUMBER, …",
        )
    roles = {column.role for column in columns}
    names = cells.names or ("",) * len(columns)
    blank = [c.index for c in columns if not c.role and not names[c.index]]
    some = _sample_rows(cells)
    kind = {k: _detect_kind(some, k) for k in blank}
    found: dict[int, str] = {}
    places = [k for k in blank if kind[k] in ("decimal", "rising")]
    has_clock = "time" in roles or "time" in kind.values()
    if stated:
        places = places[:_AXES]
    elif len(places) != _AXES and not has_clock:
        places = [k for k in places if kind[k] == "decimal"]
    if len(places) == _AXES and places[-1] - places[0] == _AXES - 1:
        found = dict(zip(places, "xyz", strict=True))
        if kind.get(places[0] - 1) in ("word", "whole", "count"):
            found[places[0] - 1] = "point"
    free = [k for k in blank if found.get(k, "point") == "point"]
    clocks = [k for k in free if kind[k] == "time"]
    clocks = clocks or [k for k in free if kind[k] in ("rising", "count")]
    days = [k for k in free if kind[k] == "date"]
    found |= {clocks[0]: "time"} if len(clocks) == 1 else {}
    found |= {days[0]: "date"} if len(days) == 1 else {}
    found = {k: role for k, role in found.items() if role not in roles}
    unit = find_unit(stated[3].split(",")[0]) if stated else ""
    for k, role in found.items():
        own = unit if role in "xyz" else ""
        columns[k] = replace(columns[k], role=role, unit=own or columns[k].unit)
    return columns


def _sample_rows(cells: Cells) -> Cells:
    stride = max(len(cells) // 50, _KINDS)  # stretches of so many
    begins = range(0, len(cells), stride)
    columns = tuple(
        [cell for k in begins for cell in column[k : k + _KINDS]]
        for column in cells.columns
    )
    rows = [row for k in begins for row in cells.row_of[k : k + _KINDS]]
    return replace(cells, columns=columns, row_of=rows)


def _detect_kind(cells: Cells, index: int) -> str:
    column = cells.columns[index]
    some = column[:: len(column) // _KINDS + 1]
    if any(map(CLOCK.search, some)):
        return "time"
    if any(map(DATE.search, some)):
        return "date"
    if not any(map(NUMBER.match, some)) or not all(
        NUMBER.match(c) or is_none(c) for c in some
    ):
        return "word"
    is_complete = not any(set(".,eEdD") & set(cell) for cell in some)
    comma = any("," in cell for cell in some) and not any("." in cell for cell in some)
    step = np.diff(read_numbers(cells, index, "comma" if comma else "point"))
    rises = step.size and (step >= 0).mean() > _RISING and not (step == step[0]).all()
    if is_complete:
        return "count" if rises else "whole"
    return "rising" if rises else "decimal"


def _reject_repeated_roles(cells: Cells, columns: list[Column]) -> list[BundleError]:
    problems: list[BundleError] = []
    for role in dict.fromkeys(column.role for column in columns if column.role):
        claim = [column for column in columns if column.role == role]
        if len(claim) == 1 or role == "point":
            continue
        names = ", ".join(f"{c.name!r} ({c.index + 1})" for c in claim)
        problem = f"has {len(claim)} columns that could be {role}: {names}"
        remedy = f"choose one by --column {role}=NUMBER"
        problems.append(BundleError(problem, file=cells.file, remedy=remedy))
        for column in claim[1:]:
            columns[column.index] = replace(column, role="")
    return problems


@dataclass(frozen=True, slots=True)
class TextOptions:
    """Empty values are recognised from the file.

    columns : role, or `NAME_degC`, to a column's name or its number from 1
    rate_hz : of the rows; the time column, if any, is left out
    valid : values in the status column of samples that may be used
    axes : signs and names of the file's axes that become x, y, z: `x,-y,z`
    """

    delimiter: str = ""
    decimal: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    time_unit: str = ""
    date_order: str = ""
    across_midnight: bool = False
    rate_hz: float | None = None
    valid: tuple[str, ...] = ()
    axes: str = "x,y,z"


def parse_columns(words: list[str]) -> dict[str, str]:
    """From `role=column` words. Raises BadInput."""
    columns: dict[str, str] = {}
    for word in words:
        role, equals, column = word.partition("=")
        known = role in ROLES or (role.endswith("_degC") and role != "_degC")
        if not (known and equals and column.strip()):
            raise BadInput(
                f"--column {word}: write ROLE=NAME or ROLE=NUMBER; roles are "
                f"{', '.join(ROLES)} and NAME_degC"
            )
        if role in columns:
            raise BadInput(f"--column {role}: is given twice")
        columns[role] = column.strip()
    return columns
