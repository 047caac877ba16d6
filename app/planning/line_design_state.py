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
from app.kinematics.machine import LinearAxis
from app.motion.motion_times import Drive
from app.planning.design_state import DesignState
from drivers.interfaces.records import Path

_PLACES = 10  # along a line: error motions of few knots bend less often
_AHEAD = 1e-4  # of a line, to see where the target is going
_MIDDLES = (np.arange(_PLACES) + 0.5) / _PLACES - 0.5  # of the steady part


@dataclass(frozen=True)
class LineDesignState(DesignState):
    """What is known so far, and what lines would add."""

    def rows(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: Float64[np.ndarray, " n"],
        drive: Drive,
    ) -> Float64[np.ndarray, "n r p"]:
        """Return rows H of each line with HᵀH its information, timing left out."""
        lost, seconds = drive.steady(begin, end, feed_mm_min)
        share = 0.5 + _MIDDLES * (1.0 - 2.0 * lost)[:, None]
        step = end - begin
        places = (begin[:, None] + share[:, :, None] * step[:, None]).reshape(
            -1, begin.shape[1]
        )
        at = self.conditions(places, np.repeat(np.sign(step), _PLACES, axis=0))
        at = replace(at, recorded=self._around(at, begin, end, feed_mm_min, drive))
        slope = self._slopes_mm(places, np.repeat(step, _PLACES, axis=0))
        pace = np.linalg.norm(slope, axis=1, keepdims=True)
        direction = slope / np.maximum(pace, 1e-9)
        weight = np.sqrt(np.repeat(seconds, _PLACES) / _PLACES)
        root = weight[:, None, None] * self.roots(at, direction)
        rows = (root @ self.model.jacobian(at)).reshape(
            len(begin), 3 * _PLACES, self.model.size
        )
        if np.isinf(self.noise.jitter_mm2_s):
            return rows
        timing = self._timing(root, slope).reshape(len(begin), 3 * _PLACES, -1)
        return _project_out(rows, timing)

    @property
    def order_is_free(self) -> bool:
        """No: the order of the stops makes the lines."""
        return False

    def fits(
        self,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: float,
        drive: Drive,
    ) -> Bool[np.ndarray, " n"]:
        """Tell which lines are driven at a steady feed for most of their length.

        The way of the target counts: an axis that turns may hardly move it.
        """
        if not self.model.machine.rotary_axes:
            return drive.length(begin, end) >= drive.shortest_mm(feed_mm_min)
        share = np.linspace(0.0, 1.0, _PLACES)
        places = begin[:, None] + share[:, None] * (end - begin)[:, None]
        places = places.reshape(-1, begin.shape[1])
        point_mm = self.conditions(places, np.zeros_like(places)).point_mm
        step_mm = np.diff(point_mm.reshape(len(begin), _PLACES, 3), axis=1)
        way_mm = np.linalg.norm(step_mm, axis=2).sum(axis=1)
        return way_mm >= drive.shortest_mm(feed_mm_min)

    def hold(
        self, ends: Float64[np.ndarray, "n a"], here: Float64[np.ndarray, " a"]
    ) -> Float64[np.ndarray, "n a"]:
        """Let linear axes move alone, rotary axes turn together or one, or all go."""
        linear = np.array(
            [isinstance(axis, LinearAxis) for axis in self.model.machine.axes]
        )
        if linear.all():
            return ends
        number = np.arange(len(ends))
        kind, turning = number % 4, np.flatnonzero(~linear)
        moves = np.ones(ends.shape, bool)
        moves[kind == 0] = linear
        moves[kind == 1] = ~linear
        one = np.flatnonzero(kind == 2)
        moves[one] = False
        moves[one, turning[number[one] // 4 % len(turning)]] = True
        return np.where(moves, ends, here)

    def commanded(
        self,
        axes: tuple[str, ...],
        position: Float64[np.ndarray, "s a"],
        feed_mm_min: Float64[np.ndarray, " s"],
        drive: Drive,
    ) -> Path:
        """Return the path through the stops."""
        n, at = len(position), position[:, : len(drive.linear)]
        feed = feed_mm_min.copy()
        feed[1:] = drive.driven_feed(at[:-1], at[1:], feed[1:])
        return Path(axes, position, feed, np.full(n, drive.dwell_s))

    def better_places(
        self,
        covariance: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
        drive: Drive,
    ) -> Float64[np.ndarray, "n a"]:
        """Return none: two lines meet in a stop, and no exact optimum is known."""
        return np.empty((0, len(here)))

    def _around(
        self,
        at: Conditions,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
        feed_mm_min: Float64[np.ndarray, " n"],
        drive: Drive,
    ) -> RecordedState:
        """Return how fast each axis moves, for effects that depend on it.

        Every axis is taken to have reversed where its line begins.
        """
        length = np.maximum(drive.length(begin, end), 1e-9)
        speed = drive.driven_feed(begin, end, feed_mm_min) / 60.0
        rate = (end - begin) * (speed / length)[:, None]
        rate, first = (np.repeat(v, _PLACES, axis=0) for v in (rate, begin))
        return RecordedState(
            rate,
            np.full(len(at), 1.0 / _PLACES),
            np.abs(at.position_mm - first),
            at.point_mm - self.station_mm,
            np.eye(3),
        )

    def _slopes_mm(
        self, places: Float64[np.ndarray, "m a"], step: Float64[np.ndarray, "m a"]
    ) -> Float64[np.ndarray, "m 3"]:
        """Return how the target's place changes with the share of its line."""
        still = np.zeros_like(places)
        behind, ahead = (
            self.conditions(places + sign * _AHEAD * step, still).point_mm
            for sign in (-1.0, 1.0)
        )
        return (ahead - behind) / (2.0 * _AHEAD)

    def _timing(
        self, root: Float64[np.ndarray, "m 3 3"], slope_mm: Float64[np.ndarray, "m 3"]
    ) -> Float64[np.ndarray, "m 3 t"]:
        """Return the rows of phase and speed."""
        pulled = np.einsum("nij,nj->ni", root, slope_mm)
        lag = np.tile(_MIDDLES, len(root) // _PLACES)
        return np.stack([pulled, pulled * lag[:, None]], axis=2)


def _project_out(
    rows: Float64[np.ndarray, "l m p"], timing: Float64[np.ndarray, "l m t"]
) -> Float64[np.ndarray, "l m p"]:
    """Return whitened rows of many lines less what the timing of each explains."""
    basis, _ = np.linalg.qr(timing)
    return rows - basis @ (np.swapaxes(basis, 1, 2) @ rows)
