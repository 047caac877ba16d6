"""SINUMERIK: `$AA_ENC_COMP` per axis, `$AN_CEC` from one axis to another.

A positive value of `$AA_ENC_COMP` moves the axis in the negative direction; `$AN_CEC`
is taken the same way. A table with `$AN_CEC_MULT_BY_TABLE` n gives its product with the
table of index n − 1, which then gives nothing alone, as in the manual's foundation that
sags: ΔX1 = Z1 β(X1). Between MIN and MAX a value that was not entered is 0. The first
index of `$AA_ENC_COMP` is 0 for measuring system 1, 1 for 2. Source: Function Manual
Extended Functions 03/2013, K3, pages 238 to 252.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from truepath_simulators.compensation.correction import Curve, Term
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile

_LINE = re.compile(
    r"\$A[AN]_(ENC_COMP|CEC)(_[A-Z_]+)?\[([^\]]+)\]\s*=\s*\(?([^()]+)\)?"
)


@dataclass(slots=True)
class _Table:
    setting: dict[str, str] = field(default_factory=dict)
    value: dict[int, float] = field(default_factory=dict)


def read_siemens(
    name: str, text: str, machine: MachineFile, rules: Rules
) -> Iterator[Term]:
    """Corrections by the tables of an INI file.

    rules : with the active measuring system of the axes. Tables of the other would have
        no effect: they raise SimulatorError.
    """
    leadscrew, cross = _collect(name, text, rules)
    for axis, table in leadscrew.items():
        column = _find_column(name, axis, machine)
        yield Term(column, (_make_curve(name, table, column),), -1.0)
    yield from _multiply(name, cross, machine)


def _collect(
    name: str, text: str, rules: Rules
) -> tuple[dict[str, _Table], dict[int, _Table]]:
    leadscrew: dict[str, _Table] = {}
    cross: dict[int, _Table] = {}
    for number, line in enumerate(text.splitlines(), 1):
        block = line.partition(";")[0].strip()
        if not block.startswith("$"):
            continue
        found = _LINE.fullmatch(block)
        if found is None:
            raise SimulatorError(f"{name}, row {number}: {block!r} is not understood")
        kind, word, index, value = found.groups()
        places = [place.strip() for place in index.split(",")]
        if kind == "ENC_COMP":
            active = rules.find_measuring_system(places[-1].rstrip("0123456789"))
            if places[0] != str(active - 1):
                raise SimulatorError(
                    f"{name}, row {number}: {places[-1]} is controlled by measuring "
                    f"system {active}; a table of the other does nothing"
                )
            table = leadscrew.setdefault(places[-1], _Table())
        else:
            table = cross.setdefault(int(places[0]), _Table())
        if word:
            table.setting[word] = value
        else:
            table.value[int(places[1])] = float(value)
    return leadscrew, cross


def _multiply(
    name: str, cross: Mapping[int, _Table], machine: MachineFile
) -> Iterator[Term]:
    by = {
        t: int(table.setting.get("_MULT_BY_TABLE", "0")) for t, table in cross.items()
    }
    missing = [n for n in by.values() if n and n - 1 not in cross]
    if missing:
        raise SimulatorError(f"{name}: there is no table number {missing[0]}")
    factors = {number - 1 for number in by.values() if number}
    curves = {
        t: _make_curve(
            name, table, _find_column(name, table.setting["_INPUT_AXIS"], machine)
        )
        for t, table in cross.items()
    }
    for t, table in cross.items():
        out = _find_column(name, table.setting["_OUTPUT_AXIS"], machine)
        if by[t]:
            yield Term(out, (curves[t], curves[by[t] - 1]), -1.0)
        elif t not in factors:
            yield Term(out, (curves[t],), -1.0)


def _make_curve(name: str, table: _Table, column: int) -> Curve:
    try:
        low, high, step = (
            float(table.setting[word]) for word in ("_MIN", "_MAX", "_STEP")
        )
    except KeyError as error:
        raise SimulatorError(f"{name}: a table lacks {error.args[0][1:]}") from error
    if step <= 0.0 or high <= low:
        raise SimulatorError(f"{name}: STEP is not above 0, or MAX not above MIN")
    count = round((high - low) / step) + 1
    value = np.array([table.value.get(k, 0.0) for k in range(count)])
    period = high - low if int(table.setting.get("_IS_MODULO", "0")) else 0.0
    side = int(table.setting.get("_DIRECTION", "0"))
    return Curve(column, low + step * np.arange(count), value, side, period)


def _find_column(name: str, word: str, machine: MachineFile) -> int:
    numbered = re.fullmatch(r"AX(\d+)", word)
    if numbered and 1 <= int(numbered.group(1)) <= len(machine.axes):
        return int(numbered.group(1)) - 1
    letter = word.rstrip("0123456789")
    if letter not in machine.axis_names:
        raise SimulatorError(f"{name}: the machine has no axis {word}")
    return machine.axis_names.index(letter)
