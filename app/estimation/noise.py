"""The noise of one Run: what the tracker states, corrected by what the data show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.numerics.correlated_noise import Whitener, whitener


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """White and Ornstein–Uhlenbeck noise along and across the beam, and feed jitter.

    white : (2,) standard deviation of a sample, in units of the tracker's stated one
    ou : (2,) standard deviation of the Ornstein–Uhlenbeck part, in the same units
    ou_time_s : correlation time of the Ornstein–Uhlenbeck part
    along_sigma_mm : standard deviation of a cell along the travel beyond phase and
        speed; infinite where only deviations across the path are used
    """

    white: tuple[float, float]
    ou: tuple[float, float]
    ou_time_s: float
    along_sigma_mm: float


def whiten(
    seen: Observations,
    noise: NoiseModel,
    frame: Float64[np.ndarray, "n 3 3"],
) -> Whitener:
    """Return the inverse covariance of all cells in the beam frame.

    frame : (n, 3, 3) workpiece to beam frame, rows beam, azimuth, elevation
    """
    precision, ou = cell_noise(seen, noise, frame)
    return whitener(seen.at.time_s, precision, ou, noise.ou_time_s)


def cell_noise(
    seen: Observations,
    noise: NoiseModel,
    frame: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], Float64[np.ndarray, "n 3"]]:
    """Return precision of the cells' white noise and standard deviation of the other.

    frame : (n, 3, 3) workpiece to beam frame, rows beam, azimuth, elevation
    """
    tracker = seen.at.machine.tracker
    stated = tracker.sigma_mm(np.linalg.norm(seen.tracker_mm, axis=1))[:, [0, 1, 1]]
    white = stated * np.array([noise.white[0], noise.white[1], noise.white[1]])
    ou = stated * np.array([noise.ou[0], noise.ou[1], noise.ou[1]])
    precision = seen.count[:, None] / white**2
    along = np.einsum("nij,nj->ni", frame, seen.direction)
    return _with_jitter(precision, along, noise.along_sigma_mm), ou


def _with_jitter(
    precision: Float64[np.ndarray, "n 3"],
    along: Float64[np.ndarray, "n 3"],
    sigma_mm: float,
) -> Float64[np.ndarray, "n 3 3"]:
    """Return (D + σ² u uᵀ)⁻¹ by Sherman and Morrison; σ = ∞ removes the direction u."""
    matrices = precision[:, :, None] * np.eye(3)
    if sigma_mm == 0.0:
        return matrices
    pulled = precision * along
    total = np.einsum("ni,ni->n", along, pulled)
    inverse = 0.0 if np.isinf(sigma_mm) else sigma_mm**-2
    weight = np.where(total > 0.0, 1.0 / np.maximum(inverse + total, 1e-300), 0.0)
    return matrices - weight[:, None, None] * pulled[:, :, None] * pulled[:, None, :]


def floor_mm(
    seen: Observations, noise: NoiseModel, along: Float64[np.ndarray, "n 3"]
) -> float:
    """Return the root mean square of one residual component that noise alone makes.

    along : (n, 3) direction of travel in the beam frame, 0 at a standstill
    """
    distance = np.linalg.norm(seen.tracker_mm, axis=1)
    stated = seen.at.machine.tracker.sigma_mm(distance)[:, [0, 1, 1]]
    white = stated * np.array([noise.white[0], noise.white[1], noise.white[1]])
    ou = stated * np.array([noise.ou[0], noise.ou[1], noise.ou[1]])
    variance = white**2 / seen.count[:, None] + ou**2
    if noise.along_sigma_mm == np.inf:
        variance = variance * (1.0 - along**2)
    else:
        variance = variance + noise.along_sigma_mm**2 * along**2
    return float(np.sqrt(np.mean(variance)))
