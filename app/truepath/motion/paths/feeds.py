"""Feeds that a machine can reach, checked before motion."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.nc_programs.programs import LARGEST_FEED_MM_MIN

LEAST_FEED_MM_MIN = 1.0


def check_feeds(machine: Machine, feed_mm_min: Float64[np.ndarray, " n"]) -> None:
    """Raise PlanningError for the first row with an impossible feed."""
    possible = _find_possible(machine, feed_mm_min)
    if not possible.all():
        row = int(np.argmin(possible))
        raise PlanningError(f"row {row + 1}: {_explain(machine, feed_mm_min[row])}")


def check_feed(machine: Machine, feed_mm_min: float | None) -> None:
    """Raise PlanningError for an impossible feed of the whole request."""
    if feed_mm_min is None:
        return
    if not _find_possible(machine, np.array([feed_mm_min])).all():
        raise PlanningError(_explain(machine, feed_mm_min))


def _find_possible(
    machine: Machine, feed_mm_min: Float64[np.ndarray, " n"]
) -> np.ndarray:
    highest = _find_highest(machine)
    return (feed_mm_min >= LEAST_FEED_MM_MIN) & (feed_mm_min <= highest)


def _find_highest(machine: Machine) -> float:
    if "max_feed_mm_min" in machine.motion.assumed:
        return LARGEST_FEED_MM_MIN
    return machine.motion.max_feed_mm_min


def _explain(machine: Machine, feed_mm_min: float) -> str:
    return (
        f"a feed of {feed_mm_min:g} mm/min cannot be driven by {machine.name}; give "
        f"{LEAST_FEED_MM_MIN:g} to {_find_highest(machine):g} mm/min"
    )
