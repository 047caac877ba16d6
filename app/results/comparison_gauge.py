"""One convention for both sides of a comparison, and one way of merging motions.

Positioning and turns are 0 at the axis zero, else at the lowest position; straightness
is 0 there and at the highest (sanders-2023, section 2.3.1). A motion that the measured
targets do not tell moves them like others of its axis: the result has its share in
those, so the direct values are given it as well.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.files.result_file import CalibrationResult
from app.files.units import scale_of
from app.kinematics.conditions import make_standstill
from app.kinematics.effects.error_motion import ErrorMotion, find_arm
from app.kinematics.machine import Axis, LinearAxis
from app.kinematics.symbols import find_unit, is_straightness, list_error_motions
from app.results.direct_error import DirectError

_SAME_MM = 1e-6
_PROBE = 60  # configurations that tell how motions merge
_MERGES = 1e-6  # of a merged motion: left over by those it merges into


def index_motions(result: CalibrationResult) -> dict[str, ErrorMotion]:
    """Return the error motions that a result tells, by symbol."""
    return {motion.symbol: motion for motion in result.model.error_motions}


def build_convention(
    symbol: str, axis: Axis, position_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n n"]:
    """Return the matrix that puts values at sorted positions into the convention."""
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
    """Return what of other motions of the axis the result has in this one.

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
            shares[other] = share * _convert_share(symbol, other)
        elif share:
            missing.append(other)
    return shares, tuple(missing)


def _express_motion(
    result: CalibrationResult, other: str, known: list[str]
) -> dict[str, float]:
    """Return a unit of a motion as a sum of others of its axis, mm and rad."""
    rng = np.random.default_rng(0)
    low = np.array([axis.low for axis in result.machine.axes])
    high = np.array([axis.high for axis in result.machine.axes])
    offsets = np.array([t.offset_mm for t in result.machine.targets], float)
    at = make_standstill(
        result.machine,
        rng.uniform(low, high, (_PROBE, len(low))),
        offsets[np.arange(_PROBE) % len(offsets)],
    )
    own = find_arm(other, at).ravel()
    columns = np.column_stack([find_arm(symbol, at).ravel() for symbol in known])
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


def _convert_share(symbol: str, other: str) -> float:
    """Return the factor from (mm, rad) to (µm, µrad) of a share."""
    return scale_of(find_unit(symbol)) / scale_of(find_unit(other))
