"""Motions of all points in time: drift, a step, vibration, slower waves."""

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
    Scan,
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


@dataclass(frozen=True)
class TableDrift(Effect):
    """A shift of all points that grows with time, from the middle of the run."""

    kind = "table-drift"
    role = Role.MEASUREMENT
    units = dict.fromkeys("xyz", "mm/s")
    middle_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        return (at.time_s - self.middle_s)[:, None, None] * np.eye(3)


class TableDriftFamily(Family):
    """A single candidate."""

    name = "table-drift"
    effect = TableDrift
    varies_with = "time"
    stated = {f"rate_um_per_s[{axis}]": 1e3 for axis in "xyz"}
    words = read_words("""
        [en]
        title = Drift of tracker or table
        cause = The tracker's stand, the table or its clamping creeps, or the tracker
            had not warmed up.
        looks_like = All lines shift evenly with time, whatever axis moves.
        remedy = Let the tracker warm up and settle, clamp its base, close the path by
            measuring the first lines again.
        [de]
        title = Drift von Tracker oder Tisch
        cause = Das Stativ des Trackers, der Tisch oder seine Spannung kriecht, oder der
            Tracker war nicht warmgelaufen.
        looks_like = Alle Geraden verschieben sich gleichmäßig mit der Zeit, gleich
            welche Achse fährt.
        remedy = Den Tracker warmlaufen und sich setzen lassen, seinen Fuß festspannen,
            die Bahn schließen und dazu die ersten Geraden noch einmal messen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        span = max(float(np.ptp(at.time_s)), 1.0)
        return [
            self.make_candidate(TableDrift(at.middle_s), [2.0 * USUAL_MM / span] * 3)
        ]


_STEP_S = 2.0
_MOST = 80


@dataclass(frozen=True)
class SetupStep(Effect):
    """All points shift at one moment, by half of it to either side of the mean."""

    kind = "setup-step"
    role = Role.MEASUREMENT
    units = dict.fromkeys("xyz", "mm")
    t_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        side = np.where(at.time_s >= self.t_s, 0.5, -0.5)
        return side[:, None, None] * np.eye(3)


class SetupStepFamily(Family):
    """One candidate, its moment scanned."""

    name = "setup-step"
    effect = SetupStep
    varies_with = "time"
    is_smooth = False
    happens_once = True
    value_name = "t_s"
    words = read_words("""
        [en]
        title = Step of the set-up
        cause = Tracker, its stand, the target's nest or the workpiece was knocked or
            slipped.
        looks_like = From one moment on all lines are shifted by the same amount.
        remedy = Measure again; until then, use the data with the step taken out.
        [de]
        title = Sprung des Aufbaus
        cause = Tracker, sein Stativ, die Aufnahme des Reflektors oder das Werkstück
            wurde angestoßen oder ist verrutscht.
        looks_like = Von einem Zeitpunkt an sind alle Geraden um denselben Betrag
            verschoben.
        remedy = Noch einmal messen; bis dahin die Daten ohne den Sprung verwenden.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        return [self.make_candidate(SetupStep(at.middle_s), [USUAL_MM] * 3)]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Moments, none so early or late that one line would decide.

        Mostly between lines: a step elsewhere splits a line in two.
        """
        first, last = float(at.time_s.min()), float(at.time_s.max())
        margin = 0.02 * (last - first)
        count = int(min(_MOST, max(8, (last - first) / _STEP_S)))
        even = np.linspace(first + margin, last - margin, count)
        order = np.argsort(at.time_s, kind="stable")
        time_s, line = at.time_s[order], at.line[order]
        ends = np.flatnonzero((np.diff(line) != 0) | (line[1:] < 0))
        between = 0.5 * (time_s[ends] + time_s[ends + 1])
        inside = (between > even[0]) & (between < even[-1])
        return Scan(self.value_name, np.union1d(even, between[inside]))

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        steps = zip("xyz", found.parameters, strict=True)
        shifts = {f"step_um[{axis}]": step.scale(1e3) for axis, step in steps}
        return {"t_s": found.value, **shifts}


_LIMIT_HZ = 1.0  # between slow waves and vibration


class SinusoidOfTime(Sinusoid):
    """Sine and cosine of time in one direction.

    middle_s : of the Run, where the phase is 0, so that it hardly depends on the period
    """

    direction: str
    middle_s: float

    @property
    def origin(self) -> float:
        return self.middle_s

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
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
        return self.frequency_hz

    def jacobian_in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 2"]:
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
        waves = [TimeWave(d, 20.0, at.middle_s) for d in LINEAR]
        return [self.make_candidate(wave, [USUAL_MM] * 2) for wave in waves]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Waves from a third of the Run to a second, four steps to one.

        Slower ones belong to the wander.
        """
        span_s = float(np.ptp(at.time_s))
        return np.arange(3.0 / span_s, _LIMIT_HZ, 0.25 / span_s)


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
        if at.recorded is None:
            return []
        waves = [Vibration(d, _LIMIT_HZ, at.middle_s) for d in LINEAR]
        return [self.make_candidate(wave, [USUAL_MM] * 2) for wave in waves]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Frequencies in Hz, two steps to a period over the Run."""
        fastest = 0.45 * at.machine.tracker.rate_hz
        step = 0.5 / max(float(np.ptp(at.time_s)), 1.0)
        return np.arange(_LIMIT_HZ, fastest, step)
