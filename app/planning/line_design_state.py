"""What a line tells that is measured while the machine drives it.

Places along its steady part count. Along the travel a phase and a speed of each line
are unknown, as no clock is shared, and are projected out; where only deviations across
the path are used, that direction tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from app.kinematics.conditions import Conditions, RecordedState
from app.kinematics.machine import Machine
from app.motion.motion_times import Legs, Stops
from app.motion.travel import add_resting_axes
from app.planning.design_state import DesignState
from app.planning.predicted_cells import find_slopes_mm
from drivers.interfaces.records import Path

_PLACES = 10  # along a line: error motions of few knots bend less often
_MIDDLES = (np.arange(_PLACES) + 0.5) / _PLACES - 0.5  # of the steady part


@dataclass(frozen=True)
class LineDesignState(DesignState):
    """What is known so far, and what lines would add."""

    def rows(self, legs: Legs) -> Float64[np.ndarray, "n r p"]:
        """Return rows H of each line with HᵀH its information, timing left out."""
        n, step = len(legs), legs.step
        lost, seconds = self.drive.steady(legs)
        places = _place(legs, 0.5 + _MIDDLES * (1.0 - 2.0 * lost)[:, None])
        at = self.conditions(places, np.repeat(np.sign(step), _PLACES, axis=0))
        at = replace(at, recorded=self._record(at, legs))
        slope = find_slopes_mm(at, np.repeat(step, _PLACES, axis=0))
        pace = np.linalg.norm(slope, axis=1, keepdims=True)
        weight = np.sqrt(np.repeat(seconds, _PLACES) / _PLACES)
        root = self.roots(at, slope / np.maximum(pace, 1e-9))
        root = weight[:, None, None] * root
        rows = (root @ self.model.jacobian(at)).reshape(n, 3 * _PLACES, -1)
        if np.isinf(self.noise.jitter_mm2_s):
            return rows
        phase = np.einsum("nij,nj->ni", root, slope)
        speed = phase * np.tile(_MIDDLES, n)[:, None]
        timing = np.stack([phase, speed], axis=2)
        basis, _ = np.linalg.qr(timing.reshape(n, 3 * _PLACES, 2))
        return rows - basis @ (np.swapaxes(basis, 1, 2) @ rows)

    def fits(self, legs: Legs, feed_mm_min: float) -> Bool[np.ndarray, " n"]:
        """Tell which lines are driven at a steady feed for most of their length.

        The way of the target counts: an axis that turns may hardly move it.
        """
        if not self.model.machine.rotary_axes:
            return self.drive.length(legs) >= self.drive.shortest_mm(feed_mm_min)
        places = _place(legs, np.tile(np.linspace(0.0, 1.0, _PLACES), (len(legs), 1)))
        point_mm = self.conditions(places, np.zeros_like(places)).point_mm
        step_mm = np.diff(point_mm.reshape(len(legs), _PLACES, 3), axis=1)
        way_mm = np.linalg.norm(step_mm, axis=2).sum(axis=1)
        return way_mm >= self.drive.shortest_mm(feed_mm_min)

    def hold(
        self, ends: Float64[np.ndarray, "n a"], here: Float64[np.ndarray, " a"]
    ) -> Float64[np.ndarray, "n a"]:
        """Let linear axes move alone, rotary axes turn together or one, or all go."""
        machine, number = self.model.machine, np.arange(len(ends))
        if not machine.rotary_axes:
            return ends
        column = np.arange(len(machine.axes))
        first = len(machine.linear_axes)
        one = first + number // 4 % len(machine.rotary_axes)
        kind = (number % 4)[:, None]
        moves = np.select(
            [kind == 0, kind == 1, kind == 2],
            [column < first, column >= first, column == one[:, None]],
            default=True,
        )
        return np.where(moves, ends, here)

    def commanded(self, machine: Machine, stops: Stops) -> Path:
        """Return the path through the stops."""
        position = add_resting_axes(machine, stops.position)
        feed = np.append(stops.feed_mm_min[:1], self.drive.driven_feed(stops.legs))
        dwell_s = np.full(len(stops), self.drive.dwell_s)
        return Path(machine.axis_names, position, feed, dwell_s)

    def _record(self, at: Conditions, legs: Legs) -> RecordedState:
        """Return how fast each axis moves, for effects that depend on it.

        Every axis is taken to have reversed where its line begins.
        """
        speed = self.drive.driven_feed(legs) / 60.0
        rate = legs.step * (speed / np.maximum(self.drive.length(legs), 1e-9))[:, None]
        rate, first = (np.repeat(v, _PLACES, axis=0) for v in (rate, legs.begin))
        return RecordedState(
            rate,
            np.full(len(at), 1.0 / _PLACES),
            np.abs(at.position_mm - first),
            at.point_mm - self.station_mm,
            np.eye(3),
        )


def _place(
    legs: Legs, share: Float64[np.ndarray, "n k"]
) -> Float64[np.ndarray, "n*k a"]:
    """Return the positions at shares of each leg."""
    places = legs.begin[:, None] + share[:, :, None] * legs.step[:, None]
    return places.reshape(-1, places.shape[2])
