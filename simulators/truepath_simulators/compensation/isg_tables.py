"""ISG kernel, Beckhoff TF5280: volumetric compensation by error motions.

ISG_CSV: blocks split by `#`: constants (squareness, location), or one or two arguments
and error motions, mm and rad. The controller composes the chain with them, computes the
tool point, and subtracts its error with the linear axes. The tip is at P0X, P0Y, P0Z, 0
where left out, plus the length that the control knows along the unit vector N0X, N0Y,
N0Z. Rotary axes turn about PXC, PYC, PZC; their errors are taken to be of the tool
relative to the workpiece, which no public text says.

Etalon Exchange: `[NAME]`, then `VALUE = number`, or `Gridpoints = {` with a row of
position and value each until `}`; `//` begins a comment. The control uses the
parameters like those of ISG_CSV. Source: ISG kernel manual, volumetric compensation and
Etalon Exchange Format.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from truepath_simulators.compensation.correction import Correction, Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.joints import RotaryJoint
from truepath_simulators.machine.truth_machine import SQUARENESS, TruthMachine, perfect
from truepath_simulators.machine_file import (
    DIRECTIONS,
    MachineFile,
    Reflector,
    RotaryAxis,
)

_MOTIONS = "XYZABC"
_TOOL = ("N0X", "N0Y", "N0Z")
_TIP = ("P0X", "P0Y", "P0Z")  # where all axes are at zero


@dataclass(frozen=True, slots=True)
class Block:
    """Error motions of an axis over one or two arguments.

    arguments : axes, the last of them the axis itself
    grid : positions of each argument, ascending
    motion : name to values on the grid
    """

    arguments: tuple[str, ...]
    grid: tuple[np.ndarray, ...]
    motion: dict[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class VolumetricCorrection(Correction):
    """Minus the error of the chain from error motions, by the linear axes."""

    nominal: TruthMachine
    blocks: tuple[Block, ...]
    constants: dict[str, float]
    tool_length_mm: float

    def added(self, position: np.ndarray, heading: np.ndarray) -> np.ndarray:
        del heading
        machine = self.nominal.machine
        x, y, z = (
            self.constants.get(tip, 0.0)
            + self.tool_length_mm * self.constants.get(along, 0.0)
            for tip, along in zip(_TIP, _TOOL, strict=True)
        )
        tool = Reflector("", "tool", (x, y, z))
        carry = {
            axis: self._find_motions(axis, position) for axis in machine.axis_names
        }
        nominal = self.nominal.nominal_point_mm(position, tool)
        actual = self._place_axes().point_mm(position, tool, "workpiece", carry)
        error = actual - nominal
        steps = np.empty((len(position), 3, 3))
        for k in range(
            3
        ):  # exact: the tool point is linear in the linear axes' positions
            moved = position.astype(float).copy()
            moved[:, k] += 1.0
            steps[:, :, k] = self.nominal.nominal_point_mm(moved, tool) - nominal
        total = np.zeros_like(position, dtype=float)
        total[:, :3] = -np.linalg.solve(steps, error[:, :, None])[:, :, 0]
        return total

    def _place_axes(self) -> TruthMachine:
        joints = dict(self.nominal.joints)
        for name, joint in joints.items():
            if isinstance(joint, RotaryJoint):
                shift, tilt = (
                    tuple(self.constants.get(f"{d}0{name}", 0.0) for d in letters)
                    for letters in ("XYZ", "ABC")
                )
                joints[name] = replace(joint, shift_mm=shift, tilt_rad=tilt)
        return replace(self.nominal, joints=joints)

    def _find_motions(self, axis: str, position: np.ndarray) -> np.ndarray:
        """With squareness and location, (n, 6)."""
        names = self.nominal.machine.axis_names
        total = np.zeros((len(position), 6))
        for block in self.blocks:
            if block.arguments[-1] != axis:
                continue
            at = [position[:, names.index(name)] for name in block.arguments]
            for symbol, value in block.motion.items():
                total[:, _MOTIONS.index(symbol[1])] += _interpolate(block, value, at)
        if axis in DIRECTIONS:
            turn = self._find_squareness(axis)
            along = np.cross(turn, DIRECTIONS[axis])
            total[:, :3] += np.outer(position[:, names.index(axis)], along)
        return total

    def _find_squareness(self, axis: str) -> np.ndarray:
        turn = np.zeros(3)
        for symbol, (turned, around) in SQUARENESS.items():
            if turned == axis:
                turn[list(DIRECTIONS).index(around)] = self.constants.get(symbol, 0.0)
        return turn


def read_isg(
    name: str, text: str, machine: MachineFile, rules: Rules
) -> VolumetricCorrection:
    blocks: list[Block] = []
    constants: dict[str, float] = {}
    for head, table in _split_blocks(name, text):
        arguments = tuple(word for word in head if word in machine.axis_names)
        if not arguments:
            constants |= dict(zip(head, table[0].tolist(), strict=True))
        else:
            blocks.append(_make_block(name, head, table, arguments))
    return correct_volume(name, machine, blocks, constants, rules)


def correct_volume(
    name: str,
    machine: MachineFile,
    blocks: Iterable[Block],
    constants: Mapping[str, float],
    rules: Rules,
) -> VolumetricCorrection:
    """Correction by the parameters of a file of either form."""
    turning = [axis.name for axis in machine.rotary_axes]
    known = {*SQUARENESS, *_TOOL, *_TIP}
    known |= {f"{d}0{axis}" for axis in turning for d in _MOTIONS}
    known |= {f"P{d}{axis}" for axis in turning for d in "XYZ"}
    for constant in constants:
        if constant not in known:
            raise SimulatorError(f"{name}: the constant {constant} is not simulated")
    nominal = perfect(_centre_axes(machine, constants))
    return VolumetricCorrection(
        nominal, tuple(blocks), dict(constants), rules.tool_length_mm
    )


def _centre_axes(machine: MachineFile, constants: Mapping[str, float]) -> MachineFile:
    axes = [
        replace(
            axis,
            origin_mm=tuple(
                constants.get(f"P{d}{axis.name}", at)
                for d, at in zip("XYZ", axis.origin_mm, strict=True)
            ),
        )
        if isinstance(axis, RotaryAxis)
        else axis
        for axis in machine.axes
    ]
    return replace(machine, axes=tuple(axes))


def _split_blocks(name: str, text: str) -> Iterator[tuple[list[str], np.ndarray]]:
    lines = [line.partition("//")[0].strip() for line in text.splitlines()]
    for part in "\n".join(lines).split("#"):
        rows = [line.split() for line in part.splitlines() if line]
        if not rows:
            continue
        try:
            yield rows[0], np.array([[float(word) for word in row] for row in rows[1:]])
        except ValueError as error:
            raise SimulatorError(
                f"{name}: the block of {' '.join(rows[0])} is no table ({error})"
            ) from error


def _make_block(
    name: str, head: list[str], table: np.ndarray, arguments: tuple[str, ...]
) -> Block:
    if tuple(head[: len(arguments)]) != arguments or len(arguments) not in (1, 2):
        raise SimulatorError(f"{name}: one or two arguments, then motions: {head}")
    own = arguments[-1]
    symbols = head[len(arguments) :]
    wrong = [s for s in symbols if len(s) != 3 or s[0] != "E" or s[2] != own]
    if wrong:
        raise SimulatorError(f"{name}: {wrong[0]} is no error motion of {own}")
    grid = tuple(np.unique(table[:, k]) for k in range(len(arguments)))
    shape = tuple(len(one) for one in grid)
    if len(table) != np.prod(shape):
        raise SimulatorError(
            f"{name}: error 70471, the data of {own} are not on a grid"
        )
    ordered = table[np.lexsort(table[:, : len(arguments)].T[::-1])]
    motion = {
        symbol: ordered[:, len(arguments) + k].reshape(shape)
        for k, symbol in enumerate(symbols)
    }
    return Block(arguments, grid, motion)


def _interpolate(block: Block, value: np.ndarray, at: list[np.ndarray]) -> np.ndarray:
    """Linear between rows, bilinear for two arguments; end values hold."""
    if len(at) == 1:
        return np.interp(at[0], block.grid[0], value)
    first = block.grid[0]
    lines = np.stack([np.interp(at[1], block.grid[1], row) for row in value])
    if len(first) == 1:
        return lines[0]
    place = np.clip(at[0], first[0], first[-1])
    upper = np.clip(np.searchsorted(first, place), 1, len(first) - 1)
    share = (place - first[upper - 1]) / (first[upper] - first[upper - 1])
    n = np.arange(len(place))
    return (1.0 - share) * lines[upper - 1, n] + share * lines[upper, n]


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
            blocks.append(_make_etalon_block(name, symbol, parameter, machine))
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


def _make_etalon_block(
    name: str, symbol: str, parameter: _Parameter, machine: MachineFile
) -> Block:
    axis = symbol[-1]
    if len(symbol) != 3 or symbol[0] != "E" or axis not in machine.axis_names:
        raise SimulatorError(f"{name}: {symbol} is no error motion of the machine")
    table = np.array(parameter.rows).reshape(-1, 2)
    if not len(table) or (np.diff(table[:, 0]) <= 0.0).any():
        raise SimulatorError(f"{name}: the rows of {symbol} do not ascend")
    return Block((axis,), (table[:, 0],), {symbol: table[:, 1]})
