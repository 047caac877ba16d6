"""A path as words of the register map: its rows, its arcs and their CRC."""

from __future__ import annotations

import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.cnc.modbus.registers import (
    DWELL_COUNTS,
    FEED_COUNTS,
    MAX_AXES,
    POSITION_COUNTS,
)
from truepath_drivers.interfaces.records import Path


def path_words(path: Path) -> NDArray[np.uint16]:
    """Rows of a path in the map's format, (n, 16)."""
    rows = np.zeros((len(path), MAX_AXES + 2), ">i4")
    axes = path.position.shape[1]
    rows[:, :axes] = np.rint(path.position * POSITION_COUNTS)
    # Feed and dwell are u32; neither can reach the sign bit within its limits.
    rows[:, MAX_AXES] = np.rint(path.feed_mm_min * FEED_COUNTS)
    rows[:, MAX_AXES + 1] = np.rint(path.dwell_s * DWELL_COUNTS)
    return rows.view(">u2").astype(np.uint16)


def arc_words(path: Path) -> dict[int, NDArray[np.uint16]]:
    """Arcs of a path in the map's format, (16,) each, by row.

    The centre takes the place of a position, 0 for other axes, the turn in 0.0001 deg
    that of the feed, and the numbers of both axes that of the dwell.
    """
    found: dict[int, NDArray[np.uint16]] = {}
    for row, arc in enumerate(path.arc):
        if arc is None:
            continue
        first, second = (path.axes.index(name) for name in arc.axes)
        values = np.zeros(MAX_AXES + 2, ">i4")
        values[[first, second]] = np.rint(np.array(arc.centre_mm) * POSITION_COUNTS)
        values[MAX_AXES] = round(arc.turn_deg * POSITION_COUNTS)
        values[MAX_AXES + 1] = first << 16 | second
        found[row] = values.view(">u2").astype(np.uint16)
    return found


def path_crc(
    words: NDArray[np.uint16], arcs: Mapping[int, NDArray[np.uint16]] | None = None
) -> int:
    """CRC-32 (zlib's) of rows, over their bytes in wire order.

    arcs : by row; each follows, its row first, in their order
    """
    crc = zlib.crc32(words.astype(">u2").tobytes())
    for row, arc in sorted((arcs or {}).items()):
        crc = zlib.crc32(np.append(row, arc).astype(">u2").tobytes(), crc)
    return crc
