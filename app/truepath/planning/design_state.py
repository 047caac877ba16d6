"""Information on a machine before the next leg, and the information of a leg.

A leg is a motion from one stop to the next: a line that is measured on the way, or a
move to a point that is measured at rest. The criterion is the integrated variance J =
tr(G C) of the volumetric error over the travel (brunn-hanebeck-2005, eq. 34–36), C the
covariance of the error motions, G the Gram matrix.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.alignment.observations.cell_blocks import STANDSTILL_SETTLE_S
from truepath.alignment.observations.segmentation import RAMP_SETTLE_S
from truepath.kinematics.conditions import Conditions, RecordedState, observe_targets
from truepath.kinematics.machine.machine import Machine, Target
from truepath.kinematics.model import MachineModel
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import Drive, Legs, Stops
from truepath.motion.workspace import add_resting_axes
from truepath.numerics.scaled_cholesky import ScaledCholesky
from truepath.planning.simulated_cells import compute_slopes_mm
from truepath_drivers.interfaces.records import Path


@dataclass(frozen=True, slots=True)
class ExpectedNoise:
    """Noise of the tracker, white and correlated together, as if it were white.

    density_s : (2,) along and across the beam: variance of the mean over a second, in
        units of the specified variance of one sample
    jitter_mm2_s : the same of the feed, along the travel of a line; infinite where only
        deviations across the path are used
    """

    density_s: tuple[float, float]
    jitter_mm2_s: float


@dataclass(frozen=True)
class DesignState(ABC):
    """Present information, and how legs are measured.

    model : effects of the machine, then the tracker's pose
    precision : (p, p) information so far, prior included
    gram : (p, p), θᵀ G θ is the mean square of the volumetric error, mm²
    station_mm : (3,) of the tracker, in the frame that it is mounted on
    drive : motion limits of the machine, and the dwell at stops
    order_is_free : stops may be permuted; only their approach depends on the order
    """

    model: MachineModel
    target: Target
    precision: Float64[np.ndarray, "p p"]
    gram: Float64[np.ndarray, "p p"]
    station_mm: Float64[np.ndarray, "3"]
    noise: ExpectedNoise
    drive: Drive
    order_is_free = False

    @abstractmethod
    def rows(self, legs: Legs) -> Float64[np.ndarray, "n r p"]:
        """Rows H of each leg with HᵀH its information."""

    @abstractmethod
    def fits(self, legs: Legs) -> Bool[np.ndarray, " n"]:
        """Mask of the legs that are long enough to be recognised and measured."""

    @abstractmethod
    def command(self, machine: Machine, stops: Stops) -> Commanded:
        """The stops as a path or as points for all axes of the machine."""

    def restrict_axes(
        self, ends: Float64[np.ndarray, "n a"], here: Float64[np.ndarray, " a"]
    ) -> Float64[np.ndarray, "n a"]:
        """Ends of legs from `here`; a design may keep some axes of some at rest."""
        return ends

    def find_better_positions(
        self,
        covariance: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
    ) -> Float64[np.ndarray, "n a"]:
        """Candidates that may improve a stop that is already good.

        covariance : of the parameters, without the legs that meet in the stop
        """
        return np.empty((0, len(here)))

    def _name_target(self, rows: int) -> tuple[str, ...]:
        return (self.target.name,) * rows if self.target.name else ()

    @property
    def integrated_variance(self) -> float:
        """J, mm² (brunn-hanebeck-2005, eq. 34)."""
        return float(np.sum(inverse(self.precision) * self.gram))

    def information(self, legs: Legs) -> Float64[np.ndarray, "p p"]:
        """Sum over all legs."""
        if not len(legs):
            return np.zeros_like(self.precision)
        rows = self.rows(legs)
        flat = rows.reshape(-1, rows.shape[2])
        return flat.T @ flat

    def add(self, precision: Float64[np.ndarray, "p p"]) -> DesignState:
        return replace(self, precision=self.precision + precision)

    def conditions(
        self, position: Float64[np.ndarray, "n a"], approach: Float64[np.ndarray, "n a"]
    ) -> Conditions:
        """For the design's target, approached by motions of these signs."""
        at = observe_targets(self.model.machine, position, [self.target])
        return replace(at, approach=approach)

    def roots(
        self,
        at: Conditions,
        direction: Float64[np.ndarray, "n 3"] | None = None,
        jitter_mm2_s: float | Float64[np.ndarray, " n"] = 0.0,
    ) -> Float64[np.ndarray, "n 3 3"]:
        """W with WᵀW the information of one second at each position, 1/mm².

        direction : of travel, in which the jitter counts
        """
        beam = at.point_mm - self.station_mm
        distance = np.linalg.norm(beam, axis=1)
        beam = beam / distance[:, None]
        stated = at.machine.tracker.sigma_mm(distance) ** 2 * self.noise.density_s
        along, across = (stated**-0.5).T[:, :, None, None]
        root = across * np.eye(3)
        root = root + (along - across) * beam[:, :, None] * beam[:, None, :]
        if direction is None:
            return root
        # P − w P u uᵀ P is R (1 − w s sᵀ) R with s = R u, the root of P being R.
        seen = (root @ direction[:, :, None])[:, :, 0]
        total = np.maximum((seen**2).sum(axis=1), 1e-30)
        kept = 1.0 / (1.0 + np.asarray(jitter_mm2_s) * total)  # 1 − w sᵀ s
        cut = (1.0 - np.sqrt(kept)) / total
        pulled = (seen[:, None, :] @ root)[:, 0]
        return root - (cut[:, None] * seen)[:, :, None] * pulled[:, None, :]


def inverse(matrix: Float64[np.ndarray, "p p"]) -> Float64[np.ndarray, "p p"]:
    """Of a positive definite matrix of different units."""
    return ScaledCholesky.of(matrix).invert()


_STEADY = 10  # positions along a line: error motions of few knots bend less often
_MIDDLES = (np.arange(_STEADY) + 0.5) / _STEADY - 0.5  # of the steady part
# The mean position on a ramp and settling after it, in shares of its length, and how
# fast the machine is there.
_ON_RAMP, _PACE = 0.35, 0.7
_PLACES = _STEADY + 3  # two ramps, and the standstill at the end
_LEAST_S, _SAMPLES = 0.1, 30  # at a steady feed: less is not taken for a line


@dataclass(frozen=True)
class LineDesignState(DesignState):
    """Present information; a line is measured while the machine moves.

    Along the travel a phase and a speed of its steady part are unknown, as no clock is
    shared, and are projected out; on ramps, and where only deviations across the path
    are used, that direction has no information. The standstill at its end has all
    three.
    """

    def rows(self, legs: Legs) -> Float64[np.ndarray, "n r p"]:
        """Rows H of each line with HᵀH its information, timing projected out."""
        n, step = len(legs), np.repeat(legs.step, _PLACES, axis=0)
        lost, seconds = self.drive.steady(legs)
        on_ramp = _ON_RAMP * lost[:, None]
        steady = 0.5 + _MIDDLES * (1.0 - 2.0 * lost)[:, None]
        share = np.hstack([steady, on_ramp, 1.0 - on_ramp, np.ones((n, 1))])
        at = self.conditions(_place(legs, share), np.sign(step))
        at = replace(at, recorded=self._record(at, legs))
        slope = compute_slopes_mm(at, step)
        pace = np.linalg.norm(slope, axis=1, keepdims=True)
        jitter = np.tile(_PLACES * [np.inf], (n, 1))
        jitter[:, :_STEADY], jitter[:, -1] = self.noise.jitter_mm2_s, 0.0
        root = self.roots(at, slope / np.maximum(pace, 1e-9), jitter.ravel())
        root = np.sqrt(self._share_time(legs, seconds).ravel())[:, None, None] * root
        rows = (root @ self.model.jacobian(at)).reshape(n, 3 * _PLACES, -1)
        if np.isinf(self.noise.jitter_mm2_s):
            return rows
        phase = np.einsum("nij,nj->ni", root, slope).reshape(n, _PLACES, 3)[:, :_STEADY]
        timing = np.stack([phase, phase * _MIDDLES[:, None]], axis=3)
        basis, _ = np.linalg.qr(timing.reshape(n, 3 * _STEADY, 2))
        along = rows[:, : 3 * _STEADY]
        along -= basis @ (np.swapaxes(basis, 1, 2) @ along)
        return rows

    def _share_time(
        self, legs: Legs, steady_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n k"]:
        moving_s = self.drive.times_s(legs) - self.drive.dwell_s
        ramp_s = np.maximum(0.5 * (moving_s - steady_s) - RAMP_SETTLE_S, 0.0)
        ramp_s[self.drive.turns(legs)] = 0.0  # on a curve a ramp has no information
        dwell_s = max(self.drive.dwell_s - 2.0 * STANDSTILL_SETTLE_S, 0.0)
        each = [steady_s / _STEADY, ramp_s, np.full(len(legs), dwell_s)]
        return np.repeat(np.stack(each, axis=1), [_STEADY, 2, 1], axis=1)

    def fits(self, legs: Legs) -> Bool[np.ndarray, " n"]:
        """Mask of the lines at a steady feed for most of their length.

        And long enough for the tracker's rate. The path of the target counts: an axis
        that turns may hardly move it.
        """
        shortest_mm = self.drive.shortest_mm(legs.feed_mm_min)
        least_s = _SAMPLES / self.model.machine.tracker.rate_hz
        enough = self.drive.steady(legs)[1] >= max(least_s, _LEAST_S)
        if not self.model.machine.rotary_axes:
            return enough & (self.drive.length(legs) >= shortest_mm)
        places = _place(legs, np.tile(np.linspace(0.0, 1.0, _STEADY), (len(legs), 1)))
        point_mm = self.conditions(places, np.zeros_like(places)).point_mm
        step_mm = np.diff(point_mm.reshape(len(legs), _STEADY, 3), axis=1)
        way_mm = np.linalg.norm(step_mm, axis=2).sum(axis=1)
        return enough & (way_mm >= shortest_mm)

    def restrict_axes(
        self, ends: Float64[np.ndarray, "n a"], here: Float64[np.ndarray, " a"]
    ) -> Float64[np.ndarray, "n a"]:
        """Linear axes alone, rotary axes together or one, or all, in turn."""
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

    def command(self, machine: Machine, stops: Stops) -> Path:
        """A path through the stops, with the feeds that the machine reaches."""
        position = add_resting_axes(machine, stops.position)
        feed = np.append(stops.feed_mm_min[:1], self.drive.limited_feed(stops.legs))
        dwell_s = np.full(len(stops), self.drive.dwell_s)
        names = ()
        if self.model.machine.rotary_axes:
            names = self._name_target(len(stops))
        return Path(machine.axis_names, position, feed, dwell_s, names)

    def _record(self, at: Conditions, legs: Legs) -> RecordedState:
        """Rates of the axes, for effects that depend on them.

        Every axis is taken to have reversed where its line begins.
        """
        speed = self.drive.peak_mm_s(legs)
        rate = legs.step * (speed / np.maximum(self.drive.length(legs), 1e-9))[:, None]
        rate, first = (np.repeat(v, _PLACES, axis=0) for v in (rate, legs.begin))
        pace = np.concatenate([np.ones(_STEADY), [_PACE, _PACE, 0.0]])
        rate *= np.tile(pace, len(legs))[:, None]
        return RecordedState(
            rate,
            np.full(len(at), 1.0 / _STEADY),
            np.abs(at.position_mm - first),
            at.point_mm - self.station_mm,
            np.eye(3),
        )


def _place(
    legs: Legs, share: Float64[np.ndarray, "n k"]
) -> Float64[np.ndarray, "n*k a"]:
    places = legs.begin[:, None] + share[:, :, None] * legs.step[:, None]
    return places.reshape(-1, places.shape[2])
