"""Errors as a direct instrument measured them, in the convention of a comparison.

Runs and directions are combined. Positioning and turns are 0 at the axis zero, else at
the lowest position; straightness is 0 there and at the highest (sanders-2023, section
2.3.1). A motion that the measured targets do not determine moves them like others of
its axis: the result has its share in those, so the direct values are given it as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float64

from truepath.files.bundle.run import DirectMeasurement
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import scale_of
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion, compute_arm
from truepath.kinematics.machine.machine import Axis, LinearAxis
from truepath.kinematics.machine.symbols import (
    find_unit,
    is_straightness,
    list_error_motions,
)

_DECIMALS = 4  # of a position, mm or deg: runs stop there again and again


_SAME_MM = 1e-6
_PROBE = 60  # configurations that determine how motions merge
_MERGES = 1e-6  # of a merged motion: left over by those it merges into


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
        """Only the positions inside a travel."""
        inside = (self.position_mm >= low - 1e-6) & (self.position_mm <= high + 1e-6)
        return DirectError(*(getattr(self, f.name)[inside] for f in fields(self)))

    def plus(self, other: DirectError, share: float) -> DirectError:
        """Sum with a share of another, within the range of the other."""
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
    position_mm: Float64[np.ndarray, " m"]
    mean: Float64[np.ndarray, " m"]
    spread: Float64[np.ndarray, " m"]
    runs: Float64[np.ndarray, " m"]


def combine_direct_error(
    symbol: str, reference: Sequence[DirectMeasurement], instrument: float
) -> DirectError:
    """One error from all its measurements, both directions.

    instrument : standard uncertainty in addition to the spread of the runs, in the
        error's unit

    The spread of runs is pooled over all positions: five runs alone determine a
    standard deviation no better than to a third.
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


def index_motions(result: CalibrationResult) -> dict[str, ErrorMotion]:
    """Error motions that a result identifies, by symbol."""
    return {motion.symbol: motion for motion in result.model.identifiable_motions}


def build_convention(
    symbol: str, axis: Axis, position_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n n"]:
    """Matrix that converts values at sorted positions to the convention."""
    n = len(position_mm)
    at_zero = np.flatnonzero(np.abs(position_mm) < _SAME_MM)
    first = int(at_zero[0]) if len(at_zero) and at_zero[0] < n - 1 else 0
    removed = np.zeros((n, n))
    if isinstance(axis, LinearAxis) and is_straightness(symbol):
        share = position_mm - position_mm[first]
        share = share / (position_mm[-1] - position_mm[first])
        removed[:, first], removed[:, -1] = 1.0 - share, share
    else:
        removed[:, int(at_zero[0]) if len(at_zero) else 0] = 1.0
    return np.eye(n) - removed


def find_merged_shares(
    result: CalibrationResult, axis: Axis, symbol: str, direct: dict[str, DirectError]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Shares of other motions of the axis that the result has in this one.

    The shares are by motion, in the unit of this one per unit of that one; then come
    the motions that the reference does not know.
    """
    known = [s for s in list_error_motions(axis.name) if s in index_motions(result)]
    shares: dict[str, float] = {}
    missing: list[str] = []
    for other in list_error_motions(axis.name):
        if other in known:
            continue
        share = _express_motion(result, other, known).get(symbol, 0.0)
        if share and other in direct:
            # From mm and rad to µm and µrad.
            scale = scale_of(find_unit(symbol)) / scale_of(find_unit(other))
            shares[other] = scale * share
        elif share:
            missing.append(other)
    return shares, tuple(missing)


def _express_motion(
    result: CalibrationResult, other: str, known: list[str]
) -> dict[str, float]:
    """A unit of a motion as a sum of others of its axis, mm and rad."""
    rng = np.random.default_rng(0)
    low = np.array([axis.low for axis in result.machine.axes])
    high = np.array([axis.high for axis in result.machine.axes])
    offsets = np.array([t.offset_mm for t in result.machine.targets], float)
    at = make_standstill(
        result.machine,
        rng.uniform(low, high, (_PROBE, len(low))),
        offsets[np.arange(_PROBE) % len(offsets)],
    )
    own = compute_arm(other, at).ravel()
    columns = np.column_stack([compute_arm(symbol, at).ravel() for symbol in known])
    found, *_ = np.linalg.lstsq(columns, own, rcond=None)
    left = np.linalg.norm(own - columns @ found)
    if left > _MERGES * max(float(np.linalg.norm(own)), 1.0):
        return {}
    small = _MERGES * max(float(np.abs(found).max()), 1e-12)
    return {
        symbol: float(c)
        for symbol, c in zip(known, found, strict=True)
        if abs(c) > small
    }
