"""What a tracker reads of the truth: where its target is, and what goes wrong there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truepath.drivers.tracker.streaming.measurements import StatusBit
from truepath.simulators.compensation.correction import Correction
from truepath.simulators.faults import Schedule
from truepath.simulators.hidden.effect import HiddenEffect
from truepath.simulators.hidden.motion import MotionFollower
from truepath.simulators.hidden.superposition import locate_target_mm, misread
from truepath.simulators.timeline import Timeline
from truepath.simulators.tracker_head import (
    Air,
    TrackerClock,
    TrackerPose,
    measure_polar,
    to_cartesian,
    to_spherical,
)
from truepath.simulators.tracker_verbs import TrackerVerbs
from truepath.simulators.truth_machine import TruthMachine

_PUSH = np.array([0.6, -0.64, 0.48])  # of a knock, where to


@dataclass(frozen=True, slots=True)
class TrackerParts:
    """What a tracker is made of."""

    truth: TruthMachine
    pose: TrackerPose
    clock: TrackerClock
    air: Air
    seed: int
    hidden: tuple[HiddenEffect, ...] = ()


class TrackerSight:
    """Sees the target of the machine that the beam is on.

    verbs : by which the beam goes from target to target
    """

    def __init__(self, parts: TrackerParts, faults: Schedule) -> None:
        self._parts, self._faults = parts, faults
        self._follower = MotionFollower(
            parts.truth.machine, remembers=bool(parts.hidden)
        )
        self._timeline: Timeline | None = None
        self._last = np.full(3, np.nan)  # read, of a tracker that freezes
        self.verbs = TrackerVerbs(
            [target.name for target in parts.truth.machine.reflectors],
            self._locate_direction,
        )

    @property
    def has_moved(self) -> bool:
        """Whether the machine has moved yet, by the newest that is known."""
        return self._timeline is not None and self._timeline.end_s > 0.0

    def follow(self, timeline: Timeline) -> None:
        """Know the motion so far."""
        self._timeline = timeline

    def set_down(self, pose: TrackerPose) -> None:
        """Stand elsewhere from now on."""
        self._parts = replace(self._parts, pose=pose)

    def correct(self, correction: Correction | None) -> None:
        """See the machine driven by these tables from now on."""
        self._follower.correct(correction)

    def read(
        self,
        timeline: Timeline,
        moments_s: np.ndarray,
        number: np.ndarray,
        noise: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return range (mm), azimuth, elevation (rad) and status at machine times.

        number : of the samples; noise : (n, 3) of unit variance
        """
        for _, mask in self._faults.struck("beam-lost", moments_s, number):
            self.verbs.lose(float(moments_s[mask][0]))
        parts = self._parts
        point = parts.pose.from_table(self._locate_target_mm(timeline, moments_s))
        if parts.hidden:
            point = to_cartesian(misread(to_spherical(point), parts.hidden))
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
