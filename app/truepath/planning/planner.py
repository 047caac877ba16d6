"""Stops whose legs have most information per second: greedy choice, then exchange.

Each leg begins where the last one ended, so no time is lost on the way. The next stop
is the one of many candidates whose leg lowers J most for the time it takes. A greedy
choice is short-sighted; so then each stop is moved in turn, with both legs that meet in
it, wherever that lowers J · T. That product stays the same when a measurement is
repeated, and so compares measurements that take different times.

A planner is a value. After some of its legs are measured, `update` gives one with their
information; after a change of noise, prior or model, `replace` its design; then plan
again from the present position.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import Legs, Stops, find_short_order
from truepath.motion.workspace import DECIMALS, Workspace, check_travel, inner_travel
from truepath.numerics.design_criteria import IntegratedVariance
from truepath.planning.design_state import DesignState, inverse
from truepath_drivers.interfaces.records import Path

_MOVES = 24  # positions evaluated for each stop, half of them near it
_NEAR = 0.15  # of the travel
_PINNED = 0.55  # share of coordinates at an end of their travel
_FORBIDDEN_S = 1e6  # assumed time of a leg that is not allowed
_WORTH = 2e-3  # of J · T that a round of moves must gain


@dataclass(frozen=True, slots=True)
class SearchRegion:
    """Allowed stops, a box in axis positions, and allowed legs."""

    low: Float64[np.ndarray, " a"]
    high: Float64[np.ndarray, " a"]
    allows: Callable[[Legs], Bool[np.ndarray, " n"]]


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """Effort of the search for stops.

    candidates : ends evaluated for the next leg
    rounds : of moving stops after the greedy choice, at most
    """

    candidates: int = 96
    rounds: int = 2


@dataclass(frozen=True)
class LegChoice:
    """Chooses stops for a design; samples candidates from one seeded generator.

    feeds_mm_min : used in turn, so that each has its share of the legs; or, where the
        choice is free, the first, and others where they lower J · T
    """

    design: DesignState
    region: SearchRegion
    feeds_mm_min: tuple[float, ...]
    rng: np.random.Generator
    effort: SearchEffort = SearchEffort()
    is_free: bool = False

    def stops(
        self,
        start: Float64[np.ndarray, " a"],
        budget_s: float,
        legs: int | None = None,
    ) -> Stops:
        """Stops whose legs take no longer than the budget.

        legs : at most
        Raises PlanningError if not even one allowed leg fits in.
        """
        first = Stops(start[None], np.array([self.feeds_mm_min[0]]))
        stops = self._fill(first, budget_s, legs)
        if len(stops) < 2:
            raise PlanningError(
                f"no allowed motion from the first position fits into {budget_s:g} s; "
                "give more time or a higher feed, or free more of the volume"
            )
        best = stops
        for _ in range(self.effort.rounds):
            stops, gained = self._exchange(stops)
            if self.design.order_is_free:
                stops = self._reorder(stops)
            stops = self._fill(stops, budget_s, legs)
            # Legs that no longer fit are gone: the rest may have less information.
            best = min(best, stops, key=self._predict_residual)
            if gained < _WORTH:
                break
        return best

    def _fill(self, stops: Stops, budget_s: float, legs: int | None) -> Stops:
        times = self.design.drive.times_s(stops.legs)
        fits = int(np.searchsorted(np.cumsum(times), budget_s, side="right"))
        stops = stops.select(slice(fits + 1))
        left_s = budget_s - float(times[:fits].sum())
        precision = self.design.precision + self._inform(stops)
        while legs is None or len(stops) <= legs:
            feeds = np.array(self.feeds_mm_min)
            if not self.is_free:
                feeds = feeds[[len(stops) % len(feeds)]]
            best = self._choose_next(precision, stops.position[-1], feeds, left_s)
            if best is None:
                return stops
            end, feed, rows, time_s = best
            stops = stops.append(end, feed)
            precision = precision + rows.T @ rows
            left_s -= time_s
        return stops

    def _choose_next(
        self,
        precision: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
        feeds_mm_min: Float64[np.ndarray, " f"],
        left_s: float,
    ) -> (
        tuple[Float64[np.ndarray, " a"], float, Float64[np.ndarray, "r p"], float]
        | None
    ):
        """End and feed of the leg with most gain per second, its rows and time.

        At the first feed that has an allowed leg.
        """
        ends = self.design.restrict_axes(
            self._draw_places(self.effort.candidates), here
        )
        known = IntegratedVariance(inverse(precision), self.design.gram)
        for feed in feeds_mm_min:
            best = self._assess(known, here, ends, float(feed), left_s)
            if best is not None:
                return best
        return None

    def _assess(
        self,
        known: IntegratedVariance,
        here: Float64[np.ndarray, " a"],
        ends: Float64[np.ndarray, "n a"],
        feed_mm_min: float,
        left_s: float,
    ) -> (
        tuple[Float64[np.ndarray, " a"], float, Float64[np.ndarray, "r p"], float]
        | None
    ):
        legs = _join_legs(here, ends, feed_mm_min)
        times = self.design.drive.times_s(legs)
        ok = (times <= left_s) & self.region.allows(legs)
        if not ok.any():
            return None
        ends, times = ends[ok], times[ok]
        rows = self.design.rows(_join_legs(here, ends, feed_mm_min))
        best = int(np.argmax(known.compute_drops(rows) / times))
        return ends[best], feed_mm_min, rows[best], float(times[best])

    def _exchange(self, stops: Stops) -> tuple[Stops, float]:
        """Moves each stop but the first to where J · T is least; relative gain as
        second value. Where the choice is free, the feed towards it changes as well.
        """
        total = self.design.precision + self._inform(stops)
        before = cost = self._cost(stops)
        for k in range(1, len(stops)):
            stops, total, cost = self._exchange_stop(stops, k, total, cost)
        return stops, 1.0 - cost / before

    def _exchange_stop(
        self,
        stops: Stops,
        k: int,
        total: Float64[np.ndarray, "p p"],
        cost: float,
    ) -> tuple[Stops, Float64[np.ndarray, "p p"], float]:
        old = stops.select(slice(k - 1, k + 2))
        others = total - self._inform(old)
        rest_s = self._duration_s(stops) - self._duration_s(old)
        C = inverse(others)
        places = self._places_for(stops.position[k], C)
        feeds = np.full(len(places), stops.feed_mm_min[k])
        if self.is_free:
            every = np.array(self.feeds_mm_min)
            feeds = np.append(feeds, every)
            places = np.vstack([places, np.tile(places[0], (len(every), 1))])
        meeting = self._list_legs(stops, k, places, feeds)
        ok = np.all([self.region.allows(legs) for legs in meeting], axis=0)
        if not ok.any():
            return stops, total, cost
        places, feeds = places[ok], feeds[ok]
        meeting = self._list_legs(stops, k, places, feeds)
        rows = np.concatenate([self.design.rows(m) for m in meeting], axis=1)
        times = np.sum([self.design.drive.times_s(legs) for legs in meeting], axis=0)
        known = IntegratedVariance(C, self.design.gram)
        left = known.integrated_variance - known.compute_drops(rows)
        costs = left * (rest_s + times)
        best = int(np.argmin(costs))
        if costs[best] >= cost * (1.0 - 1e-9):
            return stops, total, cost
        position, feed = stops.position.copy(), stops.feed_mm_min.copy()
        position[k], feed[k] = places[best], feeds[best]
        total = others + rows[best].T @ rows[best]
        return Stops(position, feed), total, float(costs[best])

    def _reorder(self, stops: Stops) -> Stops:
        n = len(stops)
        legs = Legs(
            np.repeat(stops.position, n, 0),
            np.tile(stops.position, (n, 1)),
            np.full(n * n, stops.feed_mm_min.mean()),
        )
        times = self.design.drive.times_s(legs)
        times = np.where(self.region.allows(legs), times, _FORBIDDEN_S)
        order = find_short_order(times.reshape(n, n))
        found = Stops(stops.position[order], stops.feed_mm_min)
        if not self.region.allows(found.legs).all():
            return stops
        return min(stops, found, key=self._cost)

    def _list_legs(
        self,
        stops: Stops,
        k: int,
        places: Float64[np.ndarray, "n a"],
        feeds_mm_min: Float64[np.ndarray, " n"],
    ) -> list[Legs]:
        position, feed = stops.position, stops.feed_mm_min
        found = [_join_legs(position[k - 1], places, feeds_mm_min)]
        if k + 1 < len(stops):
            found.append(_join_legs(places, position[k + 1], feed[k + 1]))
        return found

    def _draw_places(self, count: int) -> Float64[np.ndarray, "n a"]:
        low, high = self.region.low, self.region.high
        share = self.rng.random((count, len(low)))
        pinned = self.rng.random(share.shape) < _PINNED
        share[pinned] = np.rint(share[pinned])
        return np.round(low + share * (high - low), DECIMALS)

    def _places_for(
        self, here: Float64[np.ndarray, " a"], C: Float64[np.ndarray, "p p"]
    ) -> Float64[np.ndarray, "n a"]:
        low, high = self.region.low, self.region.high
        step = self.rng.normal(size=(_MOVES // 2, len(low))) * _NEAR * (high - low)
        better = self.design.find_better_positions(C, here)
        known = np.round(np.clip(np.vstack([here + step, better]), low, high), DECIMALS)
        return np.vstack([here[None], known, self._draw_places(_MOVES // 2)])

    def _cost(self, stops: Stops) -> float:
        """J · T, mm² s."""
        return self._predict_residual(stops) * self._duration_s(stops)

    def _predict_residual(self, stops: Stops) -> float:
        """J, mm²."""
        return self.design.add(self._inform(stops)).integrated_variance

    def _inform(self, stops: Stops) -> Float64[np.ndarray, "p p"]:
        return self.design.information(stops.legs)

    def _duration_s(self, stops: Stops) -> float:
        return float(self.design.drive.times_s(stops.legs).sum())


def _join_legs(
    begin: Float64[np.ndarray, "*n a"],
    end: Float64[np.ndarray, "*n a"],
    feed: float | Float64[np.ndarray, " n"],
) -> Legs:
    begin, end = np.broadcast_arrays(begin, end)
    return Legs(begin, end, np.broadcast_to(np.float64(feed), len(begin)).copy())


_STARTS = 400  # positions tried where no corner is allowed


@dataclass(frozen=True)
class Planner:
    """Inputs of a plan.

    design : of lines or of standstills; its machine may lack the rotary axes of
        `machine`, which then stay at 0, or at the near end of their travel
    feeds_mm_min : several to distinguish dynamic effects from static ones, used in
        turn; or those to choose from for each line, where the choice is free
    """

    machine: Machine
    design: DesignState
    workspace: Workspace
    feeds_mm_min: tuple[float, ...]
    is_free: bool = False

    def plan(
        self,
        budget_s: float = np.inf,
        *,
        legs: int | None = None,
        start: Float64[np.ndarray, " a"] | None = None,
        seed: int = 0,
        effort: SearchEffort | None = None,
    ) -> Commanded:
        """The plan with most information that takes no longer than the budget.

        A path for a design of lines, points for one of standstills. It starts and ends
        at different points. The same seed gives the same plan.

        legs : at most
        start : positions of the design's axes; None for a corner
        Raises PlanningError if no motion fits in, or none is allowed.
        """
        rng = np.random.default_rng(seed)
        region = self.region()
        if not self._is_apart(np.stack([region.low, region.high])):
            raise PlanningError(self._hindrance())
        begin = self._first_stop(region, rng) if start is None else start
        choice = LegChoice(
            self.design,
            region,
            self.feeds_mm_min,
            rng,
            effort or SearchEffort(),
            self.is_free,
        )
        budget_s -= self.design.drive.dwell_s
        stops = choice.stops(begin, budget_s, legs)
        while len(stops) > 2 and not self._is_apart(stops.position[[0, -1]]):
            stops = stops.select(slice(len(stops) - 1))  # it came back to its beginning
        plan = self.design.command(self.machine, stops)
        self.check(plan)
        return plan

    def update(self, done: Commanded) -> Planner:
        """Adds the information of measured legs.

        done : rows of a plan that follow each other, from where the first leg began
        """
        return replace(self, design=self.design.add(self.inform(done)))

    def inform(self, done: Commanded) -> Float64[np.ndarray, "p p"]:
        """Information of legs, as for `update`."""
        return self.design.information(self._find_legs(done))

    def expect(self, precision: float | Float64[np.ndarray, "p p"]) -> Planner:
        """Adds information from elsewhere, as `inform` gives it."""
        known = self.design.precision + precision
        return replace(self, design=replace(self.design, precision=known))

    def duration_s(self, done: Commanded) -> float:
        """Time of legs with their dwells."""
        return float(self.design.drive.times_s(self._find_legs(done)).sum())

    def _find_legs(self, done: Commanded) -> Legs:
        feed = np.full(len(done), self.feeds_mm_min[0])
        if isinstance(done, Path):
            feed = done.feed_mm_min
        columns = len(self.design.model.machine.axes)
        return Stops(done.position[:, :columns], feed).legs

    def check(self, plan: Commanded) -> None:
        """Raise PlanningError if a plan leaves the travel or the workspace."""
        check_travel(self.machine, plan)
        self.workspace.require_allowed(self.machine, plan)

    def _is_apart(self, ends: Float64[np.ndarray, "2 a"]) -> bool:
        feed = max(self.feeds_mm_min)
        drive = replace(self.design.drive, least_mm=0.0)
        design = replace(self.design, drive=drive)
        return bool(design.fits(Stops(ends, np.full(2, feed)).legs)[0])

    def _hindrance(self) -> str:
        if self.design.model.machine.rotary_axes:
            return (
                f"target {self.design.target.name} hardly moves where the tracker "
                "stands; place it farther from the axes that turn it"
            )
        return (
            f"the travel of {self.machine.name} is too short for a steady feed of "
            f"{max(self.feeds_mm_min):g} mm/min; lower the feed"
        )

    def region(self) -> SearchRegion:
        machine = self.design.model.machine
        low, high = inner_travel(machine)

        def allows(legs: Legs) -> Bool[np.ndarray, " n"]:
            free = self.workspace.allows(machine, legs.begin, legs.end)
            return self.design.fits(legs) & free

        return SearchRegion(low, high, allows)

    def _first_stop(
        self, region: SearchRegion, rng: np.random.Generator
    ) -> Float64[np.ndarray, " a"]:
        low, high = region.low, region.high
        corners = np.array(list(product(*zip(low, high, strict=True))))
        anywhere = np.round(rng.uniform(low, high, (_STARTS, len(low))), DECIMALS)
        places = np.vstack([corners, anywhere])
        free = self.workspace.allows(self.design.model.machine, places, places)
        if not free.any():
            raise PlanningError(
                "no place in the travel is free of keep-out boxes and in range and in "
                "sight of the tracker; correct the workspace"
            )
        return places[int(np.argmax(free))]


def inform(
    planners: Sequence[Planner], blocks: Sequence[Commanded]
) -> Float64[np.ndarray, "p p"]:
    """Total information of blocks, each with its planner's target."""
    pairs = zip(planners, blocks, strict=True)
    return np.sum([planner.inform(block) for planner, block in pairs], axis=0)


def assess_feeds(
    planners: Sequence[Planner], blocks: Sequence[Path]
) -> dict[float, float]:
    """Information per second at each feed, relative to the paths' own feeds.

    All lines are at that feed, as far as it is reached.

    planners : of one model; blocks : the plan of each
    """

    def worth(driven: Sequence[Path]) -> float:
        known = planners[0].design.add(inform(planners, driven))
        pairs = zip(planners, driven, strict=True)
        time_s = sum(planner.duration_s(path) for planner, path in pairs)
        return 1.0 / (known.integrated_variance * time_s)

    def drive_at(feed_mm_min: float) -> list[Path]:
        return [
            replace(path, feed_mm_min=np.full(len(path), feed_mm_min))
            for path in blocks
        ]

    own = worth(blocks)
    return {f: worth(drive_at(f)) / own for f in planners[0].feeds_mm_min}
