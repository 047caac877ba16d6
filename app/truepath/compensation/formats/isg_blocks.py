"""Blocks of ISG_CSV: one or two arguments, then the six error motions of an axis.

Or constants, names over one row of numbers. Source: ISG kernel manual.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import AxisTable
from truepath.compensation.tables.motion_correction import interpolate_rows
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import (
    LINEAR,
    TURNS,
    is_turn,
    list_error_motions,
)

AXES = (*LINEAR, *TURNS)
Block = tuple[str, Float64[np.ndarray, "r c"]]
"""Second axis, empty for one argument; rows of positions and six motions."""


def write_block(table: AxisTable) -> Iterator[str]:
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


def format_motion(symbol: str, value: float) -> str:
    """In mm or rad as the control reads them, to a nanometre and a nanoradian."""
    return f"{value:z.9f}" if is_turn(symbol) else f"{value:z.6f}"


def interpolate_block(
    blocks: Mapping[str, Block],
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


def read_blocks(text: str) -> Iterator[tuple[str, Block]]:
    """Axis and block; for constants their names, joined by blanks, and one row.

    Raises BadInput for any other block.
    """
    lines = [line for line in text.splitlines() if not line.startswith("//")]
    for block in "\n".join(lines).split("#"):
        head, *rows = [line.split() for line in block.splitlines() if line.strip()]
        by = head.pop(0) if len(head) > 1 and head[1] in AXES else ""
        axis = head[0]
        if axis not in AXES and len(rows) == 1:
            yield " ".join(head), ("", np.array([[float(word) for word in rows[0]]]))
            continue
        if head[1:] != list(list_error_motions(axis)):
            raise BadInput(f"the block of {axis} does not have its six motions")
        yield axis, (by, np.array([[float(word) for word in row] for row in rows]))
