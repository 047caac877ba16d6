"""Systematic errors of a tracker within its maker's specification.

Every estimate has these terms in addition to the errors of the machine, each with the
standard uncertainty of its specification (Hughes et al. 2011; Muralikrishnan et al.
2009).
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.base import (
    Effect,
    Parameter,
    QuadraticPrior,
    Role,
)
from truepath.kinematics.machine.tracker_noise import TrackerSpecification

_CYCLES = np.arange(3, 17)  # a turn, of what is fine
_GRID = 96
_LEFT_OUT = 2e-3  # of the variance of what is fine


@dataclass(frozen=True)
class _Beam:
    """Beam of the tracker and its directions, in its own frame.

    azimuth, elevation : of its axes. In the second face the head is turned by half a
        turn and points over its back; across and up turn with it
    facing : 1, or -1 in the second face
    """

    along: Float64[np.ndarray, "n 3"]
    across: Float64[np.ndarray, "n 3"]
    up: Float64[np.ndarray, "n 3"]
    distance_mm: Float64[np.ndarray, " n"]
    azimuth: Float64[np.ndarray, " n"]
    elevation: Float64[np.ndarray, " n"]
    facing: float

    @staticmethod
    def of(recorded: RecordedState, face: int | None) -> _Beam:
        distance = np.linalg.norm(recorded.tracker_mm, axis=1)
        azimuth, elevation = _find_angles(recorded, face)
        ca, sa = np.cos(azimuth), np.sin(azimuth)
        ce, se = np.cos(elevation), np.sin(elevation)
        nothing = np.zeros_like(ca)
        return _Beam(
            np.stack([ca * ce, sa * ce, se], axis=1),
            np.stack([-sa, ca, nothing], axis=1),
            np.stack([-ca * se, -sa * se, ce], axis=1),
            distance,
            azimuth,
            elevation,
            -1.0 if face == 2 else 1.0,
        )


def _find_angles(
    recorded: RecordedState, face: int | None
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    x, y, z = recorded.tracker_mm.T
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    if face == 2:
        return azimuth + np.pi, np.pi - elevation
    return azimuth, elevation


@dataclass(frozen=True)
class FineCircle:
    """3 to 16 cycles per turn, as a stationary process over the measured angles.

    Its shapes are those of largest variance over them (Karhunen and Loève).
    """

    low_rad: float
    high_rad: float

    @staticmethod
    def over(angle_rad: Float64[np.ndarray, " n"]) -> FineCircle:
        """The process over the range of the angles, centred on their mean direction."""
        middle = float(np.angle(np.exp(1j * angle_rad).sum()))
        off = np.angle(np.exp(1j * (angle_rad - middle)))
        return FineCircle(middle + float(off.min()), middle + float(off.max()))

    @cached_property
    def _shapes(self) -> Float64[np.ndarray, "w k"]:
        grid = _waves(np.linspace(self.low_rad, self.high_rad, _GRID))
        value, vector = np.linalg.eigh(grid @ grid.T)
        value, vector = value[::-1], vector[:, ::-1]
        left = 1.0 - np.cumsum(value) / value.sum()
        count = int(np.count_nonzero(left > _LEFT_OUT)) + 1
        return grid.T @ vector[:, :count] / np.sqrt(value[:count])

    @property
    def count(self) -> int:
        return self._shapes.shape[1]

    def rows(self, angle_rad: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n k"]:
        """Shapes at angles; together of standard deviation 1."""
        return _waves(angle_rad) @ self._shapes


def _waves(angle_rad: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n w"]:
    """Their products are the process' correlation."""
    turns = np.multiply.outer(angle_rad, _CYCLES)
    return np.hstack([np.cos(turns), np.sin(turns)]) / len(_CYCLES) ** 0.5


class _Terms:
    def __init__(self) -> None:
        self.columns: list[Float64[np.ndarray, "n 3"]] = []

    def add(self, sigma: float, *columns: Float64[np.ndarray, "n 3"]) -> None:
        if sigma > 0.0:
            self.columns += [sigma * column for column in columns]


@dataclass(frozen=True)
class TrackerErrors(Effect):
    """Errors that stay with the tracker when it is moved; θ in units of their sigma.

    set_ups : of this tracker; all if empty
    """

    kind = "tracker-errors"
    role = Role.NUISANCE
    specification: TrackerSpecification
    azimuth: FineCircle
    elevation: FineCircle
    is_moving: bool
    set_ups: tuple[str, ...] = ()

    def compose_name(self, digits: str) -> str:
        return "-".join((self.kind, *self.set_ups[:1]))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"tracker[{k}]", "1") for k in range(self._count))

    @cached_property
    def _count(self) -> int:
        s = self.specification
        parts = [
            (s.eccentricity_urad, 4),
            (s.encoder_urad, 4),
            (s.fine_urad, self.azimuth.count + self.elevation.count),
            (s.index_urad, 1),
            (s.beam_offset_um, 2),
            (s.transit_offset_um, 1),
            (s.tilt_urad, 2),
            (s.reflector_um, 2),
            (s.delay_us if self.is_moving else 0.0, 4),
        ]
        return sum(count for size, count in parts if size > 0.0)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        recorded = _find_recorded(at, self.set_ups)
        if recorded is None:
            return np.zeros((len(at), 3, self._count))
        s, terms = self.specification, _Terms()
        b = _Beam.of(recorded, at.machine.tracker.face)
        turn = (b.distance_mm * np.cos(b.elevation))[:, None] * b.across
        rise = b.distance_mm[:, None] * b.up
        for size, cycles in ((s.eccentricity_urad, 1), (s.encoder_urad, 2)):
            for arm, angle in ((turn, b.azimuth), (rise, b.elevation)):
                for wave in (np.cos, np.sin):
                    terms.add(1e-6 * size, wave(cycles * angle)[:, None] * arm)
        if s.fine_urad:
            for arm, angle, circle in (
                (turn, b.azimuth, self.azimuth),
                (rise, b.elevation, self.elevation),
            ):
                for shape in circle.rows(angle).T:
                    terms.add(1e-6 * s.fine_urad, shape[:, None] * arm)
        sine, tangent = np.sin(b.elevation)[:, None], np.tan(b.elevation)[:, None]
        cosine = np.cos(b.elevation)[:, None]
        terms.add(1e-6 * s.index_urad, rise)
        terms.add(1e-3 * s.beam_offset_um, b.across, b.up)
        terms.add(1e-3 * s.transit_offset_um, cosine * b.along - sine * b.up)
        terms.add(1e-6 * s.tilt_urad, tangent * turn, turn / cosine)
        terms.add(1e-3 * s.reflector_um, b.facing * b.across, b.facing * b.up)
        if self.is_moving:
            speed = at.velocity_mm_s @ recorded.rotation.T
            away, side, up = (
                np.einsum("ni,ni->n", speed, arm)[:, None]
                for arm in (b.along, b.across, b.up)
            )
            terms.add(
                1e-6 * s.delay_us,
                away * b.along,
                side * b.across,
                up * b.across,
                side * b.up,
            )
        return _turn_back(terms, recorded)

    def prior(self) -> QuadraticPrior:
        return _known(self._count)


@dataclass(frozen=True)
class SetUpErrors(Effect):
    """Errors of a tracker that change with set-up, lock or weather.

    set_up : that it belongs to; any if empty
    locks : numbers of the locks of its beam, each with a range offset
    """

    kind = "set-up-errors"
    role = Role.NUISANCE
    specification: TrackerSpecification
    begin_s: float
    end_s: float
    set_up: str = ""
    locks: tuple[int, ...] = (0,)

    def compose_name(self, digits: str) -> str:
        return "-".join(filter(None, (self.kind, self.set_up)))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"set-up[{k}]", "1") for k in range(self._count))

    @property
    def _count(self) -> int:
        s = self.specification
        offsets = len(self.locks) if s.range_offset_um > 0.0 else 0
        sizes = (self._mean_scale_ppm, s.scale_drift_ppm, s.bending_urad_per_m)
        return offsets + sum(size > 0.0 for size in sizes)

    @property
    def _mean_scale_ppm(self) -> float:
        """A scale that drifts from the begin has half of it in the mean."""
        s = self.specification
        return float(np.hypot(s.scale_ppm, 0.5 * s.scale_drift_ppm))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        recorded = _find_recorded(at, (self.set_up,) if self.set_up else ())
        if recorded is None:
            return np.zeros((len(at), 3, self._count))
        s, terms = self.specification, _Terms()
        b = _Beam.of(recorded, at.machine.tracker.face)
        r = b.distance_mm[:, None]
        when = (at.time_s - self.begin_s) / max(self.end_s - self.begin_s, 1e-9)
        lock = np.zeros(len(at)) if recorded.lock is None else recorded.lock
        for number in self.locks:
            on = (lock == number)[:, None]
            terms.add(1e-3 * s.range_offset_um, on * b.along)
        terms.add(1e-6 * self._mean_scale_ppm, r * b.along)
        terms.add(1e-6 * s.scale_drift_ppm, (when - 0.5)[:, None] * r * b.along)
        bend = r**2 * (
            np.cos(b.elevation)[:, None] * b.up - np.sin(b.elevation)[:, None] * b.along
        )
        terms.add(1e-9 * s.bending_urad_per_m, bend)
        return _turn_back(terms, recorded)

    def prior(self) -> QuadraticPrior:
        return _known(self._count)


@dataclass(frozen=True)
class RangeStep(Effect):
    """Range offset from one moment on, without knowledge beforehand.

    set_up : that it belongs to
    """

    kind = "range-step"
    role = Role.NUISANCE
    units = {"": "mm"}
    set_up: str
    time_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        recorded = _find_recorded(at, (self.set_up,))
        if recorded is None:
            return np.zeros((len(at), 3, 1))
        terms = _Terms()
        late = (at.time_s >= self.time_s)[:, None]
        terms.add(1.0, late * _Beam.of(recorded, at.machine.tracker.face).along)
        return _turn_back(terms, recorded)

    def prior(self) -> QuadraticPrior:
        return _known(1)


def name_set_up(rotation: Float64[np.ndarray, "3 3"], face: int | None) -> str:
    """Hash that distinguishes set-ups: orientation of the tracker, and face.

    To the last bit: Runs that are solved together may have no numbers, or the same
    clock. A change of face is a new lock.
    """
    return format(zlib.crc32(rotation.tobytes(), face or 1), "08x")


def _find_recorded(at: Conditions, set_ups: Sequence[str]) -> RecordedState | None:
    recorded = at.recorded
    if recorded is None or not set_ups:
        return recorded
    return recorded if recorded.set_up in set_ups else None


def _turn_back(terms: _Terms, recorded: RecordedState) -> Float64[np.ndarray, "n 3 p"]:
    if not terms.columns:
        return np.zeros((len(recorded.tracker_mm), 3, 0))
    stacked = np.stack(terms.columns, axis=2)
    return np.einsum("ji,njp->nip", recorded.rotation, stacked)


def _known(count: int) -> QuadraticPrior:
    return QuadraticPrior(np.eye(count), count, float(count), is_known=True)


def is_tracker_error(effect: Effect) -> bool:
    return isinstance(effect, TrackerErrors | SetUpErrors | RangeStep)


def list_instrument_errors(runs: Sequence[Conditions]) -> tuple[Effect, ...]:
    """Systematic errors of the trackers of Runs that have a recording.

    Runs whose files give the same specification have the same tracker.
    """
    trackers: dict[TrackerSpecification, dict[str, Conditions]] = {}
    for at in runs:
        if at.recorded is not None:
            set_ups = trackers.setdefault(at.machine.tracker.systematic, {})
            set_ups[at.recorded.set_up] = at
    effects: list[Effect] = []
    for specification, set_ups in trackers.items():
        own = () if len(trackers) == 1 else tuple(set_ups)
        effects.append(_share_errors(specification, list(set_ups.values()), own))
        for name, at in set_ups.items():
            begin, end = float(at.time_s.min()), float(at.time_s.max())
            locks = _list_locks(at)
            effects.append(SetUpErrors(specification, begin, end, name, locks))
    return tuple(effect for effect in effects if effect.parameters)


def _list_locks(at: Conditions) -> tuple[int, ...]:
    if at.recorded is None or at.recorded.lock is None:
        return (0,)
    return tuple(np.unique(at.recorded.lock).tolist())


def _share_errors(
    specification: TrackerSpecification,
    runs: Sequence[Conditions],
    own: tuple[str, ...],
) -> TrackerErrors:
    angles = [
        _find_angles(at.recorded, at.machine.tracker.face)
        for at in runs
        if at.recorded is not None
    ]
    azimuth, elevation = (
        FineCircle.over(np.concatenate(each)) for each in zip(*angles, strict=True)
    )
    is_moving = any((at.line >= 0).any() for at in runs)
    return TrackerErrors(specification, azimuth, elevation, is_moving, own)
