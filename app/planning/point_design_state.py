"""What a standstill tells: three coordinates of a target while it rests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from app.motion.configurations import Configurations
from app.motion.motion_times import Drive
from app.numerics.design_criteria import IntegratedVariance
from app.planning.design_state import DesignState
from app.planning.next_configuration import climb_from, search_space

_LEAST_MOVE_MM = 1.0  # else standstills look like one
_LEAST_TURN_DEG = 10.0  # or a tenth of the travel


@dataclass(frozen=True)
class PointDesignState(DesignState):
    """What is known so far, and what standstills would add."""

    def rows(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: Float64[np.ndarray, " n"],
        drive: Drive,
    ) -> Float64[np.ndarray, "n r p"]:
        """Return rows H of the standstill at each end, approached from the begin."""
        at = self.conditions(end, np.sign(end - begin))
        return np.sqrt(drive.dwell_s) * (self.roots(at) @ self.model.jacobian(at))

    @property
    def order_is_free(self) -> bool:
        """Yes: the approach alone depends on it."""
        return True

    def fits(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: float,
        drive: Drive,
    ) -> Bool[np.ndarray, " n"]:
        """Tell which moves are seen as such.

        Every rotary axis turns: a target on a table that does not would not move.
        """
        step = np.abs(end - begin)
        straight = np.asarray(drive.linear)
        if straight.all():
            return drive.length(begin, end) >= _LEAST_MOVE_MM
        return np.all(step[:, ~straight] >= self._least_turn_deg(), axis=1)

    def commanded(
        self,
        axes: tuple[str, ...],
        position: Float64[np.ndarray, "s a"],
        feed_mm_min: Float64[np.ndarray, " s"],
        drive: Drive,
    ) -> Configurations:
        """Return the stops as points."""
        names = (self.target.name,) * len(position) if self.target.name else ()
        dwell_s = np.full(len(position), drive.dwell_s)
        return Configurations(axes, position, dwell_s, names)

    def better_places(
        self,
        covariance: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
        drive: Drive,
    ) -> Float64[np.ndarray, "n a"]:
        """Return the summit of the exact criterion above a stop, of straight axes.

        There the noise is taken to be the same everywhere and in all directions, and
        the direction of approach to be none, which leaves rows that are polynomials.
        """
        if self.model.machine.rotary_axes:
            return np.empty((0, len(here)))

        def rows(
            position: Float64[np.ndarray, "n a"],
        ) -> Float64[np.ndarray, "n r p"]:
            still = np.zeros_like(position)
            return self.model.jacobian(self.conditions(position, still))

        told = self.roots(self.conditions(here[None], np.zeros((1, len(here)))))[0]
        variance = 3.0 / (drive.dwell_s * float(np.sum(told**2)))
        known = IntegratedVariance(covariance, self.gram)
        top = climb_from(known, rows, search_space(self.model), variance, here)
        return top.position[None]

    def _least_turn_deg(self) -> Float64[np.ndarray, " r"]:
        travel = [axis.high - axis.low for axis in self.model.machine.rotary_axes]
        return np.minimum(_LEAST_TURN_DEG, 0.1 * np.array(travel))
