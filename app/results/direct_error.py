"""One error as a direct instrument measured it: runs and directions put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.files.run import DirectMeasurement

_DECIMALS = 4  # of a position, mm or deg: runs stop there again and again


@dataclass(frozen=True, slots=True)
class DirectError:
    """Means over the runs, at positions in ascending order.

    mean : (n,) of both directions where both were measured
    sigma : (n,) standard uncertainty of the mean, from the runs and the instrument
    forward, backward : (n,) means of a direction, NaN where it was not measured
    forward_spread, backward_spread : (n,) standard deviations over the runs, 0 for one
    """

    position_mm: Float64[np.ndarray, " n"]
    mean: Float64[np.ndarray, " n"]
    sigma: Float64[np.ndarray, " n"]
    forward: Float64[np.ndarray, " n"]
    backward: Float64[np.ndarray, " n"]
    forward_spread: Float64[np.ndarray, " n"]
    backward_spread: Float64[np.ndarray, " n"]

    def within(self, low: float, high: float) -> DirectError:
        """Return the positions inside a travel."""
        inside = (self.position_mm >= low - 1e-6) & (self.position_mm <= high + 1e-6)
        return DirectError(
            self.position_mm[inside],
            self.mean[inside],
            self.sigma[inside],
            self.forward[inside],
            self.backward[inside],
            self.forward_spread[inside],
            self.backward_spread[inside],
        )

    def plus(self, other: DirectError, share: float) -> DirectError:
        """Return this one with a share of another, where both were measured."""
        first, last = other.position_mm[[0, -1]]
        kept = self.within(float(first), float(last))
        at = kept.position_mm

        def of(values: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, " n"]:
            return share * np.interp(at, other.position_mm, values)

        return replace(
            kept,
            mean=kept.mean + of(other.mean),
            sigma=np.hypot(kept.sigma, of(other.sigma)),
            forward=kept.forward + of(other.forward),
            backward=kept.backward + of(other.backward),
        )


@dataclass(frozen=True, slots=True)
class _Direction:
    """Runs of one direction at the positions where it stopped."""

    position_mm: Float64[np.ndarray, " m"]
    mean: Float64[np.ndarray, " m"]
    spread: Float64[np.ndarray, " m"]
    runs: Float64[np.ndarray, " m"]


def direct_error(
    symbol: str, reference: Sequence[DirectMeasurement], instrument: float
) -> DirectError:
    """Return what the measurements say about one error.

    instrument : standard uncertainty beside what the runs show, in the error's unit

    The spread of runs is pooled over all positions: five runs alone tell a standard
    deviation no better than to a third.
    """
    sides = {
        sign: _merge_direction(
            [m for m in reference if (m.error, m.direction) == (symbol, sign)]
        )
        for sign in "+-"
    }
    both = [s for s in sides.values() if len(s.position_mm)]
    position = both[0].position_mm
    if len(both) == 2:
        shared = np.intersect1d(position, both[1].position_mm)
        position = shared if len(shared) else np.union1d(position, both[1].position_mm)
    forward, backward = (_look_up(sides[sign], position) for sign in "+-")
    known = np.isfinite(np.stack([forward[0], backward[0]]))
    count = known.sum(axis=0)
    mean = np.nansum(np.stack([forward[0], backward[0]]), axis=0) / count
    pooled = _pool_spread(both)
    runs = np.where(known, np.stack([forward[2], backward[2]]), np.inf)
    variance = (pooled**2 / runs).sum(axis=0) / count**2
    return DirectError(
        position,
        mean,
        np.sqrt(variance + instrument**2),
        forward[0],
        backward[0],
        forward[1],
        backward[1],
    )


def _merge_direction(parts: Sequence[DirectMeasurement]) -> _Direction:
    if not parts:
        none = np.empty(0)
        return _Direction(none, none, none, none)
    position = np.round(np.concatenate([p.position_mm for p in parts]), _DECIMALS)
    value = np.concatenate([p.value for p in parts])
    places, index, runs = np.unique(position, return_inverse=True, return_counts=True)
    mean = np.bincount(index, value) / runs
    square = np.bincount(index, (value - mean[index]) ** 2)
    spread = np.sqrt(square / np.maximum(runs - 1, 1))
    return _Direction(places, mean, spread, runs.astype(np.float64))


def _look_up(
    side: _Direction, position_mm: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, " n"], ...]:
    """Return mean, spread and runs at positions; NaN, 0, 0 where it did not stop."""
    found = (np.full(len(position_mm), np.nan), *np.zeros((2, len(position_mm))))
    _, here, there = np.intersect1d(
        position_mm, side.position_mm, assume_unique=True, return_indices=True
    )
    for target, source in zip(found, (side.mean, side.spread, side.runs), strict=True):
        target[here] = source[there]
    return found


def _pool_spread(sides: Sequence[_Direction]) -> float:
    freedom = sum(float((s.runs - 1).sum()) for s in sides)
    square = sum(float(((s.runs - 1) * s.spread**2).sum()) for s in sides)
    return float(np.sqrt(square / freedom)) if freedom else 0.0
