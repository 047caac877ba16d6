"""Interface of a joint of the truth machine, and rotations from three angles."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np


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
