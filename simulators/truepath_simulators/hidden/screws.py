"""Screws, nuts and slides: play, wear, and errors that repeat with every turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath_simulators.hidden.effect import HiddenEffect, Occasion, error_motion
from truepath_simulators.hidden.motion import Motion


# Lost motion: the nut has play, the table follows when the screw has crossed it.
@dataclass(frozen=True, slots=True)
class Backlash(HiddenEffect):
    """Play of an axis in its own direction; positive widths lose motion."""

    name = "backlash"
    axis: str
    width_um: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis; half of the width to either side."""
        return cls(occasion.axis(rng), 2.0 * occasion.size_um)

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Distance of the table from the screw's position."""
        table = motion.play_mm(self.axis, 0.5e-3 * self.width_um, time_s)
        off = table - motion.position_mm(self.axis, time_s)
        return error_motion(f"E{self.axis}{self.axis}", off)


# A carriage with play in its guide: friction leans it to one side or the other.
_ARM_M = 0.33  # a turn moves the tool as far as a shift


@dataclass(frozen=True, slots=True)
class LateralBacklash(HiddenEffect):
    """The carriage leans by +h on the way up, by −h on the way down.

    motion : the error motion of the lean; half_width : h in µm or µrad
    turnover_mm : travel after a reversal in which the lean changes sides
    """

    name = "lateral-backlash"
    axis: str
    motion: str
    half_width: float
    turnover_mm: float = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random straightness or angle; an angle acts over a third of a metre."""
        axis = occasion.axis(rng)
        letter = str(rng.choice([c for c in "XYZABC" if c != axis]))
        half = occasion.size_um * float(rng.choice([-1.0, 1.0]))
        if letter in "ABC":
            half /= _ARM_M
        return cls(axis, f"E{letter}{axis}", half, float(rng.uniform(0.1, 1.0)))

    @property
    def _turns(self) -> bool:
        return self.motion[1] in "ABC"

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Lean, by the part of the play that friction has crossed."""
        half_mm = 0.5 * self.turnover_mm
        follows = motion.play_mm(self.axis, half_mm, time_s)
        lean = (motion.position_mm(self.axis, time_s) - follows) / half_mm
        unit = 1e-6 if self._turns else 1e-3
        return error_motion(self.motion, unit * self.half_width * lean)


# A screw worn where it works most: play there, and none elsewhere.
_TURNOVER_MM = 0.2


@dataclass(frozen=True, slots=True)
class WornScrew(HiddenEffect):
    """Lost motion of width exp(−½ ((u − middle) / spread)²), u the share of travel."""

    name = "worn-screw"
    in_catalogue = False
    unstated = ("middle", "spread")
    axis: str
    width_um: float
    middle: float
    spread: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random axis and position of the wear."""
        middle, spread = rng.uniform(0.3, 0.7), rng.uniform(0.08, 0.14)
        width_um = 6.0 * occasion.size_um
        return cls(occasion.axis(rng), width_um, float(middle), float(spread))

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Lag of the nut: half the local width, by the side it is on."""
        half_mm = 0.5 * _TURNOVER_MM
        follows = motion.play_mm(self.axis, half_mm, time_s)
        side = (motion.position_mm(self.axis, time_s) - follows) / half_mm
        off = (motion.share(self.axis, time_s) - self.middle) / self.spread
        half = 0.5e-3 * self.width_um * np.exp(-0.5 * off**2)
        return error_motion(f"E{2 * self.axis}", -half * side)


# A ball screw that wobbles: its error repeats with every turn.
_LEADS_MM = (5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)


@dataclass(frozen=True, slots=True)
class ScrewCyclic(HiddenEffect):
    """amplitude sin(angle + phase) of the screw's angle, and a small harmonic."""

    name = "screw-cyclic"
    axis: str
    lead_mm: float
    amplitude_um: float
    phase_rad: float
    second_share: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """One of the typical leads, and a second harmonic of at most a tenth."""
        return cls(
            occasion.axis(rng),
            float(rng.choice(_LEADS_MM)),
            occasion.size_um,
            float(rng.uniform(0.0, 2.0 * np.pi)),
            float(rng.uniform(0.0, 0.1)),
        )

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Error of the nut by the angle of the screw."""
        turned = motion.position_mm(self.axis, time_s) / self.lead_mm
        angle = 2.0 * np.pi * turned + self.phase_rad
        wave = np.sin(angle) + self.second_share * np.sin(2.0 * angle)
        return error_motion(f"E{self.axis}{self.axis}", 1e-3 * self.amplitude_um * wave)
