"""Stops whose legs tell most per second: greedy choice, then exchange.

Each leg begins where the last one ended, so no time is lost on the way. The next stop
is the one of many candidates whose leg lowers J most for the time it takes. A greedy
choice is short-sighted; so then each stop is moved in turn, with both legs that meet in
it, wherever that lowers J · T. That product stays the same when a measurement is
repeated, and so compares measurements that take different times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from app.errors import PlanningError
from app.motion.motion_times import Drive
from app.motion.short_order import find_short_order
from app.motion.travel import DECIMALS
from app.numerics.design_criteria import IntegratedVariance
from app.planning.design_state import DesignState, inverse

Allowed = Callable[
    [Float64[np.ndarray, "n a"], Float64[np.ndarray, "n a"]], Bool[np.ndarray, " n"]
]
"""Tells of legs, begin and end, whether the machine may drive them."""

_MOVES = 24  # places that are judged for each stop, half of them near it
_NEAR = 0.15  # of the travel
_PINNED = 0.55  # share of coordinates at an end of their travel
_WORTH = 2e-3  # of J · T that a round of moves must bring


@dataclass(frozen=True, slots=True)
class SearchRegion:
    """Where stops may lie: a box in axis positions, and legs that are allowed."""

    low: Float64[np.ndarray, " a"]
    high: Float64[np.ndarray, " a"]
    allowed: Allowed


@dataclass(frozen=True, slots=True)
class StopSequence:
    """Stops in their order.

    position : (s, a); feed_mm_min : (s,) towards each, the first unused
    """

    position: Float64[np.ndarray, "s a"]
    feed_mm_min: Float64[np.ndarray, " s"]

    def __len__(self) -> int:
        return len(self.position)

    def select(self, of: slice) -> StopSequence:
        """Return some of the stops."""
        return StopSequence(self.position[of], self.feed_mm_min[of])


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """How hard stops are searched.

    candidates : ends that are judged for the next leg
    rounds : of moving stops after the greedy choice, at most
    """

    candidates: int = 96
    rounds: int = 2


@dataclass(frozen=True)
class LegChoice:
    """Chooses stops for a design; draws candidates from one seeded generator.

    feeds_mm_min : driven in turn, so that each has its share of the legs
    """

    design: DesignState
    drive: Drive
    region: SearchRegion
    feeds_mm_min: tuple[float, ...]
    rng: np.random.Generator
    effort: SearchEffort = SearchEffort()

    def stops(
        self,
        start: Float64[np.ndarray, " a"],
        budget_s: float,
        legs: int | None = None,
    ) -> StopSequence:
        """Return stops whose legs take no longer than the budget.

        legs : at most

        Raises PlanningError if not even one allowed leg fits in.
        """
        first = StopSequence(start[None], np.array([self.feeds_mm_min[0]]))
        stops = self._fill(first, budget_s, legs)
        if len(stops) < 2:
            raise PlanningError(
                f"no allowed motion from the first position fits into {budget_s:g} s; "
                "give more time or a higher feed, or free more of the volume"
            )
        for _ in range(self.effort.rounds):
            stops, gained = self._exchange(stops)
            if self.design.order_is_free:
                stops = self._reorder(stops)
            stops = self._fill(stops, budget_s, legs)
            if gained < _WORTH:
                break
        return stops

    def _fill(
        self, stops: StopSequence, budget_s: float, legs: int | None
    ) -> StopSequence:
        """Return the stops with more of them while time is left, or with fewer."""
        times = self._leg_times_s(stops)
        fits = int(np.searchsorted(np.cumsum(times), budget_s, side="right"))
        stops = stops.select(slice(fits + 1))
        left_s = budget_s - float(times[:fits].sum())
        precision = self.design.precision + self._information(stops)
        while legs is None or len(stops) <= legs:
            feed = self.feeds_mm_min[len(stops) % len(self.feeds_mm_min)]
            best = self._choose_next(precision, stops.position[-1], feed, left_s)
            if best is None:
                return stops
            end, rows, time_s = best
            stops = StopSequence(
                np.vstack([stops.position, end]), np.append(stops.feed_mm_min, feed)
            )
            precision = precision + rows.T @ rows
            left_s -= time_s
        return stops

    def _choose_next(
        self,
        precision: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
        feed_mm_min: float,
        left_s: float,
    ) -> tuple[Float64[np.ndarray, " a"], Float64[np.ndarray, "r p"], float] | None:
        """Return the end whose leg gains most a second, its rows and its time."""
        ends = self.design.hold(self._draw_places(self.effort.candidates), here)
        begin = np.tile(here, (len(ends), 1))
        feed = np.full(len(ends), feed_mm_min)
        times = self.drive.times_s(begin, ends, feed)
        ok = (times <= left_s) & self.region.allowed(begin, ends)
        if not ok.any():
            return None
        begin, ends, feed, times = begin[ok], ends[ok], feed[ok], times[ok]
        rows = self.design.rows(begin, ends, feed, self.drive)
        known = IntegratedVariance(inverse(precision), self.design.gram)
        best = int(np.argmax(known.compute_drops(rows) / times))
        return ends[best], rows[best], float(times[best])

    def _exchange(self, stops: StopSequence) -> tuple[StopSequence, float]:
        """Move each stop but the first to where J · T is least; tell the gain."""
        total = self.design.precision + self._information(stops)
        before = cost = self._cost(stops)
        for k in range(1, len(stops)):
            stops, total, cost = self._exchange_stop(stops, k, total, cost)
        return stops, 1.0 - cost / before

    def _exchange_stop(
        self,
        stops: StopSequence,
        k: int,
        total: Float64[np.ndarray, "p p"],
        cost: float,
    ) -> tuple[StopSequence, Float64[np.ndarray, "p p"], float]:
        """Return the stops with one moved, their information, and J · T."""
        old = stops.select(slice(k - 1, k + 2))
        others = total - self._information(old)
        rest_s = float(self._leg_times_s(stops).sum() - self._leg_times_s(old).sum())
        C = inverse(others)
        places = self._places_for(stops.position[k], C)
        places = places[self._check_joins(stops, k, places)]
        if not len(places):
            return stops, total, cost
        rows, times = self._legs_that_meet(stops, k, places)
        known = IntegratedVariance(C, self.design.gram)
        left = known.integrated_variance - known.compute_drops(rows)
        costs = left * (rest_s + times)
        best = int(np.argmin(costs))
        if costs[best] >= cost * (1.0 - 1e-9):
            return stops, total, cost
        position = stops.position.copy()
        position[k] = places[best]
        total = others + rows[best].T @ rows[best]
        return StopSequence(position, stops.feed_mm_min), total, float(costs[best])

    def _reorder(self, stops: StopSequence) -> StopSequence:
        """Return the stops in an order of short moves, unless they tell less so."""
        n = len(stops)
        begin, end = np.repeat(stops.position, n, 0), np.tile(stops.position, (n, 1))
        feed = np.full(n * n, stops.feed_mm_min.mean())
        times = self.drive.times_s(begin, end, feed)
        times = np.where(self.region.allowed(begin, end), times, np.inf)
        order = find_short_order(times.reshape(n, n))
        found = StopSequence(stops.position[order], stops.feed_mm_min)
        return min(stops, found, key=self._cost)

    def _legs_that_meet(
        self, stops: StopSequence, k: int, places: Float64[np.ndarray, "n a"]
    ) -> tuple[Float64[np.ndarray, "n r p"], Float64[np.ndarray, " n"]]:
        """Return rows and times of the legs that meet in a stop, for places of it."""
        rows: list[Float64[np.ndarray, "n r p"]] = []
        times = np.zeros(len(places))
        for begin, end, feed in self._list_legs(stops, k, places):
            rows.append(self.design.rows(begin, end, feed, self.drive))
            times += self.drive.times_s(begin, end, feed)
        return np.concatenate(rows, axis=1), times

    def _check_joins(
        self, stops: StopSequence, k: int, places: Float64[np.ndarray, "n a"]
    ) -> Bool[np.ndarray, " n"]:
        """Tell which places can take the part of a stop."""
        ok = np.ones(len(places), bool)
        for begin, end, _ in self._list_legs(stops, k, places):
            ok &= self.region.allowed(begin, end)
        return ok

    def _list_legs(
        self, stops: StopSequence, k: int, places: Float64[np.ndarray, "n a"]
    ) -> list[tuple[Float64[np.ndarray, "n a"], ...]]:
        """Return begins, ends and feeds of the legs before and after a stop."""
        n, feed = len(places), stops.feed_mm_min
        before = np.tile(stops.position[k - 1], (n, 1))
        found = [(before, places, np.full(n, feed[k]))]
        if k + 1 < len(stops):
            after = np.tile(stops.position[k + 1], (n, 1))
            found.append((places, after, np.full(n, feed[k + 1])))
        return found

    def _draw_places(self, count: int) -> Float64[np.ndarray, "n a"]:
        """Draw places on faces, edges and corners of the region, and inside it."""
        low, high = self.region.low, self.region.high
        share = self.rng.random((count, len(low)))
        pinned = self.rng.random(share.shape) < _PINNED
        share[pinned] = np.rint(share[pinned])
        return np.round(low + share * (high - low), DECIMALS)

    def _places_for(
        self, here: Float64[np.ndarray, " a"], C: Float64[np.ndarray, "p p"]
    ) -> Float64[np.ndarray, "n a"]:
        """Return places near a stop and anywhere, and better ones where known."""
        low, high = self.region.low, self.region.high
        step = self.rng.normal(size=(_MOVES // 2, len(low))) * _NEAR * (high - low)
        better = self.design.better_places(C, here, self.drive)
        known = np.round(np.clip(np.vstack([here + step, better]), low, high), DECIMALS)
        return np.vstack([here[None], known, self._draw_places(_MOVES // 2)])

    def _cost(self, stops: StopSequence) -> float:
        """Return J · T."""
        total = self.design.precision + self._information(stops)
        J = float(np.sum(inverse(total) * self.design.gram))
        return J * float(self._leg_times_s(stops).sum())

    def _information(self, stops: StopSequence) -> Float64[np.ndarray, "p p"]:
        return self.design.information(stops.position, stops.feed_mm_min, self.drive)

    def _leg_times_s(self, stops: StopSequence) -> Float64[np.ndarray, " l"]:
        position = stops.position
        return self.drive.times_s(position[:-1], position[1:], stops.feed_mm_min[1:])
