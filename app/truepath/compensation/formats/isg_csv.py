"""ISG kernel and Beckhoff TF5280: volumetric compensation by error motions (ISG_CSV).

Blocks of an argument and the motions of an axis, mm and rad, split by `#`. Squareness
is in the straightness, the target's offset in the displacements, so that lever arms
count from the zero of the axes and the tool length is 0; or that of the tool in use
(`tool_length`). The controller computes the tool point of the chain and subtracts the
error; the sign at the machine has to be tried (it has a switch `negate`). A guide that
bends under another axis has a block of two arguments, the other axis first, on a grid.

With rotary axes P0X, P0Y, P0Z are the tip at the zero of all axes, PXC, PYC, PZC the
centre of the C axis, X0C … B0C its location (with the digit where we write the letter
O), EXC … ECC tables over degrees. As with linear axes: errors are of the tool relative
to the workpiece, in the directions of the axis, about its centre. No public text says
so: to be tried like the sign. Source: ISG kernel manual, volumetric compensation, "List
of parameters supported", "Units of measure".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    Files,
    RotaryAxisLocation,
    RotaryTable,
    list_stated_locations,
)
from truepath.compensation.tables.motion_correction import (
    TOOL_SYMBOLS,
    ToolLength,
    add_tool,
    compute_tool_mm,
    correct_by_motions,
    format_motion,
    interpolate_rows,
    remove_tool,
)
from truepath.errors import BadInput
from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.effects.error_motion import list_axis_locations
from truepath.kinematics.machine.machine import (
    Machine,
    RotaryAxis,
    compute_local_directions,
)
from truepath.kinematics.machine.symbols import (
    LINEAR,
    TURNS,
    is_location,
    list_error_motions,
)

_AXES = (*LINEAR, *TURNS)
_Block = tuple[str, Float64[np.ndarray, "r c"]]
"""Second axis, empty for one argument; rows of positions and six motions."""
_TIP = ("P0X", "P0Y", "P0Z")


class IsgCsv(CompensationFormat):
    """All error motions of all linear axes, one file."""

    control = "ISG kernel, Beckhoff TF5280"
    suffix = ".csv"
    most_points = 1000
    carries = (
        "all error motions and squareness, with their lever arms in the whole volume; "
        "of each axis what it does with one other one, as sag; rotary axes with their "
        "locations, the position of the tool alone"
    )
    not_carried = "backlash and what depends on direction"
    units = "mm and rad, positions mm"
    composes_rotary = True
    sign = "the file has the errors; the controller takes them away"
    sign_is_verified = False
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = ToolLength.choices

    def __init__(self, tool_length: str = "fixed") -> None:
        self._tool = ToolLength(tool_length)
        self.note = (
            "file_format ISG_CSV, Interpolation GRID, the kinematic chain as it stands "
            f"in the second line; {self._tool.note}. With rotary axes the tip at zero "
            "is in P0X, P0Y, P0Z and the centre of C in PXC, PYC, PZC: try one angle "
            "first"
        )

    def write(self, content: CompensationTables) -> dict[str, str]:
        """One file with a block per axis."""
        write_blocks = _write_linear_blocks
        if content.machine.rotary_axes:
            write_blocks = _write_rotary_blocks
        comments = (f"// {line}" for line in content.stamp)
        blocks = "\n#\n".join(write_blocks(content, self._tool))
        text = "\n".join([*comments, blocks, ""])
        return {f"{content.stem}{self.suffix}": text}

    def read(self, files: Files, machine: Machine) -> Correction:
        """Minus the error of the chain from the motions."""
        (text,) = files.values()
        if machine.rotary_axes:
            return _read_rotary_blocks(text, machine)
        blocks = dict(_read_blocks(text))
        tool = blocks.pop(" ".join(TOOL_SYMBOLS), ("", np.zeros((1, 3))))[1][0]
        if unknown := [name for name in blocks if name not in machine.axis_names]:
            raise BadInput(f"no axis of the machine has the parameter {unknown[0]}")

        def find_motion(
            axis: str, position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 6"]:
            motion = _interpolate_block(blocks, axis, position_mm, machine)
            return add_tool(motion, tool, machine)

        return correct_by_motions(machine, blocks, find_motion)

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """All locations that the result has."""
        del machine
        return list_stated_locations(places)

    def read_locations(self, files: Files, machine: Machine) -> dict[str, float]:
        """Locations of rotary axes among the constants, mm and rad."""
        (text,) = files.values()
        if not machine.rotary_axes:
            return {}
        return _find_locations(_pop_constants(dict(_read_blocks(text))))


def _write_linear_blocks(
    content: CompensationTables, tool: ToolLength
) -> Iterator[str]:
    if direction := tool.find_direction(content.machine):
        numbers = "  ".join(map(str, direction))
        yield "\n".join(["  ".join(TOOL_SYMBOLS), numbers])
    for table in tool.shorten(content.tables, content.machine):
        yield "\n".join(_write_block(table))


def _write_block(table: AxisTable) -> Iterator[str]:
    """Lines of an axis; two arguments where it has a table of a pair."""
    symbols, pair = list_error_motions(table.axis.name), table.pair
    motions = np.hstack([table.translation_mm, table.rotation_rad])
    if pair is None:
        yield "  ".join([table.axis.name, *symbols])
        yield from _write_rows(table, motions)
        return
    yield "  ".join([pair.by.name, table.axis.name, *symbols])
    for by, error in zip(pair.by_mm, pair.error_mm, strict=True):
        total = motions + np.hstack([error, np.zeros_like(error)])
        yield from (f"{by:.6f}  {row}" for row in _write_rows(table, total))


def _write_rows(table: AxisTable, motions: Float64[np.ndarray, "n 6"]) -> Iterator[str]:
    symbols = list_error_motions(table.axis.name)
    for at, row in zip(table.position_mm, motions, strict=True):
        values = zip(symbols, row, strict=True)
        numbers = [format_motion(symbol, value) for symbol, value in values]
        yield "  ".join([f"{at:.6f}", *numbers])


def _interpolate_block(
    blocks: Mapping[str, _Block],
    axis: str,
    position_mm: Float64[np.ndarray, "n a"],
    machine: Machine,
) -> Float64[np.ndarray, "n 6"]:
    """Motions of an axis at positions of all; 0 for an axis without a block."""
    if axis not in blocks:
        return np.zeros((len(position_mm), 6))
    at = position_mm[:, machine.axis_names.index(axis)]
    by, rows = blocks[axis]
    if not by:
        return interpolate_rows(rows, at)
    return _interpolate_grid(rows, position_mm[:, machine.axis_names.index(by)], at)


def _interpolate_grid(
    table: Float64[np.ndarray, "r 8"],
    by_mm: Float64[np.ndarray, " n"],
    at_mm: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "n 6"]:
    places = np.unique(table[:, 0])
    lines = [
        interpolate_rows(table[table[:, 0] == place, 1:], at_mm) for place in places
    ]
    high = np.clip(np.searchsorted(places, by_mm), 1, len(places) - 1)
    share = (by_mm - places[high - 1]) / (places[high] - places[high - 1])
    share = np.clip(share, 0.0, 1.0)[:, None]
    each, n = np.stack(lines), np.arange(len(at_mm))
    return (1.0 - share) * each[high - 1, n] + share * each[high, n]


def _read_blocks(text: str) -> Iterator[tuple[str, _Block]]:
    """Axis and block; for constants their names, joined by blanks, and one row.

    Raises BadInput for any other block.
    """
    lines = [line for line in text.splitlines() if not line.startswith("//")]
    for block in "\n".join(lines).split("#"):
        head, *rows = [line.split() for line in block.splitlines() if line.strip()]
        by = head.pop(0) if len(head) > 1 and head[1] in _AXES else ""
        axis = head[0]
        if axis not in _AXES and len(rows) == 1:
            yield " ".join(head), ("", np.array([[float(word) for word in rows[0]]]))
            continue
        if head[1:] != list(list_error_motions(axis)):
            raise BadInput(f"the block of {axis} does not have its six motions")
        yield axis, (by, np.array([[float(word) for word in row] for row in rows]))


def _write_rotary_blocks(
    content: CompensationTables, tool: ToolLength
) -> Iterator[str]:
    """Constants of tool and rotary axes, then a block per axis."""
    machine = content.machine
    if direction := tool.find_direction(machine):
        along = map(float, direction)
        yield _write_constants(dict(zip(TOOL_SYMBOLS, along, strict=True)))
    yield _write_constants(dict(zip(_TIP, tool.find_tip(machine), strict=True)))
    for place in content.places:
        own = place.axis.name
        centre = zip("XYZ", place.axis.origin_mm, strict=True)
        yield _write_constants({f"P{d}{own}": value for d, value in centre})
        if place.location:
            yield _write_constants(
                {f"{s[0]}0{s[2]}": v for s, v in place.location.items()}
            )
    offset_mm = np.array(machine.target().offset_mm, float)
    for table in content.tables:
        yield "\n".join(_write_block(remove_tool(table, offset_mm)))
    for table in content.rotary:
        yield "\n".join(_write_rotary_block(table))


def _read_rotary_blocks(text: str, machine: Machine) -> Correction:
    """Minus the error of the chain from all motions and locations.

    Errors are of the tool relative to the workpiece, those of a rotary axis in its own
    directions about its origin; the linear axes correct their effect at the tool.
    """
    blocks = dict(_read_blocks(text))
    constants = _pop_constants(blocks)
    location = _find_locations(constants)
    tip, along = (
        np.array([constants.get(symbol, 0.0) for symbol in symbols])
        for symbols in (_TIP, TOOL_SYMBOLS)
    )
    tool_mm = tip + abs(compute_tool_mm(machine)[2]) * along

    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        offset = np.tile(tool_mm, (len(position_mm), 1))
        at = make_standstill(machine, position_mm, offset)
        error = np.zeros((len(at), 3))
        for axis in machine.axes:
            motion = _interpolate_block(blocks, axis.name, position_mm, machine)
            local = np.eye(3)
            if isinstance(axis, RotaryAxis):
                local = compute_local_directions(axis)
                for one in list_axis_locations(axis):
                    if value := location.get(one.symbol):
                        error += one.jacobian(at)[:, :, 0] * value
            lever = at.chain.lever(axis.name)
            error += lever.displace(motion[:, :3] @ local.T, is_turn=False)
            error += lever.displace(motion[:, 3:] @ local.T, is_turn=True)
        return -np.linalg.solve(_find_tool_steps(at), error[:, :, None])[:, :, 0]

    return correction


def _pop_constants(blocks: dict[str, _Block]) -> dict[str, float]:
    constants: dict[str, float] = {}
    for names in [name for name in blocks if len(name) > 1]:
        (row,) = blocks.pop(names)[1]
        constants |= dict(zip(names.split(), row.tolist(), strict=True))
    return constants


def _find_locations(constants: Mapping[str, float]) -> dict[str, float]:
    return {
        symbol: value
        for name, value in constants.items()
        if is_location(symbol := f"{name[0]}{name[1].replace('0', 'O')}{name[2]}")
    }


def _write_constants(values: dict[str, float]) -> str:
    numbers = (
        f"{value:z.9f}" if name[0] in TURNS else f"{value:z.6f}"
        for name, value in values.items()
    )
    return "\n".join(["  ".join(values), "  ".join(numbers)])


def _write_rotary_block(table: RotaryTable) -> Iterator[str]:
    """Rows over the whole travel, since no public text says what repeats."""
    axis, symbols = table.axis, list_error_motions(table.axis.name)
    count = math.ceil((axis.high - axis.low) / table.spacing_deg - 1e-9) + 1
    at = np.linspace(axis.low, axis.high, min(count, 1000))
    period = 360.0 if axis.turns_fully else None
    columns: list[Float64[np.ndarray, " r"]] = [
        np.interp(at, table.position_deg, table.motions[:, k], period=period)
        for k in range(table.motions.shape[1])
    ]
    yield "  ".join([axis.name, *symbols])
    for k, place in enumerate(at):
        row = [float(column[k]) for column in columns]
        numbers = [format_motion(s, v) for s, v in zip(symbols, row, strict=True)]
        yield "  ".join([f"{place:.6f}", *numbers])


def _find_tool_steps(at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
    # Motion of the tool per mm of each linear axis, as columns
    columns: list[Float64[np.ndarray, "n 3"]] = []
    for name in "XYZ":
        moved = at.position_mm.copy()
        moved[:, at.machine.axis_names.index(name)] += 1.0
        there = make_standstill(at.machine, moved, at.offset_mm)
        columns.append(there.chain.point_mm - at.chain.point_mm)
    return np.stack(columns, axis=2)
