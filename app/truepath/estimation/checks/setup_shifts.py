"""Steps of the set-up that a fit supports, conditional on each other.

A step has the columns of pose and range offset for all cells after it, conditional on
the fit and on a drift. The best is selected and located within its line; each is
located again with the others given, so that no step between two true ones replaces
both.

Its kind is then decided: tracker moved or tilted, or range offset. An absolute distance
meter has a new offset after every new lock: that is tested wherever the beam was lost.
Each kind is a subspace of pose and range offset, and a kind with more parameters has to
explain more. What no kind explains alone is a step of the pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.estimation.checks.score import STEP_MARGIN, ScoredColumns, compute_limit
from truepath.numerics.rigid import cross_matrix
from truepath.numerics.scaled_cholesky import ScaledCholesky

COLUMNS = 7  # of a step: three shifts, three turns, range offset
_AT_ONCE = 256  # steps


@dataclass(frozen=True)
class StepSums:
    """Products of the columns of steps before some cells.

    value : with all columns: of the fit (pose last), range offset, drift, residual
    own : with the columns of the same step
    """

    cell: Int64[np.ndarray, " l"]
    value: Float64[np.ndarray, "l q 7"]
    own: Float64[np.ndarray, "l 7 7"]

    def select(self, part: slice) -> StepSums:
        return StepSums(self.cell[part], self.value[part], self.own[part])

    def put(self, part: slice, steps: StepSums) -> None:
        self.value[part], self.own[part] = steps.value, steps.own

    def add_later_steps(self, later: StepSums) -> StepSums:
        """Steps that continue: adds a step before all that is later."""
        return StepSums(self.cell, self.value + later.value, self.own + later.own)

    @staticmethod
    def zeros_at(cell: Int64[np.ndarray, " l"], width: int) -> StepSums:
        """Zero products for steps before these cells; `width` columns in all."""
        value = np.zeros((len(cell), width, COLUMNS))
        return StepSums(cell, value, np.zeros((len(cell), COLUMNS, COLUMNS)))

    @staticmethod
    def join(parts: Sequence[StepSums]) -> StepSums:
        return StepSums(
            np.concatenate([part.cell for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.own for part in parts]),
        )


@dataclass(frozen=True)
class Candidates(ScoredColumns):
    """Steps before some cells.

    whole : products with a step before all cells
    """

    cell: Int64[np.ndarray, " l"]
    whole: Float64[np.ndarray, "l 7 7"]

    def cut(self) -> Iterator[Candidates]:
        """In batches, to limit memory."""
        return map(self.select, _cut(len(self.cell)))

    @property
    def moved_mm(self) -> Float64[np.ndarray, " l"]:
        """Norm of shift at the middle of the points and range offset."""
        return np.linalg.norm(self.value[:, [0, 1, 2, 6]], axis=1)

    def condition(
        self, steps: Sequence[Candidates], share: Callable[[int], Shared]
    ) -> Candidates:
        """Conditional on steps, one candidate each, whose products `share` provides."""
        given: list[tuple[Candidates, Shared]] = []
        for step in steps:
            shared = share(int(step.cell[0]))
            given.append((step.give_all(given), shared))
        return self.give_all(given)

    def give_all(self, given: Sequence[tuple[Candidates, Shared]]) -> Candidates:
        """Conditional on steps, each of which is conditional on those before it."""
        candidates = self
        for step, shared in given:
            candidates = candidates.condition_on(step, shared.look_up(candidates))
        return candidates


@dataclass(frozen=True)
class Shared:
    """Products of a step with steps before each cell of its block.

    first : cell of the block; value : (n, 7, 7)
    """

    first: int
    value: Float64[np.ndarray, "n 7 7"]

    def look_up(self, candidates: Candidates) -> Float64[np.ndarray, "l 7 7"]:
        """The first product for candidates before the block, `whole` for later ones."""
        inside = candidates.cell - self.first
        near = self.value[np.clip(inside, 0, len(self.value) - 1)]
        later = (inside >= len(self.value))[:, None, None]
        return np.where(later, candidates.whole, near)


@dataclass(frozen=True)
class Prospects:
    """The same steps with and without a drift given."""

    beside: Candidates
    bare: Candidates

    @property
    def cell(self) -> Int64[np.ndarray, " l"]:
        """The first cell after each."""
        return self.beside.cell

    def choose(self, *, drifts: bool) -> Candidates:
        return self.beside if drifts else self.bare

    def select_one(self, k: int) -> Prospects:
        """The leading dimension stays, of length 1."""
        return Prospects(self.beside.select_one(k), self.bare.select_one(k))


class Drift:
    """A drift of the set-up, given the fit.

    sums : products of its columns with those of fit and range offset, with themselves
        and with the residual
    gain : of −2 log likelihood; size : its parameters
    """

    def __init__(
        self, factor: ScaledCholesky, sums: Float64[np.ndarray, "q s"]
    ) -> None:
        self._factor, self._fit = factor, slice(len(factor.scale))
        half, raw = factor.solve_half(sums[self._fit]), sums[self._fit.stop + 1 : -1]
        left, pulled = raw - half.T @ half, sums[None, -1]
        self._columns = ScoredColumns(half[None], raw[None], left[None], pulled)
        self.size = self._columns.value[0]
        self.gain = float(self._columns.gain[0])

    def eliminate_drift(self, steps: StepSums) -> Prospects:
        """Steps with and without the drift given; overwrites `steps` to save memory."""
        fit = self._fit
        whole = steps.value[:, fit.stop - 6 : fit.stop + 1].copy()
        for column in range(fit.stop, steps.value.shape[1] - 2):  # held once, not twice
            steps.value[:, column] = steps.value[:, column + 1]
        known = steps.value[:, :-2]
        for part in _cut(len(known)):
            self._eliminate(known[part])
        raw, half, own = steps.own, known[:, fit], known[:, fit.stop :]
        left, pulled = raw - np.swapaxes(half, 1, 2) @ half, steps.value[:, -1]
        bare = Candidates(half, raw, left, pulled, steps.cell, whole)
        return Prospects(
            bare.eliminate_with(known, own, self._columns.score[1][0]), bare
        )

    def _eliminate(self, sums: Float64[np.ndarray, "l m 7"]) -> None:
        """Replaces products with fit and drift by whitened ones, in place."""
        columns = sums.transpose(1, 0, 2).reshape(sums.shape[1], -1)
        half = self._factor.solve_half(columns[self._fit])
        rest = columns[self._fit.stop :] - self._columns.known[0].T @ half
        own = self._columns.score[0][0].T @ rest
        shared = np.concatenate([half, own]).reshape(-1, len(sums), COLUMNS)
        sums[...] = shared.transpose(1, 0, 2)


def _cut(count: int) -> list[slice]:
    return [slice(k, k + _AT_ONCE) for k in range(0, count, _AT_ONCE)]


POSE = "pose"  # of the tracker, rotated and shifted at once
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
            for k in range(len(found)):
                others = found[:k] + found[k + 1 :]
                found[k] = self.find_best(others, drifts=drifts)[0]
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


def detect_steps(search: StepSearch, most: int) -> Steps:
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


PLACE, TILT, RANGE = "place", "tilt", "range"
_PRICE = 8.0  # gain that each parameter has to exceed
_ALIKE = 1e-9  # of unit columns: what is less is the rounding of the fit


@dataclass(frozen=True)
class StepPart:
    """One possible explanation of a step; turned : (q, k) its columns among all."""

    cell: int
    kind: str
    turned: Float64[np.ndarray, "q k"]


@dataclass(frozen=True)
class StepKinds:
    """Steps, and range offsets after new locks of the beam, given a fit.

    locks : first cells after the beam was lost; the specification's prior of another
        offset is in the fit
    matrix, pulled : information and score, given the fit, of a drift, of the columns of
        each step, of each lock's offset
    tracker_mm : tracker's position from the centre that the pose turns about
    rest : factor of noise on gains by chance
    """

    steps: Sequence[Step]
    locks: Sequence[int]
    matrix: Float64[np.ndarray, "q q"]
    pulled: Float64[np.ndarray, " q"]
    tracker_mm: Float64[np.ndarray, "3"]
    rest: float

    def name(self) -> list[Step]:
        offsets = self._list_offsets()
        kinds = [[*self._list_kinds(k), *offsets] for k in range(len(self.steps))]
        parts = [next(p for p in each if p.kind == POSE) for each in kinds]
        for k, each in enumerate(kinds):
            others = parts[:k] + parts[k + 1 :]
            paid = [_PRICE * self.rest * part.turned.shape[1] for part in each]
            gains = [self._solve([*others, part])[0] for part in each]
            parts[k] = each[int(np.argmax(np.subtract(gains, paid)))]
        named = [
            replace(step, cell=part.cell, kind=part.kind)
            for step, part in zip(self.steps, parts, strict=True)
        ]
        named += self._find_offsets(parts, offsets)
        return sorted(named, key=lambda step: step.cell)

    @property
    def _first(self) -> int:
        return len(self.pulled) - COLUMNS * len(self.steps) - len(self.locks)

    def _list_offsets(self) -> list[StepPart]:
        own = np.eye(len(self.pulled))[:, len(self.pulled) - len(self.locks) :]
        return [
            StepPart(cell, RANGE, own[:, k : k + 1])
            for k, cell in enumerate(self.locks)
        ]

    def _list_kinds(self, number: int) -> Iterator[StepPart]:
        first, cell = self._first + COLUMNS * number, self.steps[number].cell
        own = np.eye(len(self.pulled))[:, first : first + COLUMNS]
        # A tilt is about the tracker, which stays where it is.
        centre = cross_matrix(self.tracker_mm[None])[0]
        yield StepPart(cell, RANGE, own[:, 6:])
        yield StepPart(cell, PLACE, own[:, :3])
        yield StepPart(cell, TILT, own[:, 3:6] - own[:, :3] @ centre)
        yield StepPart(cell, POSE, own[:, :6])

    def _find_offsets(
        self, parts: Sequence[StepPart], offsets: Sequence[StepPart]
    ) -> Iterator[Step]:
        """Only offsets that differ by more than the specification allows."""
        given, left = list(parts), list(offsets)
        limit = STEP_MARGIN * self.rest * compute_limit(1, len(left))
        while left:
            before = self._solve(given)[0]
            gains = [self._solve([*given, each])[0] - before for each in left]
            best = int(np.argmax(gains))
            if gains[best] < limit:
                break
            given.append(left.pop(best))
            size_mm = abs(float(self._solve(given)[1][-1]))
            yield Step(given[-1].cell, gains[best], gains[best], size_mm, RANGE)

    def _solve(
        self, parts: Sequence[StepPart]
    ) -> tuple[float, Float64[np.ndarray, " k"]]:
        drift = np.eye(len(self.pulled))[:, : self._first]
        turn = np.concatenate([drift, *(part.turned for part in parts)], axis=1)
        # A millimetre, a radian: what the fit explains wholly stays at 0.
        left = turn.T @ self.matrix @ turn + np.eye(turn.shape[1])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(left), 1.0))
        pulled = scale * (turn.T @ self.pulled)
        # Two parts may be one: a range step beside the offset of a lock there.
        size, vector = np.linalg.eigh(left * scale[:, None] * scale)
        root = vector[:, size > _ALIKE] / np.sqrt(size[size > _ALIKE])
        value = root @ (root.T @ pulled)
        return float(pulled @ value), scale * value
