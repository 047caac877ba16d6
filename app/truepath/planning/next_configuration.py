"""The configuration to measure next: where one measurement lowers J most.

On one axis the optimum is exact (`find_best_position`). On several, one axis after
another is set to its optimum while the others are fixed, until nothing rises any more;
from several starts, because there are several summits (brunn-hanebeck-2005, eq. 36–37).
Starts are the best of a dense search, which also certifies the answer: none of its
configurations is better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Bool, Float64

from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.model import MachineModel
from truepath.motion.configurations import Configurations
from truepath.motion.motion_times import Legs, Stops
from truepath.motion.workspace import add_resting_axes
from truepath.numerics.design_criteria import IntegratedVariance, find_best_position
from truepath.planning.design_state import DesignState

PositionRows = Callable[[Float64[np.ndarray, "n a"]], Float64[np.ndarray, "n *r p"]]

_DRAWS = 80  # positions evaluated for each that climbs
_CLIMB_ON = 0.4  # of those that have climbed each axis once
_ROUNDS = 30  # of all axes, at most
_RISEN = 1e-4  # relative rise of a round that is worth another
# A turn moves levers like a cosine: this order follows it to 1e-7 over 60 deg.
_DEGREE_OF_TURN = 9


@dataclass(frozen=True, slots=True)
class SearchSpace:
    """The axes to search.

    Turns of an axis act on levers that are straight in the positions of straight axes,
    so along these the rows of a point's displacement are cubic between the knots.

    borders : for each axis its ends and every knot between them
    degrees : of a row's polynomial between two borders; 3 for a straight axis
    """

    borders: tuple[Float64[np.ndarray, " b"], ...]
    degrees: tuple[int, ...]

    def draw(self, count: int, seed: int) -> Float64[np.ndarray, "n a"]:
        """Uniform random positions, reproducible by the seed."""
        low = np.array([b[0] for b in self.borders])
        high = np.array([b[-1] for b in self.borders])
        rng = np.random.default_rng(seed)
        return rng.uniform(low, high, (count, len(low)))


@dataclass(frozen=True, slots=True)
class NextConfiguration:
    """Axis positions, and the decrease of J by a measurement there.

    searched : the best of the dense search over all axes
    """

    position: Float64[np.ndarray, " a"]
    drop: float
    searched: float


def next_configuration(
    known: IntegratedVariance,
    rows: PositionRows,
    axes: SearchSpace,
    noise_variance: float,
    *,
    starts: int = 5,
    seed: int = 0,
) -> NextConfiguration:
    """The best configuration found; reproducible by the seed.

    rows : (n, p), or (n, r, p) for r values at once, at axis positions; along each axis
        polynomials between its borders
    """
    places = axes.draw(_DRAWS * starts, seed)
    drops = known.compute_drops(rows(places), noise_variance)
    first = np.argsort(-drops)[:starts]
    climb = Climb(known, rows, axes, noise_variance)
    slopes = sorted((climb.climb_once(places[i]) for i in first), key=lambda s: -s.drop)
    tops = [climb.climb_to_top(slope) for slope in slopes[: ceil(_CLIMB_ON * starts)]]
    top = max(tops, key=lambda top: top.drop)
    return NextConfiguration(top.position, top.drop, float(drops[first[0]]))


def search_space(model: MachineModel) -> SearchSpace:
    """The axes of a machine, with the knots of their error motions between the ends."""
    borders: list[Float64[np.ndarray, " b"]] = []
    for axis in model.machine.axes:
        knots = [
            motion.spline.knots
            for motion in model.error_motions
            if motion.axis.name == axis.name
        ]
        ends = np.array([axis.low, axis.high])
        borders.append(np.unique(np.concatenate([ends, *knots])))
    degrees = [
        3 if isinstance(axis, LinearAxis) else _DEGREE_OF_TURN
        for axis in model.machine.axes
    ]
    return SearchSpace(tuple(borders), tuple(degrees))


@dataclass(frozen=True, slots=True)
class _ClimbState:
    """A configuration on the way up; `idle` consecutive turns have not raised it."""

    position: Float64[np.ndarray, " a"]
    drop: float
    turn: int = 0
    idle: int = 0


@dataclass(frozen=True, slots=True)
class Climb:
    """Sets one axis after another to its optimum while the others are fixed."""

    known: IntegratedVariance
    rows: PositionRows
    axes: SearchSpace
    noise_variance: float

    def climb_once(self, start: Float64[np.ndarray, " a"]) -> _ClimbState:
        """After one turn of each axis."""
        here = _ClimbState(start, 0.0)
        for _ in self.axes.borders:
            here = self._optimise_axis(here)
        return here

    def climb_to_top(self, here: _ClimbState) -> _ClimbState:
        """The summit: every axis is at its optimum, or 30 rounds are over."""
        count = len(self.axes.borders)
        while here.idle < count - 1 and here.turn < _ROUNDS * count:
            here = self._optimise_axis(here)
        return here

    def _optimise_axis(self, here: _ClimbState) -> _ClimbState:
        axis = here.turn % len(self.axes.borders)

        def rows(place: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n *r p"]:
            positions = np.tile(here.position, (len(place), 1))
            positions[:, axis] = place
            return self.rows(positions)

        best = find_best_position(
            self.known,
            rows,
            self.axes.borders[axis],
            self.noise_variance,
            degree=self.axes.degrees[axis],
        )
        position = here.position.copy()
        position[axis] = best.at
        idle = here.idle + 1 if best.drop <= here.drop * (1.0 + _RISEN) else 0
        return _ClimbState(position, max(best.drop, here.drop), here.turn + 1, idle)


_LEAST_MOVE_MM = 1.0  # else standstills look like one
_LEAST_TURN_DEG = 10.0  # or a tenth of the travel


@dataclass(frozen=True)
class PointDesignState(DesignState):
    """Present information; a standstill measures a target's three coordinates."""

    order_is_free = True

    def rows(self, legs: Legs) -> Float64[np.ndarray, "n r p"]:
        """Rows H of the standstill at each end, approached from the begin."""
        at = self.conditions(legs.end, np.sign(legs.step))
        return np.sqrt(self.drive.dwell_s) * (self.roots(at) @ self.model.jacobian(at))

    def fits(self, legs: Legs) -> Bool[np.ndarray, " n"]:
        """Mask of the moves that can be recognised.

        Every rotary axis has to turn: a target on a table that does not would not move.
        """
        turning = self.model.machine.rotary_axes
        if not turning:
            return self.drive.length(legs) >= _LEAST_MOVE_MM
        travel = np.array([axis.high - axis.low for axis in turning])
        turn = np.abs(legs.step)[:, ~np.asarray(self.drive.linear)]
        return np.all(turn >= np.minimum(_LEAST_TURN_DEG, 0.1 * travel), axis=1)

    def command(self, machine: Machine, stops: Stops) -> Configurations:
        position = add_resting_axes(machine, stops.position)
        dwell_s = np.full(len(stops), self.drive.dwell_s)
        names = self._name_target(len(stops))
        return Configurations(machine.axis_names, position, dwell_s, names)

    def find_better_positions(
        self,
        covariance: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
    ) -> Float64[np.ndarray, "n a"]:
        """The summit of the exact criterion above a stop, for straight axes.

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
