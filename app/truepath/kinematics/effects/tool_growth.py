"""Spindle, head or column that warms: the tool shifts along itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Scan,
    read_words,
)
from truepath.kinematics.effects.thermal_growth import list_time_constants

_ALONG = 2  # the tool's own Z is the spindle (ISO 841)


@dataclass(frozen=True)
class ToolGrowth(Effect):
    """A shift of the tool along itself; it approaches its end, θ, exponentially."""

    kind = "tool-growth"
    units = {"": "mm"}
    tau_s: float
    start_s: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Direction of the tool times the rise; 0 where no tool is measured."""
        rise = -np.expm1(-(at.time_s - self.start_s) / self.tau_s)
        return (at.chain.tool_frame[:, :, _ALONG] * rise[:, None])[:, :, None]


class ToolGrowthFamily(Family):
    """One candidate, its time constant scanned."""

    name = "spindle-growth"
    effect = ToolGrowth
    ends_with_run = True
    varies_with = "time"
    value_name = "tau_s"
    words = read_words("""
        [en]
        title = Growth of spindle or column
        cause = Spindle, head or column warms or cools during the measurement: after a
            start, by its own work, by the hall.
        looks_like = All lines shift along the tool, fast at first and then slower,
            whatever axis moves.
        remedy = Warm the spindle up before measuring and before work; enter its growth
            in the controller's temperature compensation.
        [de]
        title = Dehnung von Spindel oder Ständer
        cause = Spindel, Kopf oder Ständer erwärmt sich oder kühlt während der Messung
            ab: nach dem Einschalten, durch eigene Arbeit oder die Halle.
        looks_like = Alle Geraden verschieben sich entlang des Werkzeugs, erst schnell
            und dann langsamer, gleich welche Achse fährt.
        remedy = Die Spindel vor dem Messen und vor der Arbeit warmlaufen lassen; ihre
            Dehnung in die Temperaturkompensation der Steuerung eintragen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """A single candidate, at half the Run's length."""
        half_s = 0.5 * max(float(np.ptp(at.time_s)), 1.0)
        effect = ToolGrowth(half_s, float(at.time_s.min()))
        return [self.make_candidate(effect, [2.0 * USUAL_MM])]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Time constants in s."""
        del candidate
        return Scan(self.value_name, list_time_constants(at))

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Growth in µm, and time constant in s."""
        growth = found.parameters[0].scale(1e3)
        return {"growth_um": growth, "tau_s": found.value}
