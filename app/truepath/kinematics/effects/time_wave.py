"""Motions of all points in time: vibration, slower waves, wander."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Wave,
    read_words,
)
from truepath.kinematics.effects.keys import DIRECTION
from truepath.kinematics.effects.sinusoid import (
    Sinusoid,
    SinusoidFamily,
    sine_and_cosine,
)
from truepath.kinematics.machine.symbols import LINEAR

_LIMIT_HZ = 1.0  # between both
_FASTEST = 0.45  # of the tracker's rate
_FEWEST = 3.0  # periods in the Run: slower ones belong to the wander


class SinusoidOfTime(Sinusoid):
    """Sine and cosine of time in one direction.

    middle_s : of the Run, where the phase is 0, so that it hardly depends on the period
    """

    direction: str
    middle_s: float

    @property
    def origin(self) -> float:
        """The middle of the Run, s."""
        return self.middle_s

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Wave of time."""
        one = np.ones(len(at))
        return Wave(columns_along(self.direction, one)[:, :, 0], at.time_s, one, waves)


@dataclass(frozen=True)
class TimeWave(SinusoidOfTime):
    """A wave slower than a second."""

    kind = "time-wave"
    role = Role.STRUCTURE
    period_name = "period_s"
    direction: str
    period_s: float
    middle_s: float


@dataclass(frozen=True)
class Vibration(SinusoidOfTime):
    """A wave of 1 Hz or faster."""

    kind = "vibration"
    role = Role.MEASUREMENT
    direction: str
    frequency_hz: float
    middle_s: float

    @property
    def wave_number(self) -> float:
        """Waves per second."""
        return self.frequency_hz

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 2"]:
        """Direction times the waves."""
        angle = 2.0 * np.pi * self.frequency_hz * (time_s - self.middle_s)
        return columns_along(self.direction, sine_and_cosine(angle))


class TimeWaveFamily(SinusoidFamily):
    """One candidate per direction, the period scanned down to a second."""

    name = "time-wave"
    effect = TimeWave
    ends_with_run = True
    value_name = "period_s"
    keys = {"direction": DIRECTION}
    covariates = ("t",)
    sentence = (
        "a wave in time along {direction} with a period of {period_s:.3g} s and an "
        "amplitude of {amplitude_um:.2g} µm"
    )
    words = read_words("""
        [en]
        title = Wave in time
        cause = Something switches or breathes with a steady period: coolant, air
            conditioning, a pump's pressure.
        looks_like = All points move to and fro with time, whatever axis moves.
        remedy = Find what runs with this period; measure with it off, or average over
            whole periods.
        [de]
        title = Welle in der Zeit
        cause = Etwas schaltet oder atmet mit fester Periode: Kühlmittel, Klimaanlage,
            der Druck einer Pumpe.
        looks_like = Alle Punkte bewegen sich mit der Zeit hin und her, gleich welche
            Achse fährt.
        remedy = Suchen, was mit dieser Periode läuft; ohne es messen oder über ganze
            Perioden mitteln.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per direction."""
        waves = [TimeWave(d, 20.0, at.middle_s) for d in LINEAR]
        return [self.make_candidate(wave, [USUAL_MM] * 2) for wave in waves]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Waves from a third of the Run to a second, four steps to one."""
        span_s = float(np.ptp(at.time_s))
        return np.arange(_FEWEST / span_s, _LIMIT_HZ, 0.25 / span_s)


class VibrationFamily(SinusoidFamily):
    """One candidate per direction, the frequency scanned up to the samples' limit."""

    name = "vibration"
    effect = Vibration
    tracker_may_imitate = True  # its head swings about the target
    value_name = "frequency_hz"
    scans_periods = False
    keys = {"direction": DIRECTION}
    words = read_words("""
        [en]
        title = Vibration
        cause = A pump, a fan, a drive or the floor shakes table, spindle or tracker, or
            the tracker's head swings about its target.
        looks_like = A wave in time of one frequency, the same whatever axis moves.
        remedy = Look at a reflector that is fixed to the floor: if it swings too, check
            the tracker and its stand; else find what turns at this frequency and stop
            or isolate it.
        [de]
        title = Schwingung
        cause = Eine Pumpe, ein Lüfter, ein Antrieb oder der Boden rüttelt an Tisch,
            Spindel oder Tracker, oder der Kopf des Trackers pendelt.
        looks_like = Eine Welle in der Zeit mit einer einzigen Frequenz, gleich welche
            Achse fährt.
        remedy = Einen am Boden befestigten Reflektor ansehen: Schwingt er auch, Tracker
            und Stativ prüfen; sonst suchen, was sich mit dieser Frequenz dreht, und es
            anhalten oder entkoppeln.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per direction; none without a recording."""
        if at.recorded is None:
            return []
        waves = [Vibration(d, _LIMIT_HZ, at.middle_s) for d in LINEAR]
        return [self.make_candidate(wave, [USUAL_MM] * 2) for wave in waves]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Frequencies in Hz, two steps to a period over the Run."""
        fastest = _FASTEST * at.machine.tracker.rate_hz
        step = 0.5 / max(float(np.ptp(at.time_s)), 1.0)
        return np.arange(_LIMIT_HZ, fastest, step)


_HALF_WAVES = range(1, 13)


@dataclass(frozen=True)
class TimeWander(Effect):
    """A cosine series over the Run in one direction; θ by number of half waves."""

    kind = "time-wander"
    role = Role.STRUCTURE
    units = {f"{k}": "mm" for k in _HALF_WAVES}
    direction: str
    first_s: float
    span_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Direction times the cosines."""
        angle = np.pi * (at.time_s - self.first_s) / self.span_s
        return columns_along(self.direction, np.cos(angle[:, None] * [*_HALF_WAVES]))


class TimeWanderFamily(Family):
    """One candidate per direction."""

    name = "time-wander"
    effect = TimeWander
    ends_with_run = True
    varies_with = "time"
    keys = {"direction": DIRECTION}
    covariates = ("t",)
    sentence = "a slow wander along {direction} of {rms_um:.2g} µm (root mean square)"
    words = read_words("""
        [en]
        title = Slow wander in time
        cause = Mount, table or air that wanders: sun, draught, a hall that cools.
        looks_like = All points shift slowly to and fro with time, whatever axis moves.
        remedy = Let all settle, shield it from draught and sun, measure faster; repeat
            lines to see it.
        [de]
        title = Langsames Wandern mit der Zeit
        cause = Halterung, Tisch oder Luft wandert: Sonne, Zugluft, eine abkühlende
            Halle.
        looks_like = Alle Punkte verschieben sich mit der Zeit langsam hin und her,
            gleich welche Achse fährt.
        remedy = Alles zur Ruhe kommen lassen, vor Zugluft und Sonne schützen, schneller
            messen; Geraden wiederholen, um es zu sehen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per direction; slower waves are typically larger."""
        first_s, span_s = float(at.time_s.min()), max(float(np.ptp(at.time_s)), 1.0)
        usual = USUAL_MM / np.array(_HALF_WAVES)
        return [
            self.make_candidate(TimeWander(d, first_s, span_s), usual) for d in LINEAR
        ]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Root mean square over the Run, µm."""
        half = np.full(len(_HALF_WAVES), 0.5)
        return {"rms_um": found.root_mean_square(half).scale(1e3)}
