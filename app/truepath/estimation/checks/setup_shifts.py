"""Steps of the set-up that a fit supports, conditional on each other.

The best step is selected and located within its line; each is located again with the
others given, so that no step between two true ones replaces both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from truepath.estimation.checks.shift_candidates import Prospects, Shared

POSE = "pose"  # of the tracker, rotated and shifted at once
_SWEEPS = 1
_OF_LARGEST = 0.05  # of its gain: smaller ones may be its effect, and wait
_COST_STEP, _COST_DRIFT = 30.0, 72.0  # gain by chance, that each has to exceed
_NO_DRIFT = 1.5  # of the least gain of a step, in 36 parameters
_APART_S = 5.0  # nearer steps have more in common than is counted
_ABOUT = 6  # lines and standstills of which each cell is tested


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the pose before one cell.

    cell : the first after it; gain : of −2 log likelihood, given the other steps
    alone : gain without other steps; moved_mm : shift at the middle of the points
    kind : its classification, where requested
    """

    cell: int
    gain: float
    alone: float
    moved_mm: float
    kind: str = POSE


@dataclass(frozen=True)
class StepSearch:
    """Possible steps of a Run, and the gain required of a further one.

    all_ : coarse steps over the Run; near : those from one to the next, by number
    share : products of a step before some cell with others
    line, time_s : of each cell; steps on one line or close in time count as one
    least_gain : required of the next step, by the gain of all so far
    drift : gain of a drift
    """

    all_: Prospects
    near: Callable[[int], Prospects]
    share: Callable[[int], Shared]
    line: Int64[np.ndarray, " n"]
    time_s: Float64[np.ndarray, " n"]
    least_gain: Callable[[float], float]
    drift: float

    def find_best(
        self, others: Sequence[Prospects], *, drifts: bool
    ) -> tuple[Prospects, float]:
        """Best step given others, and its gain.

        A large step a few cells from its true cell explains little: each cell is tried
        on the most promising lines, with a drift and without.
        """
        line = self.line[self.all_.cell]
        about: set[int] = set()
        for each in (True, False) if drifts else (False,):
            best = line[np.argsort(-self._gain(self.all_, others, drifts=each))]
            first = np.sort(np.unique(best, return_index=True)[1])[:_ABOUT]
            about |= set(np.flatnonzero(np.isin(line, best[first])).tolist())
        best, most = self.all_.select_one(0), -np.inf
        for k in sorted(about):
            steps = self.near(k)
            gain = self._gain(steps, others, drifts=drifts)
            j = int(np.argmax(gain))
            if gain[j] > most:
                best, most = steps.select_one(j), float(gain[j])
        return best, most

    def find(self, most: int, *, drifts: bool) -> list[Prospects]:
        """Steps that exceed the required gain, at least the best.

        drifts : whether a drift may coexist with them
        """
        found: list[Prospects] = []
        total, gain = self.drift if drifts else 0.0, np.inf
        while len(found) < most and gain >= self.least_gain(total):
            best, gain = self.find_best(found, drifts=drifts)
            found.append(best)
            total += gain
        while len(found) > 1:
            found = self._place_again(found, drifts=drifts)
            gains = [step.gain for step in self.describe(found, drifts=drifts)]
            if min(gains) >= max(self.least_gain(total), _OF_LARGEST * max(gains)):
                break
            del found[int(np.argmin(gains))]
        if len(found) == 1:
            found = [self.find_best([], drifts=drifts)[0]]
        return sorted(found, key=lambda one: int(one.cell[0]))

    def describe(self, found: Sequence[Prospects], *, drifts: bool) -> list[Step]:
        """Each with its gain given all the others."""
        steps: list[Step] = []
        for k, one in enumerate(found):
            others = [*found[:k], *found[k + 1 :]]
            gain = self.sum_gains([one], others, drifts=drifts)
            alone, moved_mm = float(one.bare.gain[0]), float(one.bare.moved_mm[0])
            steps.append(Step(int(one.cell[0]), gain, alone, moved_mm))
        return steps

    def sum_gains(
        self,
        found: Sequence[Prospects],
        beside: Sequence[Prospects] = (),
        *,
        drifts: bool,
    ) -> float:
        """Total gain of steps, given the steps in `beside`."""
        given = [step.choose(drifts=drifts) for step in beside]
        total = 0.0
        for step in found:
            one = step.choose(drifts=drifts)
            total += float(one.condition(given, self.share).gain[0])
            given.append(one)
        return total

    def _place_again(
        self, found: Sequence[Prospects], *, drifts: bool
    ) -> list[Prospects]:
        placed = list(found)
        for k in list(range(len(placed))) * _SWEEPS:
            others = placed[:k] + placed[k + 1 :]
            placed[k], _ = self.find_best(others, drifts=drifts)
        return placed

    def _gain(
        self, steps: Prospects, others: Sequence[Prospects], *, drifts: bool
    ) -> Float64[np.ndarray, " l"]:
        """0 for steps that coincide with one of the others."""
        given = [other.choose(drifts=drifts) for other in others]
        parts = steps.choose(drifts=drifts).cut()
        gain = np.concatenate([p.condition(given, self.share).gain for p in parts])
        for other in others:
            cell = int(other.cell[0])
            near = np.abs(self.line[steps.cell] - self.line[cell]) <= 1
            near |= np.abs(self.time_s[steps.cell] - self.time_s[cell]) < _APART_S
            gain[near] = 0.0
        return gain


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps that a fit supports, in order of time; at least the best.

    explained : gain of them and of a drift
    drift_left : gain of the drift, given the steps
    """

    steps: tuple[Step, ...]
    explained: float
    drift_left: float


def find_steps(search: StepSearch, most: int) -> Steps:
    """Steps that a fit supports, without a drift where they suffice.

    Many steps can imitate a drift: the explanation with more gain for its cost wins.

    most : maximum number; 0 for the best alone, coarsely located
    """
    if not len(search.all_.cell):
        return Steps((), search.drift, search.drift)
    if not most:
        best = int(np.argmax(search.all_.bare.gain))
        return _gather(search, [search.all_.select_one(best)], drifts=False)
    alone = _gather(search, search.find(most, drifts=False), drifts=False)
    paid = alone.explained - alone.drift_left - _COST_STEP * len(alone.steps)
    least = search.least_gain(alone.explained)
    if alone.drift_left < _NO_DRIFT * least and paid > search.drift - _COST_DRIFT:
        return alone
    return _gather(search, search.find(most, drifts=True), drifts=True)


def _gather(search: StepSearch, found: Sequence[Prospects], *, drifts: bool) -> Steps:
    explained, alone = (search.sum_gains(found, drifts=d) for d in (True, False))
    explained += search.drift
    steps = search.describe(found, drifts=drifts)
    return Steps(tuple(steps), explained, explained - alone)
