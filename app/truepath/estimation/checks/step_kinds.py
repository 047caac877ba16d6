"""Classification of a step of the set-up: tracker moved or tilted, or range offset.

An absolute distance meter has a new offset after every new lock: that is tested
wherever the beam was lost. Each kind is a subspace of pose and range offset, and a kind
with more parameters has to explain more. What no kind explains alone is a step of the
pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.special import chdtri

from truepath.estimation.checks.setup_shifts import POSE, Step
from truepath.estimation.checks.shift_candidates import COLUMNS
from truepath.numerics.rigid import cross_matrix

PLACE, TILT, RANGE = "place", "tilt", "range"
_PRICE = 8.0  # gain that each parameter has to exceed
_RISK, _MARGIN = 0.003, 1.7  # of a clean measurement; noise has longer tails
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
        limit = _MARGIN * self.rest * float(chdtri(1, _RISK / max(len(left), 1)))
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
        told = vector[:, size > _ALIKE] / np.sqrt(size[size > _ALIKE])
        value = told @ (told.T @ pulled)
        return float(pulled @ value), scale * value
