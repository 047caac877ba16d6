"""A SINUMERIK's reading of leadscrew and cross tables, independent of the writer."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    InterpolatedTable,
)
from truepath.compensation.rotary_tables import (
    RotaryAddition,
)
from truepath.errors import BadInput
from truepath.kinematics.machine.symbols import LINEAR, TURNS

_SETTING = re.compile(
    r"\$A[AN]_(ENC_COMP|CEC)(\w*)\[([\w,]+)\]="
    r"\(?(AX\d|[-+]?\d+\.?\d*(?:e[-+]\d+)?)\)?$"
)


def read_tables(files: Mapping[str, str], kind: str) -> Iterator[InterpolatedTable]:
    """Corrections by the tables of a kind: minus their values.

    kind : `ENC_COMP` or `CEC`. A table that multiplies another adds nothing alone.

    Raises BadInput naming file and row, or the table that lacks something.
    """
    settings = [one for one in _read_settings(files, kind) if one[0][0] not in TURNS]
    tables = {name: _make_table(name, words, v) for name, words, v in settings}
    times = {
        name: str(int(words["_MULT_BY_TABLE"]) - 1)
        for name, words, _ in settings
        if int(words.get("_MULT_BY_TABLE", "0"))
    }
    for name, words, _ in settings:
        if name in times.values():
            continue
        side = int(words.get("_DIRECTION", "0"))
        yield tables[name].multiply(tables.get(times.get(name, "")), side)


def read_rotary_tables(files: Mapping[str, str]) -> dict[str, RotaryAddition]:
    """Corrections of rotary axes by leadscrew tables: minus their values, deg.

    Raises BadInput as `read_tables`.
    """
    added: dict[str, RotaryAddition] = {}
    for name, words, values in _read_settings(files, "ENC_COMP"):
        if name[0] in TURNS:
            at, value = _list_rows(name[0], words, values)
            is_modulo = int(words.get("_IS_MODULO", "0"))
            period = float(at[-1] - at[0]) if is_modulo else 0.0
            added[name[0]] = RotaryAddition(at, -value, period)
    return added


def _read_settings(
    files: Mapping[str, str], kind: str
) -> list[tuple[str, dict[str, str], dict[int, float]]]:
    names: dict[str, dict[str, str]] = {}
    systems: dict[str, str] = {}
    values: dict[str, dict[int, float]] = {}
    for name, text in files.items():
        for number, line in enumerate(text.splitlines(), 1):
            block = line.partition(";")[0].strip()
            if not block.startswith("$"):
                continue
            setting = _SETTING.fullmatch(block)
            if setting is None or setting.group(1) != kind:
                raise BadInput(f"{name}, row {number}: {block!r} cannot be read")
            _, word, place, value = setting.groups()
            places = place.split(",")
            # A leadscrew table is named by its axis, a cross table by its number.
            table = places[-1] if kind == "ENC_COMP" else places[0]
            if places[0] != systems.setdefault(table, places[0]):
                raise BadInput(
                    f"{name}, row {number}: {table} has a table of measuring system "
                    f"{int(systems[table]) + 1} as well; keep that of the active one"
                )
            if word:
                names.setdefault(table, {})[word] = value
            else:
                values.setdefault(table, {})[int(places[1])] = float(value)
    return [(table, names[table], values[table]) for table in values]


def _make_table(
    name: str, settings: dict[str, str], values: dict[int, float]
) -> InterpolatedTable:
    """With the sign of the correction: minus the error.

    name : a leadscrew table has that of its axis, a cross table a number
    """
    if "_INPUT_AXIS" in settings:
        words = settings["_INPUT_AXIS"], settings["_OUTPUT_AXIS"]
        own, out = (int(word.removeprefix("AX")) - 1 for word in words)
    else:
        own = out = LINEAR.index(name.rstrip("0123456789"))
    at, value = _list_rows(LINEAR[own], settings, values)
    return InterpolatedTable(LINEAR[own], out, at, -value)


def _list_rows(
    axis: str, settings: Mapping[str, str], values: Mapping[int, float]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    step, low = float(settings["_STEP"]), float(settings["_MIN"])
    count = round((float(settings["_MAX"]) - low) / step) + 1
    if sorted(values) != list(range(count)):
        raise BadInput(f"the table of {axis} lacks points between MIN and MAX")
    value = np.array([values[index] for index in range(count)])
    return low + step * np.arange(count), value
