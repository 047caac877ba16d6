"""Points as legs: what is known of a machine, and what a standstill would add."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from truepath.app.kinematics.machine import Machine
from truepath.app.motion.configurations import Configurations
from truepath.app.motion.motion_times import Legs, Stops
from truepath.app.motion.travel import add_resting_axes
from truepath.app.numerics.design_criteria import IntegratedVariance
from truepath.app.planning.design_state import DesignState
from truepath.app.planning.next_configuration import Climb, search_space

_LEAST_MOVE_MM = 1.0  # else standstills look like one
_LEAST_TURN_DEG = 10.0  # or a tenth of the travel


@dataclass(frozen=True)
class PointDesignState(DesignState):
    """What is known so far; a standstill measures a target's three coordinates."""

    order_is_free = True

    def rows(self, legs: Legs) -> Float64[np.ndarray, "n r p"]:
        """Return rows H of the standstill at each end, approached from the begin."""
        at = self.conditions(legs.end, np.sign(legs.step))
        return np.sqrt(self.drive.dwell_s) * (self.roots(at) @ self.model.jacobian(at))

    def fits(self, legs: Legs) -> Bool[np.ndarray, " n"]:
        """Tell which moves can be recognised.

        Every rotary axis turns: a target on a table that does not would not move.
        """
        turning = self.model.machine.rotary_axes
        if not turning:
            return self.drive.length(legs) >= _LEAST_MOVE_MM
        travel = np.array([axis.high - axis.low for axis in turning])
        turn = np.abs(legs.step)[:, ~np.asarray(self.drive.linear)]
        return np.all(turn >= np.minimum(_LEAST_TURN_DEG, 0.1 * travel), axis=1)

    def command(self, machine: Machine, stops: Stops) -> Configurations:
        """Return the stops as points."""
        position = add_resting_axes(machine, stops.position)
        dwell_s = np.full(len(stops), self.drive.dwell_s)
        names = self._name_target(len(stops))
        return Configurations(machine.axis_names, position, dwell_s, names)

    def better_places(
        self,
        covariance: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
    ) -> Float64[np.ndarray, "n a"]:
        """Return the summit of the exact criterion above a stop, of straight axes.

        There the noise is taken to be the same everywhere and in all directions, and
        the direction of approach to be none, which leaves rows that are polynomials.
        """
        if self.model.machine.rotary_axes:
            return np.empty((0, len(here)))

        def rows(position: Float64[np.ndarray, "n a"]) -> Float64[np.ndarray, "n r p"]:
            return self.model.jacobian(
                self.conditions(position, np.zeros_like(position))
            )

        root = self.roots(self.conditions(here[None], np.zeros((1, len(here)))))[0]
        variance = 3.0 / (self.drive.dwell_s * float(np.sum(root**2)))
        known = IntegratedVariance(covariance, self.gram)
        climb = Climb(known, rows, search_space(self.model), variance)
        return climb.climb_to_top(climb.climb_once(here)).position[None]
