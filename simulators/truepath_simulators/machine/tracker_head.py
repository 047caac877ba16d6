"""Readings of a point by a tracker: range and angles, with its noise and clock.

Angles: azimuth from x towards y, elevation from the xy plane towards z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truepath_simulators.machine.joint import rotation_matrices
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import MachineFile, TrackerFigures
from truepath_simulators.randomness import generator

_BLOCK = 256  # samples at once
_PROBES = 500  # positions that represent the volume


@dataclass(frozen=True, slots=True)
class TrackerPose:
    """Pose of the tracker: p_table = position + rotation p_tracker."""

    position_mm: np.ndarray
    rotation: np.ndarray

    def from_table(self, point_mm: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the frame on which it stands, in its own frame."""
        return (point_mm - self.position_mm) @ self.rotation


@dataclass(frozen=True, slots=True)
class TrackerClock:
    """A device clock with its own epoch and rate: device = epoch + (1 + drift) true."""

    epoch_s: float
    drift: float

    def true_s(self, device_s: np.ndarray) -> np.ndarray:
        """True times of device times."""
        return (device_s - self.epoch_s) / (1.0 + self.drift)

    def device_s(self, true_s: float) -> float:
        """Device time of a true time."""
        return self.epoch_s + (1.0 + self.drift) * true_s


@dataclass(frozen=True, slots=True)
class Air:
    """The part of the noise that is correlated in time: an Ornstein-Uhlenbeck process.

    share : its standard deviation over that of one sample; tau_s : correlation time
    """

    share: float = 0.2
    tau_s: float = 1.0


class SampleNoise:
    """Three channels of unit variance, white plus air; the same however it is split.

    stream : number of the stream since power-on; each has separate noise
    """

    def __init__(self, seed: int, rate_hz: float, air: Air, stream: int = 0) -> None:
        of_stream = f" of stream {stream}" if stream else ""
        self._white = generator(seed, "tracker: white noise" + of_stream)
        self._driver = generator(seed, "tracker: air" + of_stream)
        self._share = air.share
        self._keep = float(np.exp(-1.0 / (rate_hz * air.tau_s)))
        self._last = self._driver.standard_normal(3)
        age = np.arange(_BLOCK)
        self._fade = self._keep ** (age + 1.0)
        self._memory = np.tril(self._keep ** (age[:, None] - age).clip(0).astype(float))

    def draw(self, n: int) -> np.ndarray:
        """Next (n, 3) values."""
        white = self._white.standard_normal((n, 3))
        drive = np.sqrt(1.0 - self._keep**2) * self._driver.standard_normal((n, 3))
        air = self._filter(drive)
        return np.sqrt(1.0 - self._share**2) * white + self._share * air

    def _filter(self, drive: np.ndarray) -> np.ndarray:
        """a_k = keep a_(k-1) + drive_k, block by block as a matrix product."""
        air = np.empty_like(drive)
        for start in range(0, len(drive), _BLOCK):
            part = drive[start : start + _BLOCK]
            n = len(part)
            air[start : start + n] = self._memory[:n, :n] @ part
            air[start : start + n] += np.outer(self._fade[:n], self._last)
            self._last = air[start + n - 1]
        return air


def random_pose(machine: MachineFile, seed: int) -> TrackerPose:
    """Random pose next to the travel, turned and slightly tilted."""
    rng = generator(seed, "tracker: pose")
    middle, reach = _reach(machine)
    away = reach + rng.uniform(250.0, 450.0)
    bearing = rng.uniform(0.0, 2.0 * np.pi)
    beside = away * np.array([np.cos(bearing), np.sin(bearing), 0.0])
    beside[2] = rng.uniform(-200.0, 200.0)
    return TrackerPose(middle + beside, _sample_rotation(rng))


def reposition(place_mm: Sequence[float], seed: int) -> TrackerPose:
    """Pose at a position, turned and slightly tilted by a seed."""
    rotation = _sample_rotation(generator(seed, "tracker: pose"))
    return TrackerPose(np.array(place_mm, float), rotation)


def _sample_rotation(rng: np.random.Generator) -> np.ndarray:
    tilt = rng.normal(0.0, 0.05, 2)
    turn = rng.uniform(-np.pi, np.pi)
    return rotation_matrices(
        np.array([tilt[0]]), np.array([tilt[1]]), np.array([turn])
    )[0]


def _reach(machine: MachineFile) -> tuple[np.ndarray, float]:
    if not machine.rotary_axes:
        middle = 0.5 * (machine.low_mm + machine.high_mm)
        half = 0.5 * (machine.high_mm - machine.low_mm)
        return middle + machine.reflector().offset_mm, float(np.linalg.norm(half[:2]))
    anywhere = np.random.default_rng(0).uniform(
        machine.low, machine.high, (_PROBES, len(machine.axes))
    )
    truth = perfect(machine)
    seen = np.vstack(
        [truth.locate_target_mm(anywhere, r.name) for r in machine.reflectors]
    )
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    return middle, float(np.linalg.norm((seen - middle)[:, :2], axis=1).max())


def random_clock(seed: int) -> TrackerClock:
    """Random clock: starts anywhere in two hours, up to 20 ppm fast or slow."""
    rng = generator(seed, "tracker: clock")
    return TrackerClock(
        round(float(rng.uniform(0.0, 7200.0)), 6), float(rng.uniform(-2e-5, 2e-5))
    )


def measure_polar(
    point_mm: np.ndarray, unit_noise: np.ndarray, figures: TrackerFigures
) -> np.ndarray:
    """Range (mm), azimuth, elevation (rad) of points in the tracker's frame.

    Noise of one sample, 1 sigma: range_sigma_um + range_ppm r along the beam,
    hypot(angle_sigma_urad r, transverse_sigma_um) in each direction across it.
    """
    exact = to_spherical(point_mm)
    distance, elevation = exact[:, 0], exact[:, 2]
    along = 1e-3 * figures.range_sigma_um + 1e-6 * figures.range_ppm * distance
    across = np.hypot(
        1e-6 * figures.angle_sigma_urad * distance, 1e-3 * figures.transverse_sigma_um
    )
    sigma = [along, across / (distance * np.cos(elevation)), across / distance]
    return exact + np.stack(sigma, axis=1) * unit_noise


def to_spherical(point_mm: np.ndarray) -> np.ndarray:
    """Range, azimuth, elevation of points (n, 3)."""
    x, y, z = point_mm.T
    level = np.hypot(x, y)
    return np.stack([np.hypot(level, z), np.arctan2(y, x), np.arctan2(z, level)], 1)


def to_cartesian(spherical: np.ndarray) -> np.ndarray:
    """Points (n, 3) from range, azimuth, elevation."""
    distance, azimuth, elevation = spherical.T
    level = distance * np.cos(elevation)
    return np.stack(
        [
            level * np.cos(azimuth),
            level * np.sin(azimuth),
            distance * np.sin(elevation),
        ],
        1,
    )
