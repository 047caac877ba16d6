"""A tracker: its pose and clock, the errors of its body, range and angles with noise.

Angles: azimuth from x towards y, elevation from the xy plane towards z. The errors of
its body are sampled from the specification: axes that neither meet nor are square,
circles, a beam, a lens. The aim is found by turning the axes until the beam meets the
target, not by a formula for each error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truepath_simulators.machine.joints import rotation_matrices
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
        return (device_s - self.epoch_s) / (1.0 + self.drift)

    def device_s(self, true_s: float) -> float:
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


_FINE = np.arange(3, 17)  # cycles a turn
_AIR_S = 1800.0  # a period of the air's slow change since the tracker measured it
_TURNS = 4  # until the beam meets the target: each leaves a millionth


@dataclass(frozen=True, slots=True)
class TrackerBody:
    """One tracker in one set-up. Angles in rad, lengths in mm, times in s.

    circles : (2, k, 2) error of azimuth and elevation, k cycles a turn, cos and sin
    square : (2,) of the transit axis to the standing one, of the beam to the transit
    late_s : (4,) range, azimuth, rise into azimuth, turn into elevation
    range_mm : (locks,) offset of the range after each lock of the beam
    """

    circles: np.ndarray
    index: float
    square: np.ndarray
    transit_mm: float
    beam_mm: np.ndarray
    reflector_mm: np.ndarray
    late_s: np.ndarray
    range_mm: np.ndarray
    scale: float
    air: tuple[float, float]
    bending_per_mm: float

    @staticmethod
    def draw(
        specification: Mapping[str, float],
        tracker_seed: int,
        set_up_seed: int,
        locks: int = 1,
    ) -> TrackerBody:
        """Random tracker, and random errors of its set-up and each lock."""
        made = generator(tracker_seed, "tracker: body")
        placed = generator(set_up_seed, "tracker: set-up")

        def size(rng: np.random.Generator, key: str, *shape: int) -> np.ndarray:
            unit = 1e-3 if key.endswith("_um") else 1e-6
            return unit * specification.get(key, 0.0) * rng.standard_normal(shape)

        coarse = [
            size(made, key, 2, 1, 2) for key in ("eccentricity_urad", "encoder_urad")
        ]
        fine = size(made, "fine_urad", 2, len(_FINE), 2) / len(_FINE) ** 0.5
        locked = generator(set_up_seed, "tracker: locks")
        again = size(locked, "range_offset_um", locks - 1)
        return TrackerBody(
            np.concatenate([*coarse, fine], axis=1),
            float(size(made, "index_urad")),
            size(made, "tilt_urad", 2),
            float(size(made, "transit_offset_um")),
            size(made, "beam_offset_um", 2),
            size(made, "reflector_um", 2),
            size(made, "delay_us", 4),
            np.append(size(placed, "range_offset_um"), again),
            float(size(placed, "scale_ppm")),
            (float(size(placed, "scale_drift_ppm")), placed.uniform(0.0, 2.0 * np.pi)),
            1e-3 * float(size(placed, "bending_urad_per_m")),
        )

    def read(
        self,
        point_mm: np.ndarray,
        time_s: np.ndarray,
        locks_s: Sequence[float] = (),
        face: int = 1,
    ) -> np.ndarray:
        """Reading of targets (n, 3) by the tracker's software, in its own frame.

        locks_s : times at which it found its target again
        """
        seen = to_spherical(point_mm + self._move_centre(point_mm))
        turned, sense = seen.copy(), np.ones(3)
        if face == 2:  # half a turn, and over the zenith: up is down for its axis
            turned = seen * [1, 1, -1] + [0.0, np.pi, np.pi]
            sense[2] = -1.0
        for _ in range(_TURNS):
            missed = seen - to_spherical(self._aim(turned))
            missed[:, 1] = np.angle(np.exp(1j * missed[:, 1]))
            turned += sense * missed
        distance, azimuth, elevation = turned.T
        wave, phase = self.air
        swing = np.sin(2.0 * np.pi * time_s / _AIR_S + phase) - np.sin(phase)
        scale = self.scale + wave * swing
        bent = self.bending_per_mm * distance
        offset = self.range_mm[np.searchsorted(locks_s, time_s, side="right")]
        reading = np.stack(
            [
                distance * (1.0 + scale - bent * np.sin(elevation)) + offset,
                azimuth + _swing(self.circles[0], azimuth),
                elevation
                + _swing(self.circles[1], elevation)
                + self.index
                + bent * np.cos(elevation),
            ],
            axis=1,
        )
        return to_cartesian(reading - self._lag(turned, time_s))

    def _aim(self, turned: np.ndarray) -> np.ndarray:
        distance, azimuth, elevation = turned.T
        nothing = np.zeros_like(distance)
        tilt, skew = self.square
        end = np.stack([distance, skew * distance, nothing], axis=1)
        end[:, 1:] += self.beam_mm
        for turn in (
            rotation_matrices(nothing, -elevation, nothing),
            rotation_matrices(nothing + tilt, nothing, nothing),
        ):
            end = np.einsum("nij,nj->ni", turn, end)
        end[:, 0] += self.transit_mm
        turn = rotation_matrices(nothing, nothing, azimuth)
        return np.einsum("nij,nj->ni", turn, end)

    def _move_centre(self, point_mm: np.ndarray) -> np.ndarray:
        """Displacement of the optical centre, which turns with the beam."""
        _, azimuth, elevation = to_spherical(point_mm).T
        nothing = np.zeros_like(azimuth)
        turn = rotation_matrices(nothing, -elevation, azimuth)
        return turn @ np.array([0.0, *self.reflector_mm])

    def _lag(self, turned: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        if len(time_s) < 2 or not self.late_s.any():
            return np.zeros_like(turned)
        speed = np.gradient(np.unwrap(turned, axis=0), time_s, axis=0)
        level = np.cos(turned[:, 2])
        away, side, rise, turn = self.late_s
        return np.stack(
            [
                away * speed[:, 0],
                side * speed[:, 1] + rise * speed[:, 2] / level,
                turn * level * speed[:, 1],
            ],
            axis=1,
        )


def _swing(circle: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cycles = np.r_[1, 2, _FINE]
    waves = np.multiply.outer(angle, cycles)
    return np.cos(waves) @ circle[:, 0] + np.sin(waves) @ circle[:, 1]
