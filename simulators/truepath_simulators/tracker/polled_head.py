"""Shared part of polled instruments: shots of the truth, one at a time."""

from __future__ import annotations

import numpy as np

from truepath_drivers.tracker.streaming.measurements import StatusBit
from truepath_simulators.compensation.correction import Correction
from truepath_simulators.faults import Schedule
from truepath_simulators.machine.tracker_head import SampleNoise, TrackerPose
from truepath_simulators.timeline import Timeline
from truepath_simulators.tracker.tracker_sight import TrackerParts, TrackerSight

SHOT_S = 0.4  # for a distance, by the machine's clock


class PolledHead:
    """Shots of the point that the streaming tracker would measure."""

    def __init__(self, parts: TrackerParts, faults: Schedule) -> None:
        self._sight = TrackerSight(parts, faults)
        self._faults, self._parts = faults, parts
        self._noise = SampleNoise(parts.seed, 1.0 / SHOT_S, parts.air)
        self._count = 0

    @property
    def serial_number(self) -> str:
        """Serial number, from the seed."""
        return f"{self._parts.seed:06d}"

    def set_down(self, pose: TrackerPose) -> None:
        """Move the tracker to another pose from now on."""
        self._sight.set_down(pose)

    def correct(self, correction: Correction | None) -> None:
        """Apply these tables to the machine from now on."""
        self._sight.correct(correction)

    @property
    def shots(self) -> int:
        """Number of shots taken."""
        return self._count

    def begin(self, true_s: float) -> None:
        """Start the times of faults with the first request."""
        self._faults.begin(true_s)

    def is_silent(self, true_s: float) -> bool:
        """Whether it gives no answer now."""
        return bool(self._faults.strikes("silence", true_s))

    def shoot(self, timeline: Timeline, true_s: float) -> np.ndarray | None:
        """Range (mm), azimuth and elevation (rad); None without a target."""
        self._count += 1
        number, moment_s = np.array([self._count]), np.array([true_s])
        polar, status = self._sight.read(
            timeline, moment_s, number, self._noise.draw(1)
        )
        return None if status[0] & StatusBit.BEAM_BROKEN else polar[0]
