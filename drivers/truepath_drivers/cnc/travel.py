"""Checks of commands, before the first byte is sent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.arcs import describe_bad_arc, find_reach
from truepath_drivers.interfaces.errors import OutOfTravel, Refused
from truepath_drivers.interfaces.records import Path

# Half of the finest step that both wires print, 0.1 µm or 0.0001 deg.
_HALF_STEP = 0.5e-4


def arrange_path(path: Path, axes: tuple[str, ...], *, drives_arcs: bool) -> Path:
    """A path in the axis order of a machine.

    drives_arcs : whether the control does

    Raises Refused for other axes, and for arcs where it does not.
    """
    if any(path.arc) and not drives_arcs:
        raise Refused(
            "the path has arcs, which this control does not offer; measure circles at "
            "standstills"
        )
    if sorted(path.axes) != sorted(axes):
        raise Refused(
            f"the path has the axes {' '.join(path.axes)}, the machine {' '.join(axes)}"
        )
    order = [path.axes.index(axis) for axis in axes]
    arc = (None, *path.arc[1:]) if path.arc else ()
    return replace(path, axes=axes, position=path.position[:, order], arc=arc)


def check_arcs(path: Path, travel: Sequence[tuple[float, float]]) -> None:
    """Raise Refused for the first arc that does not end at its row.

    Raises OutOfTravel for one that leaves the travel.
    """
    for row, arc in enumerate(path.arc):
        if arc is None or row == 0:
            continue
        begin, end = path.position[row - 1], path.position[row]
        problem = describe_bad_arc(path.axes, begin, end, arc)
        if problem:
            raise Refused(f"row {row + 1} {problem}")
    low, high = np.array(travel).T
    position, rows = find_reach(path)
    inside = (position >= low - _HALF_STEP) & (position <= high + _HALF_STEP)
    if not inside.all():
        place, axis = np.argwhere(~inside)[0]
        raise OutOfTravel(
            f"row {rows[place] + 1}: on its arc {path.axes[axis]} comes to "
            f"{position[place, axis]:.4f}, outside {low[axis]:.4f} to {high[axis]:.4f}"
        )


def check_positions(
    axes: tuple[str, ...],
    travel: Sequence[tuple[float, float]],
    position: NDArray[np.float64],
) -> None:
    """Raise OutOfTravel for the first of (n, axes) positions beyond the travel."""
    if position.ndim != 2 or position.shape[1] != len(axes):
        raise Refused(
            f"positions have {position.shape[-1]} values, the machine has the axes "
            f"{' '.join(axes)}"
        )
    low, high = np.array(travel).T
    # Written so that what is not a number is outside as well.
    inside = (position >= low - _HALF_STEP) & (position <= high + _HALF_STEP)
    if inside.all():
        return
    row, axis = np.argwhere(~inside)[0]
    raise OutOfTravel(
        f"row {row + 1}: {axes[axis]} = {position[row, axis]:.4f} is outside "
        f"{low[axis]:.4f} to {high[axis]:.4f}; shorten the path, or check the travel "
        "and the zero of the machine"
    )


def check_feeds(
    feed_mm_min: NDArray[np.float64], least_mm_min: float, most_mm_min: float
) -> None:
    """Raise Refused for the first feed outside the machine's limits."""
    possible = (feed_mm_min >= least_mm_min) & (feed_mm_min <= most_mm_min)
    if not possible.all():
        row = int(np.argmin(possible))
        raise Refused(
            f"row {row + 1}: a feed of {feed_mm_min[row]:g} mm/min is not possible; "
            f"up to {most_mm_min:g} are"
        )


def check_dwells(dwell_s: NDArray[np.float64], longest_s: float) -> None:
    """Raise Refused for the first dwell that is negative or too long."""
    possible = (dwell_s >= 0) & (dwell_s <= longest_s)
    if not possible.all():
        row = int(np.argmin(possible))
        raise Refused(f"row {row + 1}: a dwell of {dwell_s[row]:g} s is not possible")
