"""A periodic motion in time at 1 Hz or faster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Role, columns_along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    Wave,
    Words,
)
from app.kinematics.effects.keys import DIRECTION
from app.kinematics.effects.sinusoid import (
    average_over_cells,
    make_time_wave,
    sine_and_cosine,
    state_wave,
)
from app.kinematics.symbols import LINEAR

_SLOWEST_HZ = 1.0
_FASTEST = 0.45  # of the tracker's rate


@dataclass(frozen=True)
class Vibration(Effect):
    """Sine and cosine in time, in one direction.

    middle_s : of the run, where the phase is 0: so it does not turn with the frequency
    """

    kind = "vibration"
    role = Role.MEASUREMENT
    units = {"sin": "mm", "cos": "mm"}
    direction: str
    frequency_hz: float
    middle_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves, averaged over each cell."""
        rate = np.full(len(at), 2.0 * np.pi * self.frequency_hz)
        waves = average_over_cells(self._angle(at.time_s), rate, at)
        return columns_along(self.direction, waves)

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        return columns_along(self.direction, sine_and_cosine(self._angle(time_s)))

    def _angle(self, time_s: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        return 2.0 * np.pi * self.frequency_hz * (time_s - self.middle_s)


class VibrationFamily(Family):
    """Every direction, the frequency scanned as far as the samples can follow."""

    name = "vibration"
    role = Role.MEASUREMENT
    scanned = "frequency_hz"
    keys = {"direction": DIRECTION}
    words = {
        "en": Words(
            title="Vibration",
            cause="A pump, a fan, a drive or the floor shakes table, spindle or "
            "tracker.",
            looks_like="A wave in time of one frequency, the same whatever axis moves.",
            remedy="Find what turns at this frequency and stop or isolate it; check "
            "the tracker's stand.",
        ),
        "de": Words(
            title="Schwingung",
            cause="Eine Pumpe, ein Lüfter, ein Antrieb oder der Boden rüttelt an "
            "Tisch, Spindel oder Tracker.",
            looks_like="Eine Welle in der Zeit mit einer einzigen Frequenz, gleich "
            "welche Achse fährt.",
            remedy="Suchen, was sich mit dieser Frequenz dreht, und es anhalten oder "
            "entkoppeln; das Stativ des Trackers prüfen.",
        ),
    }

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction."""
        if at.recorded is None:
            return []
        middle_s = 0.5 * float(at.time_s.min() + at.time_s.max())
        waves = [Vibration(direction, _SLOWEST_HZ, middle_s) for direction in LINEAR]
        return [self.offer(wave, [USUAL_MM] * 2, _SLOWEST_HZ) for wave in waves]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return frequencies, two to a period over the run."""
        if at.recorded is None:
            return None
        fastest = _FASTEST * at.machine.tracker.rate_hz
        step = 0.5 / max(float(np.ptp(at.time_s)), 1.0)
        return Scan(self.scanned, np.arange(_SLOWEST_HZ, fastest, step))

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave of time."""
        scan = self.scan(candidate, at)
        if scan is None:
            return None
        return make_time_wave(candidate.keys["direction"], at, scan.values)

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return frequency and amplitude."""
        return state_wave(self.scanned, found)
