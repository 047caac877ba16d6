"""ISG_CSV of a machine with rotary axes: their motions, locations and centres.

P0X, P0Y, P0Z are the tip at the zero of all axes, PXC, PYC, PZC the centre of the C
axis, X0C … B0C its location (with the digit where we write the letter O), EXC … ECC
tables over degrees. As with linear axes: errors are of the tool relative to the
workpiece, in the directions of the axis, about its centre. No public text says so: to
be tried like the sign. Source: ISG kernel manual, "List of parameters supported",
"Units of measure".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationTables,
    Correction,
)
from truepath.compensation.formats.isg_blocks import (
    Block,
    format_motion,
    interpolate_block,
    read_blocks,
    write_block,
)
from truepath.compensation.rotary_tables import (
    RotaryTable,
)
from truepath.compensation.tables.motion_correction import FindMotion
from truepath.compensation.tables.tool_length import (
    TOOL_SYMBOLS,
    ToolLength,
    compute_tool_mm,
)
from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.effects.error_motion import list_axis_locations
from truepath.kinematics.machine.machine import (
    Machine,
    RotaryAxis,
    compute_local_directions,
)
from truepath.kinematics.machine.symbols import TURNS, is_location, list_error_motions

_TIP = ("P0X", "P0Y", "P0Z")
_MOST_ROWS = 1000


def write_rotary_blocks(content: CompensationTables, tool: ToolLength) -> Iterator[str]:
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
        yield "\n".join(write_block(_take_tool_out(table, offset_mm)))
    for table in content.rotary:
        yield "\n".join(_write_turns(table))


def read_rotary_blocks(text: str, machine: Machine) -> Correction:
    """Minus the error of the chain from all that the blocks contain."""
    blocks = dict(read_blocks(text))
    constants = _take_constants(blocks)
    tip, direction = (
        np.array([constants.get(symbol, 0.0) for symbol in symbols])
        for symbols in (_TIP, TOOL_SYMBOLS)
    )
    location = _find_locations(constants)

    def find_motion(
        axis: str, position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 6"]:
        return interpolate_block(blocks, axis, position_mm, machine)

    tool_mm = tip + abs(compute_tool_mm(machine)[2]) * direction
    return _correct_by_chain(machine, tool_mm, find_motion, location)


def read_places(text: str) -> dict[str, float]:
    """Locations of rotary axes among the constants, mm and rad."""
    return _find_locations(_take_constants(dict(read_blocks(text))))


def _take_constants(blocks: dict[str, Block]) -> dict[str, float]:
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


def _take_tool_out(table: AxisTable, offset_mm: Float64[np.ndarray, "3"]) -> AxisTable:
    """With the target's offset in its arm instead of in E."""
    lever = np.cross(table.rotation_rad, offset_mm)
    return replace(table, translation_mm=table.translation_mm - lever)


def _write_turns(table: RotaryTable) -> Iterator[str]:
    """Rows over the whole travel, since no public text says what repeats."""
    axis, symbols = table.axis, list_error_motions(table.axis.name)
    count = math.ceil((axis.high - axis.low) / table.spacing_deg - 1e-9) + 1
    at = np.linspace(axis.low, axis.high, min(count, _MOST_ROWS))
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


def _correct_by_chain(
    machine: Machine,
    tool_mm: Float64[np.ndarray, "3"],
    find_motion: FindMotion,
    location: Mapping[str, float],
) -> Correction:
    # Minus the error of the chain from all motions and locations. Errors are of the
    # tool relative to the workpiece, those of a rotary axis in its own directions about
    # its origin; the linear axes correct their effect at the tool.
    # `tool_mm` : the tip where all axes are at zero; `location` : by symbol, mm and rad
    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        offset = np.tile(tool_mm, (len(position_mm), 1))
        at = make_standstill(machine, position_mm, offset)
        error = np.zeros((len(at), 3))
        for axis in machine.axes:
            motion = find_motion(axis.name, position_mm, direction)
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


def _find_tool_steps(at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
    # Motion of the tool per mm of each linear axis, as columns
    columns: list[Float64[np.ndarray, "n 3"]] = []
    for name in "XYZ":
        moved = at.position_mm.copy()
        moved[:, at.machine.axis_names.index(name)] += 1.0
        there = make_standstill(at.machine, moved, at.offset_mm)
        columns.append(there.chain.point_mm - at.chain.point_mm)
    return np.stack(columns, axis=2)
