"""Steps of the set-up's place that a fit asks for, one beside the other.

A step has the columns of the pose for all that comes after it. Its score (Rao 1948) is
conditioned on the fit, on a drift and on the steps found before, by elimination: what
columns have in common with those before them goes with these. The best step is taken
and placed within its line; each is placed again where the others are given, so that
no step between two knocks passes for both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from app.numerics.scaled_cholesky import ScaledCholesky

UNSEEN = 0.02  # of a column's information: the fit explains it all
_SWEEPS = 1
_OF_LARGEST = 0.01  # of its gain: smaller ones may be its doing, and wait
_COST_STEP, _COST_DRIFT = 30.0, 72.0  # gain by chance, that each has to pay for
_NO_DRIFT = 1.5  # of the least gain of a step, in 36 parameters
_APART_S = 5.0  # nearer steps have more in common than is counted
_ABOUT = 3  # lines on which each cell is tried


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the pose before one cell.

    cell : the first after it; gain : of −2 log likelihood, beside other steps
    alone : gain where there is nothing else; moved_mm : by how far, at the middle
    """

    cell: int
    gain: float
    alone: float
    moved_mm: float


@dataclass(frozen=True)
class StepSums:
    """Products of the columns of steps of the pose before some cells.

    value : with all columns: of the fit, pose last, the residual, the drift
    own : with the columns of the same step
    """

    cell: Int64[np.ndarray, " l"]
    value: Float64[np.ndarray, "l q 6"]
    own: Float64[np.ndarray, "l 6 6"]

    def select(self, part: slice) -> StepSums:
        """Return some of the steps."""
        return StepSums(self.cell[part], self.value[part], self.own[part])

    def go_on(self, later: Sequence[StepSums]) -> StepSums:
        """Return the sums of steps that go on through later blocks."""
        value, own = self.value, self.own
        for block in later:  # before all of its cells
            value, own = value + block.value[0], own + block.own[0]
        return StepSums(self.cell, value, own)

    @staticmethod
    def join(parts: Sequence[StepSums]) -> StepSums:
        """Return the steps of several blocks."""
        return StepSums(
            np.concatenate([part.cell for part in parts]),
            np.concatenate([part.value for part in parts]),
            np.concatenate([part.own for part in parts]),
        )


@dataclass(frozen=True)
class Candidates:
    """Steps before some cells.

    raw : information of their columns; whole : products with a step before all cells
    known : what they share with the fit and what is given beside it
    left, pulled : information and pull that remain
    """

    cell: Int64[np.ndarray, " l"]
    raw: Float64[np.ndarray, "l 6 6"]
    whole: Float64[np.ndarray, "l 6 6"]
    known: Float64[np.ndarray, "l m 6"]
    left: Float64[np.ndarray, "l 6 6"]
    pulled: Float64[np.ndarray, "l 6"]

    @property
    def gain(self) -> Float64[np.ndarray, " l"]:
        """Gain of each."""
        return np.sum(compute_score(self.left, self.raw, self.pulled)[1] ** 2, axis=1)

    @property
    def moved_mm(self) -> Float64[np.ndarray, " l"]:
        """Size of each, at the middle."""
        root, score = compute_score(self.left, self.raw, self.pulled)
        return np.linalg.norm(np.einsum("lij,lj->li", root, score)[:, :3], axis=1)

    def select_one(self, k: int) -> Candidates:
        """Return one of them."""
        one = {name: value[k : k + 1] for name, value in vars(self).items()}
        return Candidates(**one)

    def give(
        self,
        shared: Float64[np.ndarray, "l k 6"],
        root: Float64[np.ndarray, "k j"],
        score: Float64[np.ndarray, " j"],
    ) -> Candidates:
        """Return the candidates beside other columns.

        shared : products with these, what both have in common with the fit taken out
        root, score : of the others
        """
        own = root.T @ shared
        return replace(
            self,
            known=np.concatenate([self.known, own], axis=1),
            left=self.left - np.swapaxes(own, 1, 2) @ own,
            pulled=self.pulled - np.einsum("lji,j->li", own, score),
        )

    def condition(
        self, steps: Sequence[Candidates], share: Callable[[int], Shared]
    ) -> Candidates:
        """Return the candidates beside steps, one each."""
        given: list[_GivenStep] = []
        for step in steps:
            for before in given:
                step = before.add_to(step)
            root, score = compute_score(step.left, step.raw, step.pulled)
            shared = share(int(step.cell[0]))
            given.append(_GivenStep(shared, step.known[0], root[0], score[0]))
        candidates = self
        for step in given:
            candidates = step.add_to(candidates)
        return candidates


@dataclass(frozen=True)
class Shared:
    """Products of a step's columns with those of steps before the cells of its block.

    first : cell of the block; value : (n, 6, 6)
    """

    first: int
    value: Float64[np.ndarray, "n 6 6"]

    def look_up(self, candidates: Candidates) -> Float64[np.ndarray, "l 6 6"]:
        """Return the products with candidates: those before the block cover it all."""
        inside = candidates.cell - self.first
        near = self.value[np.clip(inside, 0, len(self.value) - 1)]
        later = (inside >= len(self.value))[:, None, None]
        return np.where(later, candidates.whole, near)


@dataclass(frozen=True)
class _GivenStep:
    """A step that others are conditioned on.

    known : what its columns share with all before it
    root : R, RRᵀ the inverse of what is left of it; score : Rᵀ times its pull
    """

    shared: Shared
    known: Float64[np.ndarray, "m 6"]
    root: Float64[np.ndarray, "6 6"]
    score: Float64[np.ndarray, "6"]

    def add_to(self, candidates: Candidates) -> Candidates:
        """Return candidates beside this step."""
        shared = self.shared.look_up(candidates) - self.known.T @ candidates.known
        return candidates.give(shared, self.root, self.score)


@dataclass(frozen=True)
class Prospects:
    """The same steps beside a drift and without it."""

    beside: Candidates
    bare: Candidates

    @property
    def cell(self) -> Int64[np.ndarray, " l"]:
        """The first cell after each."""
        return self.beside.cell

    def choose(self, *, drifts: bool) -> Candidates:
        """Return them beside a drift or without one."""
        return self.beside if drifts else self.bare

    def select_one(self, k: int) -> Prospects:
        """Return one of them."""
        return Prospects(self.beside.select_one(k), self.bare.select_one(k))

    def condition(
        self, steps: Sequence[Prospects], share: Callable[[int], Shared]
    ) -> Prospects:
        """Return them beside steps, one each."""
        return Prospects(
            self.beside.condition([step.beside for step in steps], share),
            self.bare.condition([step.bare for step in steps], share),
        )


@dataclass(frozen=True)
class StepSearch:
    """Where steps may be, and what a further one has to gain.

    all_ : steps all over the Run; near : those from one to the next, by number
    share : what a step before some cell has in common with others
    line, time_s : of each cell; steps on one line or in one moment are one
    least_gain : of the next step, where all so far explains so much
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
        """Return the best step beside others, and its gain.

        A large step a few cells from its place explains little: each cell is tried on
        the lines that look best, with a drift and without.
        """
        given, line = self.all_.condition(others, self.share), self.line[self.all_.cell]
        about: set[int] = set()
        for each in (given.beside, given.bare) if drifts else (given.bare,):
            best = np.argsort(-self._gain(each, others))[:_ABOUT]
            about |= set(np.flatnonzero(np.isin(line, line[best])).tolist())
        best, most = self.all_.select_one(0), -np.inf
        for k in sorted(about):
            steps = self.near(k)
            given = steps.condition(others, self.share)
            gain = self._gain(given.choose(drifts=drifts), others)
            j = int(np.argmax(gain))
            if gain[j] > most:
                best, most = steps.select_one(j), float(gain[j])
        return best, most

    def find(self, most: int, *, drifts: bool) -> list[Prospects]:
        """Return the steps that there must be, at least the best.

        drifts : whether a drift may be beside them
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
        """Return steps, each with its gain beside the others."""
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
        """Return the gain of steps together, beside others."""
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
        """Return each step where it is best beside the others."""
        placed = list(found)
        for k in list(range(len(placed))) * _SWEEPS:
            others = placed[:k] + placed[k + 1 :]
            placed[k], _ = self.find_best(others, drifts=drifts)
        return placed

    def _gain(
        self, steps: Candidates, others: Sequence[Prospects]
    ) -> Float64[np.ndarray, " l"]:
        gain = steps.gain
        for other in others:
            cell = int(other.cell[0])
            near = np.abs(self.line[steps.cell] - self.line[cell]) <= 1
            near |= np.abs(self.time_s[steps.cell] - self.time_s[cell]) < _APART_S
            gain[near] = 0.0
        return gain


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps that a fit asks for, in the order of time; at least the best.

    explained : gain of them and of a drift
    drift_left : what of it is the drift's, beside them
    """

    steps: tuple[Step, ...]
    explained: float
    drift_left: float


def find_steps(search: StepSearch, most: int) -> Steps:
    """Return the steps that a fit asks for, without a drift where they say it all.

    Many steps make up for a drift as well: what explains more for its price counts.

    most : how many; 0 for the best alone, roughly where it is
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


class Drift:
    """A drift of the set-up, given the fit.

    sums : products of its columns with those of the fit, the residual and its own
    gain : of −2 log likelihood; size : of its parameters
    """

    def __init__(
        self, factor: ScaledCholesky, sums: Float64[np.ndarray, "q s"]
    ) -> None:
        p = len(factor.scale)
        self._factor, self._half = factor, factor.solve_half(sums[:p])
        raw = sums[p + 1 :]
        left = raw - self._half.T @ self._half
        root, score = compute_score(left[None], raw[None], sums[None, p])
        self._root, self._score = root[0], score[0]
        self.size = self._root @ self._score
        self.gain = float(self._score @ self._score)

    def prepare(self, steps: StepSums) -> Prospects:
        """Return steps, beside the drift and without it."""
        sums, raw = steps.value, steps.own
        p, n = len(self._factor.scale), len(sums)
        flat = sums[:, :p].transpose(1, 0, 2).reshape(p, 6 * n)
        half = self._factor.solve_half(flat).reshape(p, n, 6).transpose(1, 0, 2)
        left = raw - np.swapaxes(half, 1, 2) @ half
        whole = sums[:, p - 6 : p]
        bare = Candidates(steps.cell, raw, whole, half, left, sums[:, p])
        shared = sums[:, p + 1 :] - self._half.T @ half
        return Prospects(bare.give(shared, self._root, self._score), bare)


def compute_score(
    left: Float64[np.ndarray, "l k k"],
    raw: Float64[np.ndarray, "l k k"],
    pulled: Float64[np.ndarray, "l k"],
) -> tuple[Float64[np.ndarray, "l k k"], Float64[np.ndarray, "l k"]]:
    """Return R and Rᵀ pulled, RRᵀ the inverse of the information that is left.

    raw : that before; directions of which the fit explains all have none
    """
    own = np.einsum("lii->li", raw)
    scale = np.where(own > 0.0, own, np.inf) ** -0.5
    scaled = left * scale[:, :, None] * scale[:, None, :]
    value, vector = np.linalg.eigh(scaled)
    seen = value > UNSEEN
    size = np.where(seen, 1.0 / np.sqrt(np.where(seen, value, 1.0)), 0.0)
    root = scale[:, :, None] * vector * size[:, None, :]
    return root, np.einsum("lij,li->lj", root, pulled)
