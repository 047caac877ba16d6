"""A linear axis of the truth machine: exact transforms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath_simulators.machine.error_motions import ErrorMotion, JointedMotion
from truepath_simulators.machine.joint import Joint, rotation_matrices


@dataclass(frozen=True, slots=True)
class LinearJoint(Joint):
    """A linear axis with six error motions.

    axis : its letter
    nominal_direction, direction : unit vectors of travel, without and with squareness
        error
    translation : error motions along X, Y, Z, in mm
    rotation : error motions about X, Y, Z, in rad
    """

    axis: str
    nominal_direction: tuple[float, ...]
    direction: tuple[float, ...]
    translation: tuple[ErrorMotion | JointedMotion, ...]
    rotation: tuple[ErrorMotion, ...]

    @property
    def name(self) -> str:
        """Letter of the axis."""
        return self.axis

    def actual(self, position: np.ndarray) -> np.ndarray:
        """Trans(s d) Trans(E) Rz(EC) Ry(EB) Rx(EA)."""
        transform = np.zeros((len(position), 4, 4))
        transform[:, :3, :3] = rotation_matrices(
            *(motion.at(position) for motion in self.rotation)
        )
        transform[:, :3, 3] = np.outer(position, self.direction)
        for k, motion in enumerate(self.translation):
            transform[:, k, 3] += motion.at(position)
        transform[:, 3, 3] = 1.0
        return transform

    def nominal(self, position: np.ndarray) -> np.ndarray:
        """Trans(s e)."""
        transform = np.broadcast_to(np.eye(4), (len(position), 4, 4)).copy()
        transform[:, :3, 3] = np.outer(position, self.nominal_direction)
        return transform

    def carry(self, transform: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Transforms with further error motions: shifts before, turns after."""
        moved = transform.copy()
        moved[:, :3, :3] = moved[:, :3, :3] @ rotation_matrices(*motions[:, 3:].T)
        moved[:, :3, 3] += motions[:, :3]
        return moved
