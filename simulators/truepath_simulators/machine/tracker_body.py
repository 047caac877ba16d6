"""A tracker as bodies: axes that neither meet nor are square, circles, a beam, a lens.

The error of each is sampled from the tracker's specification. The aim is found by
turning the axes until the beam meets the target, not by a formula for each error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truepath_simulators.machine.joint import rotation_matrices
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical
from truepath_simulators.randomness import generator

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
