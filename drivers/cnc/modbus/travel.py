"""What must not reach the machine: refused before the first byte."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.cnc.modbus.controller_map import Controller
from drivers.cnc.modbus.registers import DWELL_COUNTS, FEED_COUNTS, POSITION_COUNTS
from drivers.interfaces.errors import OutOfTravel, Refused

_HALF_COUNT = 0.5 / POSITION_COUNTS
_LONGEST_DWELL_S = (2**31 - 1) / DWELL_COUNTS


def check_positions(controller: Controller, position: NDArray[np.float64]) -> None:
    """Raise OutOfTravel for the first of (n, axes) positions beyond the travel."""
    if position.ndim != 2 or position.shape[1] != len(controller.axes):
        raise Refused(
            f"positions have {position.shape[-1]} values, the machine has the axes "
            f"{' '.join(controller.axes)}"
        )
    low, high = np.array(controller.travel).T
    # Written so that what is not a number is outside as well.
    inside = (position >= low - _HALF_COUNT) & (position <= high + _HALF_COUNT)
    if inside.all():
        return
    row, axis = np.argwhere(~inside)[0]
    raise OutOfTravel(
        f"row {row}: {controller.axes[axis]} = {position[row, axis]:.4f} is outside "
        f"{low[axis]:.4f} to {high[axis]:.4f}; shorten the path, or check the travel "
        "and the zero of the machine"
    )


def check_feeds(controller: Controller, feed_mm_min: NDArray[np.float64]) -> None:
    """Raise Refused for the first feed that the machine cannot drive."""
    possible = (feed_mm_min >= 1 / FEED_COUNTS) & (
        feed_mm_min <= controller.max_feed_mm_min
    )
    if not possible.all():
        row = int(np.argmin(possible))
        raise Refused(
            f"row {row}: a feed of {feed_mm_min[row]:g} mm/min is not possible; "
            f"up to {controller.max_feed_mm_min:g} are"
        )


def check_dwells(dwell_s: NDArray[np.float64]) -> None:
    """Raise Refused for the first dwell that is negative or endless."""
    possible = (dwell_s >= 0) & (dwell_s <= _LONGEST_DWELL_S)
    if not possible.all():
        row = int(np.argmin(possible))
        raise Refused(f"row {row}: a dwell of {dwell_s[row]:g} s is not possible")
