"""All hidden effects together, as measured by the tracker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.truth_machine import TruthMachine


def locate_target_mm(
    truth: TruthMachine,
    motion: Motion,
    time_s: np.ndarray,
    target: Sequence[str],
    hidden: Sequence[HiddenEffect],
) -> np.ndarray:
    """Target at each time in the frame on which the tracker stands, (n, 3).

    target : (n,) its name at each time
    """
    position = motion.corrected_positions(time_s)
    carry = carry_all(motion, time_s, hidden)
    names = np.array(target)
    point = np.empty((len(time_s), 3))
    for name in set(target):
        mine = names == name
        part = {axis: value[mine] for axis, value in carry.items()}
        point[mine] = truth.locate_target_mm(position[mine], name, part)
    for effect in hidden:
        point += effect.common_shift_mm(motion, time_s)
    return point


def carry_all(
    motion: Motion, time_s: np.ndarray, hidden: Sequence[HiddenEffect]
) -> dict[str, np.ndarray]:
    """Sum of all additions to the error motions of joints, (n, 6) by axis."""
    total: dict[str, np.ndarray] = {}
    for effect in hidden:
        for axis, value in effect.added_error_motions(motion, time_s).items():
            total[axis] = total[axis] + value if axis in total else value
    return total


def misread(polar: np.ndarray, hidden: Sequence[HiddenEffect]) -> np.ndarray:
    """Readings (n, 3) with all effects."""
    return polar + sum((e.reading_error(polar) for e in hidden), np.zeros_like(polar))
