"""ISG kernel, Beckhoff TF5280: Etalon Exchange, a block per parameter.

`[NAME]`, then `VALUE = number`, or `Gridpoints = {` with a row of position and value
each until `}`; `//` begins a comment. The control uses the parameters like those of
ISG_CSV. Source: ISG kernel manual, Etalon Exchange Format.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from truepath_simulators.compensation.isg_tables import (
    Block,
    VolumetricCorrection,
    correct_volume,
)
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine_file import MachineFile


@dataclass(slots=True)
class _Parameter:
    value: float | None = None
    rows: list[list[float]] = field(default_factory=list)


def read_etalon(
    name: str, text: str, machine: MachineFile, rules: Rules
) -> VolumetricCorrection:
    """Correction by the control. Raises SimulatorError."""
    constants: dict[str, float] = {}
    blocks: list[Block] = []
    for symbol, parameter in _read_parameters(name, text).items():
        if parameter.value is not None:
            constants[symbol] = parameter.value
        else:
            blocks.append(_make_block(name, symbol, parameter, machine))
    return correct_volume(name, machine, blocks, constants, rules)


def _read_parameters(name: str, text: str) -> dict[str, _Parameter]:
    read: dict[str, _Parameter] = {}
    symbol, is_open = "", False
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("//")[0].split()
        if not words:
            continue
        try:
            if is_open and words == ["}"]:
                is_open = False
            elif is_open:
                first, second = map(float, words)
                read[symbol].rows.append([first, second])
            elif words[0].startswith("[") and words[0].endswith("]"):
                symbol = words[0][1:-1]
                if symbol in read:
                    raise ValueError(f"{symbol} a second time")
                read[symbol] = _Parameter()
            elif words[:2] == ["VALUE", "="]:
                read[symbol].value = float(words[2])
            elif words == ["Gridpoints", "=", "{"]:
                is_open = symbol in read
            else:
                raise ValueError("not a name, VALUE, Gridpoints or row")
        except (KeyError, IndexError, ValueError) as error:
            raise SimulatorError(f"{name}, row {number}: {error}") from error
    if is_open:
        raise SimulatorError(f"{name}: the table of {symbol} has no end")
    return read


def _make_block(
    name: str, symbol: str, parameter: _Parameter, machine: MachineFile
) -> Block:
    axis = symbol[-1]
    if len(symbol) != 3 or symbol[0] != "E" or axis not in machine.axis_names:
        raise SimulatorError(f"{name}: {symbol} is no error motion of the machine")
    table = np.array(parameter.rows).reshape(-1, 2)
    if not len(table) or (np.diff(table[:, 0]) <= 0.0).any():
        raise SimulatorError(f"{name}: the rows of {symbol} do not ascend")
    return Block((axis,), (table[:, 0],), {symbol: table[:, 1]})
