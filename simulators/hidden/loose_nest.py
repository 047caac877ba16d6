"""A target that sits loose in its nest: each start from rest seats it anew."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect, Occasion
from truepath.simulators.hidden.motion import Motion

_SEATS = 1000


@dataclass(frozen=True, slots=True)
class LooseNest(HiddenEffect):
    """Another shift on every line, at random: spread_um along each axis."""

    name = "loose-nest"
    in_catalogue = False
    unstated = ("chance",)
    spread_um: float
    chance: int

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Draw how it will sit."""
        return cls(0.7 * occasion.size_um, int(rng.integers(1 << 30)))

    def shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Return where it sits on each line."""
        seats = np.random.default_rng(self.chance).normal(size=(_SEATS, 3))
        row = motion.timeline.rows(time_s) % _SEATS
        return 1e-3 * self.spread_um * seats[row]
