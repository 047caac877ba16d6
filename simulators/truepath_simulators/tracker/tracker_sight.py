"""Readings of the truth by a tracker: position of its target, and faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.codec import StatusBit
from truepath_simulators.compensation.correction import Correction
from truepath_simulators.faults import Schedule
from truepath_simulators.hidden.effect import (
    HiddenEffect,
    apply_reading_errors,
    locate_target_mm,
)
from truepath_simulators.hidden.motion import MotionFollower
from truepath_simulators.machine.tracker_head import (
    Air,
    TrackerBody,
    TrackerClock,
    TrackerPose,
    measure_polar,
    to_cartesian,
    to_spherical,
)
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.timeline import Timeline

_PUSH = np.array([0.6, -0.64, 0.48])  # direction of an unintended shift


@dataclass(frozen=True, slots=True)
class TrackerParts:
    """Configuration of a simulated tracker."""

    truth: TruthMachine
    pose: TrackerPose
    clock: TrackerClock
    air: Air
    seed: int
    hidden: tuple[HiddenEffect, ...] = ()


class TrackerSight:
    """Measures the target of the machine on which the beam is locked.

    verbs : move the beam from target to target
    """

    def __init__(self, parts: TrackerParts, faults: Schedule) -> None:
        self._parts, self._faults = parts, faults
        self._follower = MotionFollower(
            parts.truth.machine, remembers=bool(parts.hidden)
        )
        self._timeline: Timeline | None = None
        self._set_ups = 0
        self._body = self._draw_body()
        self._last = np.full(3, np.nan)  # read, of a tracker that freezes
        self.verbs = TrackerVerbs(
            [target.name for target in parts.truth.machine.reflectors],
            self._locate_direction,
        )

    @property
    def has_moved(self) -> bool:
        """Whether the machine has moved yet, by the newest timeline."""
        return self._timeline is not None and self._timeline.end_s > 0.0

    def follow(self, timeline: Timeline) -> None:
        self._timeline = timeline

    def set_down(self, pose: TrackerPose) -> None:
        self._parts = replace(self._parts, pose=pose)
        self._set_ups += 1
        self._body = self._draw_body()

    def correct(self, correction: Correction | None) -> None:
        self._follower.correct(correction)

    def read(
        self,
        timeline: Timeline,
        moments_s: np.ndarray,
        number: np.ndarray,
        noise: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Range (mm), azimuth, elevation (rad) and status at machine times.

        number : of the samples; noise : (n, 3) of unit variance
        """
        for _, mask in self._faults.struck("beam-lost", moments_s, number):
            self.verbs.lose(float(moments_s[mask][0]))
        parts = self._parts
        point = parts.pose.from_table(self._locate_target_mm(timeline, moments_s))
        if self._body:
            face = parts.truth.machine.tracker.face
            point = self._body.read(point, moments_s, face=face)
        if parts.hidden:
            point = to_cartesian(
                apply_reading_errors(to_spherical(point), parts.hidden)
            )
        polar = measure_polar(point, noise, parts.truth.machine.tracker)
        for fault, mask in self._faults.struck("spike", moments_s, number):
            polar[mask, 0] += fault.amount
        for _, mask in self._faults.struck("frozen", moments_s, number):
            begin = int(np.argmax(mask))
            polar[mask] = polar[begin - 1] if begin else self._last
        self._last = polar[-1]
        status = np.zeros(len(moments_s), np.int64)
        status[self.verbs.list_targets(moments_s) == None] |= (  # noqa: E711
            StatusBit.BEAM_BROKEN
        )
        for _, mask in self._faults.struck("beam-break", moments_s, number):
            status[mask] |= StatusBit.BEAM_BROKEN
        return polar, status

    def _draw_body(self) -> TrackerBody | None:
        figures, seed = self._parts.truth.machine.tracker, self._parts.seed
        if not figures.specification:
            return None
        return TrackerBody.draw(figures.specification, seed, seed + self._set_ups)

    def _locate_target_mm(
        self, timeline: Timeline, moments_s: np.ndarray
    ) -> np.ndarray:
        reflectors = self._parts.truth.machine.reflectors
        targets = self.verbs.list_targets(moments_s)
        targets[targets == None] = reflectors[0].name  # noqa: E711
        rows = timeline.rows(moments_s)
        for fault, mask in self._faults.struck("target", moments_s, rows):
            number = min(max(int(fault.amount), 1), len(reflectors))
            targets[mask] = reflectors[number - 1].name
        place_mm = self._locate_mm(timeline, moments_s, targets.tolist())
        for fault, mask in self._faults.struck("knock", moments_s, rows):
            place_mm[mask] += fault.amount * _PUSH
        return place_mm

    def _locate_mm(
        self, timeline: Timeline, moments_s: np.ndarray, names: list[str]
    ) -> np.ndarray:
        parts, motion = self._parts, self._follower.follow(timeline)
        return locate_target_mm(parts.truth, motion, moments_s, names, parts.hidden)

    def _locate_direction(self, name: str, true_s: float) -> tuple[float, float]:
        if self._timeline is None:
            return 0.0, 0.0
        place_mm = self._locate_mm(self._timeline, np.array([true_s]), [name])
        _, azimuth, elevation = to_spherical(self._parts.pose.from_table(place_mm))[0]
        return float(azimuth), float(elevation)


_FIELD_RAD = 0.05  # off the sight, in which a target is found
_HIGHEST_RAD = math.radians(80.0)

_NOTHING = gst.NakCode.NO_TARGET, "no target near the beam"

LocateTarget = Callable[[str, float], tuple[float, float]]
"""Azimuth and elevation of a target at a machine time."""


class TrackerVerbs:
    """Target of the beam, and since when; the first target at the start.

    is_known : the host has sent HELLO in a version with these verbs
    """

    def __init__(self, names: Sequence[str], locate: LocateTarget) -> None:
        self._names, self._locate = tuple(names), locate
        self._since: list[tuple[float, str | None]] = [(-math.inf, self._names[0])]
        self._sight = (0.0, 0.0)
        self._air = gst.AirInUse(20.0, 1013.25, 50.0)
        self.is_known = False

    def list_targets(self, moments_s: np.ndarray) -> np.ndarray:
        """Names at these moments, None where the beam has no target."""
        begins, names = zip(*self._since, strict=True)
        chosen = np.array(names, object)
        return chosen[np.searchsorted(begins, moments_s, "right") - 1]

    def lose(self, true_s: float) -> None:
        """Lose the target; the beam stays where it is, until a search."""
        self._sight = self._locate(self._since[-1][1] or self._names[0], true_s)
        self._since.append((true_s, None))

    def answer(
        self, verb: gst.Verb, true_s: float, *, is_blocked: bool = False
    ) -> gst.Message:
        """Execute a verb and reply; a blocked beam finds nothing."""
        kind = _TYPES[type(verb)]
        if not self.is_known:
            return gst.Nak(
                verb.transaction, kind, gst.NakCode.UNKNOWN_COMMAND, "not understood"
            )
        match verb:
            case gst.Home():
                refusal = self._turn(0.0, 0.0, true_s)
            case gst.Aim(_, azimuth_rad, elevation_rad):
                refusal = self._turn(azimuth_rad, elevation_rad, true_s)
            case gst.Search():
                refusal = _NOTHING if is_blocked else self._search(true_s)
            case gst.Select(_, name):
                refusal = self._select(name, true_s)
            case gst.SetAir(_, temperature, pressure, humidity):
                self._air, refusal = gst.AirInUse(temperature, pressure, humidity), None
            case gst.GetAir():
                refusal = None
        if refusal is not None:
            return gst.Nak(verb.transaction, kind, *refusal)
        air = self._air if isinstance(verb, gst.SetAir | gst.GetAir) else None
        return gst.Ack(verb.transaction, kind, air)

    def _turn(
        self, azimuth_rad: float, elevation_rad: float, true_s: float
    ) -> tuple[gst.NakCode, str] | None:
        if not (math.isfinite(azimuth_rad) and abs(elevation_rad) <= _HIGHEST_RAD):
            return gst.NakCode.BAD_ARGUMENT, "no direction the beam can take"
        self._sight = azimuth_rad, elevation_rad
        self._since.append((true_s, None))
        return None

    def _search(self, true_s: float) -> tuple[gst.NakCode, str] | None:
        away = {name: self._measure_away(name, true_s) for name in self._names}
        nearest = min(away, key=lambda name: away[name])
        if away[nearest] > _FIELD_RAD:
            return _NOTHING
        return self._select(nearest, true_s)

    def _select(self, name: str, true_s: float) -> tuple[gst.NakCode, str] | None:
        if name not in self._names:
            known = ", ".join(self._names)
            return gst.NakCode.BAD_ARGUMENT, f"knows {known}"
        self._sight = self._locate(name, true_s)
        if self._since[-1][1] != name:
            self._since.append((true_s, name))
        return None

    def _measure_away(self, name: str, true_s: float) -> float:
        azimuth, elevation = self._locate(name, true_s)
        aside = math.remainder(azimuth - self._sight[0], 2.0 * math.pi)
        return math.hypot(aside * math.cos(elevation), elevation - self._sight[1])


_TYPES: dict[type[gst.Verb], gst.Type] = {
    gst.Home: gst.Type.HOME,
    gst.Aim: gst.Type.AIM,
    gst.Search: gst.Type.SEARCH,
    gst.Select: gst.Type.SELECT,
    gst.SetAir: gst.Type.SET_AIR,
    gst.GetAir: gst.Type.GET_AIR,
}
