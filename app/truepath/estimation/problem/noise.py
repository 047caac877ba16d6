"""The noise of one Run: the tracker's specification, corrected by the data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.reduction import USUAL_OU
from truepath.kinematics.machine.tracker_noise import TrackerNoise

_OF_SHOWN = 1.15
_MOST_OU, _LONGEST_OU_S = 0.3, 2.0  # of the specified noise: tests detect more


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """White and Ornstein–Uhlenbeck noise along and across the beam, and feed jitter.

    white : (2,) standard deviation of a sample, in units of the tracker's specified one
    ou : (3,) standard deviation of the Ornstein–Uhlenbeck part along the beam, in
        azimuth and in elevation, in the same units
    ou_time_s : correlation time of the Ornstein–Uhlenbeck part
    along_sigma_mm : standard deviation of a cell along the travel beyond phase and
        speed; infinite where only deviations across the path are used, as on ramps
    fast : (2,) ratio of the scatter of cell means to that expected from their samples
    shown : (3,) Ornstein–Uhlenbeck part by neighbours in space on different lines
    ramp_sigma_mm : standard deviation of a cell on a ramp beyond that of other cells
    place : (3,) further standard deviation between standstills along the beam, in
        azimuth and in elevation, in units of the specified noise
    """

    white: tuple[float, float]
    ou: tuple[float, float, float]
    ou_time_s: float
    along_sigma_mm: float
    ramp_sigma_mm: float = 0.0
    fast: tuple[float, float] = (1.0, 1.0)
    shown: tuple[float, float, float] = (0.0, 0.0, 0.0)
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def ou_along_and_across(self) -> tuple[float, float]:
        """Ornstein–Uhlenbeck part along and across the beam, root mean square."""
        along, azimuth, elevation = self.ou
        return along, float(np.hypot(azimuth, elevation)) / 2.0**0.5

    @property
    def typical(self) -> NoiseModel:
        """Specified white and typical correlated noise, with this feed jitter."""
        ou, place = (USUAL_OU, USUAL_OU, USUAL_OU), (0.0, 0.0, 0.0)
        return replace(self, white=(1.0, 1.0), ou=ou, place=place)

    @property
    def typical_with_places(self) -> NoiseModel:
        """The same, with the noise between places as it was found."""
        return replace(self.typical, place=self.place)


def cell_noise(
    observations: Observations,
    noise: NoiseModel,
    travel: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, "n 3 3"], Float64[np.ndarray, "n 3"]]:
    """Precision of the cells' white noise, and sigma of the correlated noise.

    travel : (n, 3) direction of travel in the beam frame, 0 at a standstill
    """
    white, ou = split_sigma_mm(observations, noise)
    return _add_jitter(white**-2, travel, _along_mm(observations, noise)), ou


def total_precision(
    observations: Observations,
    noise: NoiseModel,
    travel: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n 3 3"]:
    """Precision of each cell alone, correlated noise included.

    travel : (n, 3) direction of travel in the beam frame, 0 at a standstill
    """
    white, ou = split_sigma_mm(observations, noise)
    along = _along_mm(observations, noise)
    return _add_jitter(1.0 / (white**2 + ou**2), travel, along)


def _along_mm(
    observations: Observations, noise: NoiseModel
) -> Float64[np.ndarray, " n"]:
    return np.where(observations.is_ramp, np.inf, noise.along_sigma_mm)


def split_sigma_mm(
    observations: Observations, noise: NoiseModel
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Standard deviations of a cell, white and correlated, in the beam frame."""
    tracker = observations.at.machine.tracker
    distance = np.linalg.norm(observations.tracker_mm, axis=1)
    stated = tracker.sigma_mm(distance)[:, [0, 1, 1]]
    beam, across = np.multiply(noise.white, noise.fast).tolist()
    white = stated * [beam, across, across] / np.sqrt(observations.count)[:, None]
    on_ramp = np.where(observations.is_ramp, noise.ramp_sigma_mm, 0.0)
    white = np.hypot(white, on_ramp[:, None])
    place = np.where(observations.at.line[:, None] < 0, stated * noise.place, 0.0)
    return np.hypot(white, place), stated * np.array(noise.ou)


def _add_jitter(
    precision: Float64[np.ndarray, "n 3"],
    travel: Float64[np.ndarray, "n 3"],
    sigma_mm: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "n 3 3"]:
    """(D + σ² u uᵀ)⁻¹ by Sherman and Morrison; σ = ∞ removes the direction u."""
    matrices = precision[:, :, None] * np.eye(3)
    pulled = precision * travel
    total = np.einsum("ni,ni->n", travel, pulled)
    inverse = np.maximum(sigma_mm, 1e-30) ** -2.0
    weight = np.where(total > 0.0, 1.0 / np.maximum(inverse + total, 1e-300), 0.0)
    return matrices - weight[:, None, None] * pulled[:, :, None] * pulled[:, None, :]


def expected_rms_mm(
    observations: Observations,
    noise: NoiseModel,
    travel: Float64[np.ndarray, "n 3"],
) -> float:
    """Root mean square of one residual component expected from noise alone.

    travel : (n, 3) direction of travel in the beam frame, 0 at a standstill
    """
    white, ou = split_sigma_mm(observations, noise)
    variance = white**2 + ou**2
    is_across = observations.is_ramp | np.isinf(noise.along_sigma_mm)
    jitter = np.where(is_across, 0.0, noise.along_sigma_mm) ** 2
    variance = np.where(
        is_across[:, None],
        variance * (1.0 - travel**2),
        variance + jitter[:, None] * travel**2,
    )
    return float(np.sqrt(np.mean(variance)))


def cap_correlated_noise(noise: NoiseModel) -> NoiseModel:
    """Correlated noise limited to the typical level, so that tests can find the rest.

    A higher level is kept where neighbours in space show it: machine errors are alike
    there.
    """
    most = np.maximum(_MOST_OU, _OF_SHOWN * np.array(noise.shown))
    along, azimuth, elevation = np.minimum(noise.ou, most).tolist()
    is_usual = max(noise.shown) < _MOST_OU
    return replace(
        noise,
        ou=(along, azimuth, elevation),
        ou_time_s=min(noise.ou_time_s, _LONGEST_OU_S if is_usual else np.inf),
    )


def compute_places_um(
    tracker: TrackerNoise, distance_mm: float, noise: NoiseModel
) -> list[float]:
    """Noise between places in range, azimuth and elevation."""
    sigma_mm = tracker.sigma_mm(np.array([distance_mm]))[0, [0, 1, 1]]
    return (1e3 * sigma_mm * noise.place).tolist()


def limit_place_noise(noise: NoiseModel) -> NoiseModel:
    """Noise between places limited to what is typical.

    Single shots, whose samples show no scatter, keep the specified noise.
    """
    most = _MOST_OU if any(noise.white) else 1.0
    x, y, z = np.minimum(noise.place, most).tolist()
    return replace(noise, place=(x, y, z))


def assume_typical_noise(noise: NoiseModel) -> NoiseModel:
    """Correlated noise at its typical limit: few lines do not determine it."""
    return replace(noise, ou=(_MOST_OU, _MOST_OU, _MOST_OU), ou_time_s=_LONGEST_OU_S)
