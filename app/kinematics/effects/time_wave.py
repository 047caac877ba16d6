"""A periodic behaviour in time, slower than a second, that no cause explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    state_wave,
)
from app.kinematics.symbols import LINEAR

_FASTEST_HZ = 1.0
_FEWEST = 3.0  # periods in the run: what is slower wanders


@dataclass(frozen=True)
class TimeWave(Effect):
    """Sine and cosine of time in one direction.

    middle_s : of the run, where the phase is 0: so it does not turn with the period
    """

    kind = "time-wave"
    role = Role.STRUCTURE
    units = {"sin": "mm", "cos": "mm"}
    direction: str
    period_s: float
    middle_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        rate = np.full(len(at), 2.0 * np.pi / self.period_s)
        angle = rate * (at.time_s - self.middle_s)
        return columns_along(self.direction, average_over_cells(angle, rate, at))


class TimeWaveFamily(Family):
    """Every direction, the period scanned down to a second."""

    name = "time-wave"
    role = Role.STRUCTURE
    scanned = "period_s"
    keys = {"direction": DIRECTION}
    words = {
        "en": Words(
            title="Wave in time",
            cause="Something switches or breathes with a steady period: coolant, air "
            "conditioning, a pump's pressure.",
            looks_like="All points move to and fro with time, whatever axis moves.",
            remedy="Find what runs with this period; measure with it off, or average "
            "over whole periods.",
        ),
        "de": Words(
            title="Welle in der Zeit",
            cause="Etwas schaltet oder atmet mit fester Periode: Kühlmittel, "
            "Klimaanlage, der Druck einer Pumpe.",
            looks_like="Alle Punkte bewegen sich mit der Zeit hin und her, gleich "
            "welche Achse fährt.",
            remedy="Suchen, was mit dieser Periode läuft; ohne es messen oder über "
            "ganze Perioden mitteln.",
        ),
    }

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a direction."""
        middle_s = 0.5 * float(at.time_s.min() + at.time_s.max())
        waves = [TimeWave(direction, 20.0, middle_s) for direction in LINEAR]
        return [self.offer(w, [USUAL_MM] * 2, w.period_s) for w in waves]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan | None:
        """Return periods from a second to a third of the run."""
        span = float(np.ptp(at.time_s))
        frequency = np.arange(_FEWEST / span, _FASTEST_HZ, 0.25 / span)
        return Scan(self.scanned, 1.0 / frequency[::-1]) if len(frequency) else None

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave | None:
        """Return the scan as a wave of time."""
        scan = self.scan(candidate, at)
        if scan is None or at.recorded is None:
            return None
        return make_time_wave(candidate.keys["direction"], at, 1.0 / scan.values)

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return period and amplitude."""
        return state_wave(self.scanned, found)

    def list_covariates(self, candidate: Candidate) -> list[str]:
        """Return the time."""
        return ["t"]

    def describe(self, candidate: Candidate, stated: Mapping[str, Quantity]) -> str:
        """Return direction, period and amplitude."""
        return (
            f"a wave in time along {candidate.keys['direction']} with a period of "
            f"{stated['period_s'].value:.3g} s and an amplitude of "
            f"{stated['amplitude_um'].value:.2g} µm"
        )
