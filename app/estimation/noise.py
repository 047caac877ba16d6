"""The noise of one Run: what the tracker states, corrected by what the data show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations


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


def cell_noise(
    observations: Observations,
    noise: NoiseModel,
    travel: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], Float64[np.ndarray, "n 3"]]:
    """Return precision of the cells' white noise, and the correlated noise's sigma.

    travel : (n, 3) direction of travel in the beam frame, 0 at a standstill
    """
    white, ou = split_sigma_mm(observations, noise)
    return _add_jitter(white**-2, travel, noise.along_sigma_mm), ou


def split_sigma_mm(
    observations: Observations, noise: NoiseModel
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Return standard deviations of a cell: white and correlated, in the beam frame."""
    tracker = observations.at.machine.tracker
    distance = np.linalg.norm(observations.tracker_mm, axis=1)
    stated = tracker.sigma_mm(distance)[:, [0, 1, 1]]
    white, ou = (
        np.array([beam, across, across]) for beam, across in (noise.white, noise.ou)
    )
    return stated * white / np.sqrt(observations.count)[:, None], stated * ou


def _add_jitter(
    precision: Float64[np.ndarray, "n 3"],
    travel: Float64[np.ndarray, "n 3"],
    sigma_mm: float,
) -> Float64[np.ndarray, "n 3 3"]:
    """Return (D + σ² u uᵀ)⁻¹ by Sherman and Morrison; σ = ∞ removes the direction u."""
    matrices = precision[:, :, None] * np.eye(3)
    if sigma_mm == 0.0:
        return matrices
    pulled = precision * travel
    total = np.einsum("ni,ni->n", travel, pulled)
    inverse = 0.0 if np.isinf(sigma_mm) else sigma_mm**-2
    weight = np.where(total > 0.0, 1.0 / np.maximum(inverse + total, 1e-300), 0.0)
    return matrices - weight[:, None, None] * pulled[:, :, None] * pulled[:, None, :]


def floor_mm(
    observations: Observations,
    noise: NoiseModel,
    travel: Float64[np.ndarray, "n 3"],
) -> float:
    """Return the root mean square of one residual component that noise alone makes.

    travel : (n, 3) direction of travel in the beam frame, 0 at a standstill
    """
    white, ou = split_sigma_mm(observations, noise)
    variance = white**2 + ou**2
    if noise.along_sigma_mm == np.inf:
        variance = variance * (1.0 - travel**2)
    else:
        variance = variance + noise.along_sigma_mm**2 * travel**2
    return float(np.sqrt(np.mean(variance)))
