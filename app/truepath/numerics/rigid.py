"""Rigid motions in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, slots=True)
class RigidTransform:
    """p ↦ rotation · p + shift."""

    rotation: Float64[np.ndarray, "3 3"]
    translation_mm: Float64[np.ndarray, "3"]

    def apply(
        self, points_mm: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        return points_mm @ self.rotation.T + self.translation_mm

    def invert(self) -> RigidTransform:
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation_mm)

    def precede_small(
        self,
        rotation_rad: Float64[np.ndarray, "3"],
        translation_mm: Float64[np.ndarray, "3"],
    ) -> RigidTransform:
        """Motion of a small rotation and translation, then of this one."""
        step = build_rotation(rotation_rad)
        return RigidTransform(
            self.rotation @ step, self.rotation @ translation_mm + self.translation_mm
        )


def fit_rigid(
    source_mm: Float64[np.ndarray, "n 3"],
    target_mm: Float64[np.ndarray, "n 3"],
    *,
    mirrored: bool = False,
) -> RigidTransform:
    """Rotate and shift one point set onto another in the least-squares sense.

    source_mm, target_mm : (n, 3), n >= 3, not collinear
    mirrored : fit an improper rotation instead, to detect a left-handed frame

    Umeyama (1991), scale fixed at 1.
    """
    centre_s, centre_t = source_mm.mean(axis=0), target_mm.mean(axis=0)
    H = (target_mm - centre_t).T @ (source_mm - centre_s)
    U, _, Vt = np.linalg.svd(H)
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = U @ np.diag([1.0, 1.0, -sign if mirrored else sign]) @ Vt
    return RigidTransform(R, centre_t - R @ centre_s)


def build_rotation(
    rotation_rad: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, "3 3"]:
    """About the direction of a vector, by its length (Rodrigues)."""
    angle = float(np.linalg.norm(rotation_rad))
    K = cross_matrix(-rotation_rad[None])[0]
    # sinc keeps its digits for the smallest turns.
    sine, half = np.sinc(angle / np.pi), np.sinc(0.5 * angle / np.pi)
    return np.eye(3) + sine * K + 0.5 * half**2 * (K @ K)


def cross_matrix(points_mm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """C with C ω = ω × p for each point."""
    C = np.zeros((len(points_mm), 3, 3))
    x, y, z = points_mm.T
    C[:, 0, 1], C[:, 0, 2] = z, -y
    C[:, 1, 0], C[:, 1, 2] = -z, x
    C[:, 2, 0], C[:, 2, 1] = y, -x
    return C
