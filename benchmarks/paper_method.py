"""The solve of sanders-2023 (eq. 1–7, 12), dense as printed, its errors corrected.

Corrected: eq. 1 takes b − (b·a₁)a₁; eq. 4 weighs by the beam direction b, not by the
path direction d, for which every weight collapses. W, P and C are square in all points,
as in the paper; the error tables are linear between their entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.sequence import fit_rigid
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.machine.symbols import list_error_motions


@dataclass(frozen=True)
class PaperTables:
    """Table entries U of eq. 7 with their covariance (eq. 12)."""

    columns: tuple[tuple[str, np.ndarray], ...]
    entries: np.ndarray
    covariance: np.ndarray


def solve(seen: Observations, spacing_mm: float) -> PaperTables:
    point = _fine_aligned(seen)
    columns, MB = _table_matrix(seen, spacing_mm)
    deviation = (point - seen.at.point_mm).reshape(-1)
    P, W, C = _frames_weights_covariance(seen)
    A = W @ (P @ MB)
    inverse = np.linalg.pinv(A)
    entries = inverse @ (W @ (P @ deviation))
    spread = inverse @ (W @ P)
    return PaperTables(columns, entries, spread @ C @ spread.T)


def error_mm(tables: PaperTables, seen_at) -> np.ndarray:
    MB = _rows(seen_at, tables.columns)
    return (MB.reshape(-1, MB.shape[2]) @ tables.entries).reshape(-1, 3)


def _fine_aligned(seen: Observations) -> np.ndarray:
    """Fit points to the closest points of their lines, again and again (1.2.3)."""
    pose = seen.pose
    for _ in range(20):
        point = pose.invert().apply(seen.tracker_mm)
        off = point - seen.at.point_mm
        along = np.einsum("ni,ni->n", off, seen.direction)
        closest = seen.at.point_mm + along[:, None] * seen.direction
        pose = fit_rigid(closest, seen.tracker_mm)
    return pose.invert().apply(seen.tracker_mm)


def _table_matrix(seen: Observations, spacing_mm: float):
    columns = []
    for axis in seen.at.machine.linear_axes:
        count = round((axis.high - axis.low) / spacing_mm) + 1
        knots = np.linspace(axis.low, axis.high, count)
        columns += [(symbol, knots) for symbol in list_error_motions(axis.name)]
    rows = _rows(seen.at, columns)
    return tuple(columns), rows.reshape(-1, rows.shape[2])


def _rows(at, columns) -> np.ndarray:
    parts = []
    for symbol, knots in columns:
        arm = compute_arm(symbol, at)
        hats = _hats(at.axis_mm(symbol[2]), knots)
        parts.append(arm[:, :, None] * hats[:, None, :])
    return np.concatenate(parts, axis=2)


def _hats(position_mm: np.ndarray, knots: np.ndarray) -> np.ndarray:
    left = np.clip(np.searchsorted(knots, position_mm) - 1, 0, len(knots) - 2)
    share = (position_mm - knots[left]) / (knots[left + 1] - knots[left])
    rows = np.zeros((len(position_mm), len(knots)))
    n = np.arange(len(position_mm))
    rows[n, left], rows[n, left + 1] = 1.0 - share, share
    return rows


def _frames_weights_covariance(seen: Observations):
    n = len(seen)
    place = seen.pose.invert().translation_mm
    beam = seen.at.point_mm - place
    distance = np.linalg.norm(beam, axis=1)
    beam /= distance[:, None]
    sigma = seen.at.machine.tracker.sigma_mm(distance)
    first = seen.direction
    second = beam - np.einsum("ni,ni->n", beam, first)[:, None] * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    third = np.cross(first, second)
    P, W, C = (np.zeros((3 * n, 3 * n)) for _ in range(3))
    for k in range(n):
        block = slice(3 * k, 3 * k + 3)
        P[block, block] = first[k], second[k], third[k]
        for j, axis in ((1, second[k]), (2, third[k])):
            share = (axis @ beam[k]) ** 2
            variance = sigma[k, 0] ** 2 * share + sigma[k, 1] ** 2 * (1.0 - share)
            W[3 * k + j, 3 * k + j] = 1.0 / np.sqrt(variance)
        across = np.eye(3) - np.outer(beam[k], beam[k])
        C[block, block] = (
            sigma[k, 0] ** 2 * np.outer(beam[k], beam[k]) + sigma[k, 1] ** 2 * across
        )
    return P, W, C
