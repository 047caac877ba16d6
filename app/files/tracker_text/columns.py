"""Names of columns, as several makers and languages write them, to what they hold."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass

from truepath.app.errors import BundleError
from truepath.app.files.tracker_text.cells import Cells


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
    "punktnummer punkt-id pt punto nom-du-point",
}
_KNOWN = {w: role for role, words in _WORDS.items() for w in words.split()}
_TIME_BESIDE = _list_words(
    "stamp of day tag des sample system utc gps de la du del rel"
)
_HEAT = _list_words("temp temperature temperatur temperatura temperatuur t")
_AIR = _list_words("air luft lufttemperatur ambient umgebung aire aria lucht")
_UNITS = {
    "mm": ("mm", "millimeter millimetre millimeters millimetres milimetros"),
    "m": ("m", "meter metre meters metres metros metri"),
    "inch": ("inch", "in inches zoll pouce pouces pulgada pulgadas"),
    "s": ("s", "sec second seconds sekunden secondes segundos"),
    "ms": ("ms", "msec milliseconds millisekunden"),
    "us": ("us", "usec microseconds µs μs"),
    "degC": ("degC", "°c c celsius degc"),
    "degF": ("degF", "°f f fahrenheit degf"),
}
_UNIT = {
    w: u for u, (own, words) in _UNITS.items() for w in (own.lower(), *words.split())
}
_BRACKET = re.compile(r"[\[(/<]\s*([^\])>]*?)\s*[\])>]?\s*$")
_STATED = re.compile(
    r"\b(?:linear |length |distance )?(?:units?|einheit(?:en)?|unit[eé]s?|unidad(?:es)?"
    r"|unit[aà])\b[\s:;,=\t\"]*([a-zµ]+)",
    re.IGNORECASE,
)
LENGTH_MM = {"mm": 1.0, "m": 1e3, "inch": 25.4}


@dataclass(frozen=True, slots=True)
class Column:
    """What a column holds: a role, `NAME_degC`, or nothing that is used."""

    index: int
    name: str
    role: str
    unit: str


def recognise_columns(cells: Cells, given: Mapping[str, str]) -> list[Column]:
    """Return all columns of a file. Raises BundleError where two claim one role.

    given : what the user says, role to name or number
    """
    fixed = {_find(cells, role, word): role for role, word in given.items()}
    names = cells.names or ("",) * len(cells.rows[0])
    columns: list[Column] = []
    for index, name in enumerate(names):
        bare, unit = _split_unit(name, cells.units[index] if cells.units else "")
        role = fixed.get(index) or _name_role(bare, unit)
        if index not in fixed and role in given:
            role = ""
        columns.append(Column(index, name or f"column {index + 1}", role, unit))
    _refuse_doubles(cells, columns)
    return columns


def state_unit(cells: Cells) -> str:
    """Return the length unit that lines above the header state, empty if none does."""
    found = {
        unit
        for line in cells.preamble
        for word in _STATED.findall(line)
        if (unit := _UNIT.get(word.lower(), "")) in LENGTH_MM
    }
    if len(found) > 1:
        raise BundleError(
            f"states more than one unit: {', '.join(sorted(found))}",
            file=cells.file,
            remedy="name the one of the positions by --unit",
        )
    return next(iter(found), "")


def _find(cells: Cells, role: str, word: str) -> int:
    named = [i for i, name in enumerate(cells.names) if name == word]
    named = named or [
        i for i, n in enumerate(cells.names) if n.casefold() == word.casefold()
    ]
    if len(named) == 1:
        return named[0]
    if not named and word.isdigit() and 1 <= int(word) <= len(cells.rows[0]):
        return int(word) - 1
    found = ", ".join(cells.names) or f"{len(cells.rows[0])} columns without names"
    problem = "names several columns" if named else "is not in the file"
    raise BundleError(
        f"--column {role}={word} {problem}",
        file=cells.file,
        remedy=f"give a number from 1; the file has {found[:120]}",
    )


def _split_unit(name: str, below: str) -> tuple[str, str]:
    """Return a name without its unit, and the unit; `below` is of a line of units."""
    bracket = _BRACKET.search(name)
    if bracket and (unit := _UNIT.get(bracket.group(1).lower())):
        return name[: bracket.start()], unit
    head, cut, tail = re.sub(r"\s+", "_", name.strip()).rpartition("_")
    if cut and (unit := _UNIT.get(tail.lower())):
        return head, unit
    return name, _UNIT.get(below.strip("[]() ").lower(), "")


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


def _refuse_doubles(cells: Cells, columns: list[Column]) -> None:
    for role in {column.role for column in columns if column.role}:
        claim = [column for column in columns if column.role == role]
        if len(claim) > 1 and role != "point":
            names = ", ".join(f"{c.name!r} ({c.index + 1})" for c in claim)
            raise BundleError(
                f"has {len(claim)} columns that could be {role}: {names}",
                file=cells.file,
                remedy=f"choose one by --column {role}=NUMBER",
            )
