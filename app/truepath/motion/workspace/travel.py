"""Keeps commanded positions inside the travel of the axes.

Straight lines in axis positions never leave a box that holds both of their ends, so
checking the rows checks the whole swept path; arcs are checked at their extreme points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.errors import OutOfTravel
from truepath.kinematics.machine.machine import Axis, Machine, RotaryAxis, position_unit
from truepath.motion.configurations import Commanded
from truepath_drivers.interfaces.arcs import find_reach
from truepath_drivers.interfaces.records import Path

# Rows are written with three or four decimals: a limit may be overrun by the rounding.
ROUNDING = 1e-3
DECIMALS = 4  # of mm and deg: rows survive a CSV file and a controller's counts
_MARGIN, _MARGIN_SHARE = 10.0, 0.02  # mm or deg, of the travel; the less counts


@dataclass(frozen=True, slots=True)
class Breach:
    """A commanded position beyond the travel of an axis.

    index : row of the commanded positions, from 0
    """

    index: int
    axis: Axis
    value: float

    def __str__(self) -> str:
        axis, unit = self.axis, position_unit(self.axis)
        above = self.value > axis.high
        side, limit = ("exceeds", axis.high) if above else ("is below", axis.low)
        return f"{axis.name} = {self.value:.4g} {unit} {side} {limit:.4g} {unit}"


def first_breach(machine: Machine, commanded: Commanded) -> Breach | None:
    """The first row beyond the travel, or None. Every axis must be known."""
    by_name = {axis.name: axis for axis in machine.axes}
    axes = [by_name[name] for name in commanded.axes]
    low, high = np.array([(axis.low, axis.high) for axis in axes]).T
    position, rows = commanded.position, np.arange(len(commanded))
    if isinstance(commanded, Path):
        position, rows = find_reach(commanded)
    outside = (position < low - ROUNDING) | (position > high + ROUNDING)
    if not outside.any():
        return None
    place, column = (int(i) for i in np.argwhere(outside)[0])
    return Breach(int(rows[place]), axes[column], float(position[place, column]))


def inner_travel(
    machine: Machine,
) -> tuple[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]]:
    """Travel of all axes less a margin at both ends, mm or deg.

    Rounded as rows are written. A full turn has no ends, and so no margin.
    """
    low = np.array([axis.low for axis in machine.axes])
    high = np.array([axis.high for axis in machine.axes])
    is_round = [
        isinstance(axis, RotaryAxis) and axis.turns_fully for axis in machine.axes
    ]
    margin = np.minimum(_MARGIN, _MARGIN_SHARE * (high - low))
    margin = np.where(is_round, 0.0, margin)
    return np.round(low + margin, DECIMALS), np.round(high - margin, DECIMALS)


def add_resting_axes(
    machine: Machine, moved: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "n b"]:
    """Adds columns for the last axes, which do not move.

    They are at 0, or at the near end of their travel.
    """
    resting = machine.axes[moved.shape[1] :]
    stand = [min(max(0.0, axis.low), axis.high) for axis in resting]
    return np.hstack([moved, np.tile(stand, (len(moved), 1))])


def check_travel(machine: Machine, commanded: Commanded) -> None:
    """Raise OutOfTravel if a row is beyond the travel or moves an unknown axis.

    Rows are counted from 1. To be called before a plan reaches the machine.
    """
    for name in commanded.axes:
        if name not in machine.axis_names:
            raise OutOfTravel(
                f"the plan moves axis {name}, which {machine.name} does not have; "
                f"its axes are {', '.join(machine.axis_names)}"
            )
    if not np.isfinite(commanded.position).all():
        row, column = np.argwhere(~np.isfinite(commanded.position))[0]
        raise OutOfTravel(
            f"row {row + 1}: {commanded.axes[column]} is not a finite number; "
            "correct the row"
        )
    breach = first_breach(machine, commanded)
    if breach is not None:
        raise OutOfTravel(
            f"row {breach.index + 1}: {breach}; "
            "shorten the plan or correct the travel in the machine file"
        )
