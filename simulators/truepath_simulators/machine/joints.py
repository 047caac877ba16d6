"""Axes of the truth machine: exact transforms.

A rotary axis sits on a frame that faces the base. With R the turn about the nominal
axis, G the rigid motion from the nominal axis to the actual one, and M(c) the error
motions,

    tool side:       T(c) = M(c) G R(c) G^-1,
    workpiece side:  T(c) = G R(-c) G^-1 M(c),

so that T is the identity at the axis zero, and M is in either case in the directions of
the frame facing the base, about the axis' origin, of the tool relative to the
workpiece. Symbols name local directions: the machine's, turned the shortest way so that
the letter of the axis is its direction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from truepath_simulators.machine.error_motions import (
    ErrorMotion,
    JointedMotion,
    TurningMotion,
)
from truepath_simulators.machine_file import ROTARY_DIRECTIONS, RotaryAxis


class Joint(ABC):
    """One axis of the chain."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Letter of the axis."""

    @abstractmethod
    def actual(self, position: np.ndarray) -> np.ndarray:
        """Transforms with errors, (n, 4, 4), at positions (n,)."""

    @abstractmethod
    def nominal(self, position: np.ndarray) -> np.ndarray:
        """Transforms without errors, (n, 4, 4), at positions (n,)."""

    @abstractmethod
    def carry(self, transform: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Transforms with further error motions (n, 6), in mm and rad."""


def rotation_matrices(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rz(c) Ry(b) Rx(a), (n, 3, 3), for angles (n,) in rad."""
    ca, sa, cb, sb, cc, sc = (f(x) for x in (a, b, c) for f in (np.cos, np.sin))
    rows = [
        [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


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


@dataclass(frozen=True, slots=True)
class RotaryJoint(Joint):
    """A rotary axis with six error motions and its location.

    on_workpiece : on the workpiece side of the base
    translation, rotation : error motions along and about local X, Y, Z, in mm and rad
    shift_mm, tilt_rad : location in local X, Y, Z; nothing along the axis itself
    """

    axis: RotaryAxis
    on_workpiece: bool
    translation: tuple[TurningMotion, ...]
    rotation: tuple[TurningMotion, ...]
    shift_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    tilt_rad: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def name(self) -> str:
        return self.axis.name

    def actual(self, position: np.ndarray) -> np.ndarray:
        """T(c) with errors, (n, 4, 4), at positions in deg."""
        place = self._express_about_origin(
            rotation_matrices(*(np.array([turn]) for turn in self.tilt_rad)),
            np.array([self.shift_mm]),
        )
        motion = self._express_about_origin(
            rotation_matrices(*(motion.at(position) for motion in self.rotation)),
            np.stack([motion.at(position) for motion in self.translation], axis=1),
        )
        turn = place @ self.nominal(position) @ np.linalg.inv(place)
        return self._join(turn, motion)

    def nominal(self, position: np.ndarray) -> np.ndarray:
        """R(c) on the tool side, R(-c) on the workpiece side."""
        angle = np.radians(position) * (-1.0 if self.on_workpiece else 1.0)
        d = np.array(self.axis.direction)
        across = np.cross(d, np.eye(3)).T  # across @ v = d x v
        sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
        turn = np.eye(3) + sine * across + (1.0 - cosine) * (across @ across)
        return _about(np.array(self.axis.origin_mm), turn, np.zeros((1, 3)))

    def carry(self, transform: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Transforms with further error motions, about the axis' origin."""
        turns = rotation_matrices(*motions[:, 3:].T)
        return self._join(transform, self._express_about_origin(turns, motions[:, :3]))

    def _join(self, turn: np.ndarray, motion: np.ndarray) -> np.ndarray:
        return turn @ motion if self.on_workpiece else motion @ turn

    def _express_about_origin(self, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
        frame = local_frame(self.axis)
        turn, shift = frame @ turn @ frame.T, shift @ frame.T
        return _about(np.array(self.axis.origin_mm), turn, shift)


def local_frame(axis: RotaryAxis) -> np.ndarray:
    """Local X, Y, Z as columns: the shortest turn of the letter's direction."""
    letter = np.array(ROTARY_DIRECTIONS[axis.name])
    direction = np.array(axis.direction)
    normal, cosine = np.cross(letter, direction), float(letter @ direction)
    if cosine < -1.0 + 1e-12:  # half a turn about the next direction
        half = np.roll(letter, 1)
        return 2.0 * np.outer(half, half) - np.eye(3)
    across = np.cross(normal, np.eye(3)).T
    return np.eye(3) + across + across @ across / (1.0 + cosine)


def _about(origin: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Transform p -> origin + turn (p - origin) + shift."""
    n = max(len(turn), len(shift))
    transform = np.zeros((n, 4, 4))
    transform[:, :3, :3] = turn
    transform[:, :3, 3] = origin - turn @ origin + shift
    transform[:, 3, 3] = 1.0
    return transform
