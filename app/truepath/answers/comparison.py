"""A result compared with a direct measurement: single error motions, and the volume.

sanders-2023, section 2.3. Both sides are converted to one convention over the positions
that both know: positioning and turns are 0 at the axis zero, else at the lowest
position; straightness is 0 there and at the highest. A motion that the measured targets
do not determine (a turn of the last axis) moves them like others of its axis: the
result has its share in those, so the direct values are given it as well. The values of
both directions are averaged: the map of a result is the mean of both.

The normalised error is E_n = d / (2 √(u² + u_ref²)) as in ISO/IEC 17043: |E_n| ≤ 1
means that both agree within their expanded uncertainties (k = 2). u of positioning
includes the scale of air and tracker, which tables leave out: the reference has another
one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.files.bundle.run import DirectMeasurement
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import UM_PER_MM, scale_of
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import (
    ErrorMotion,
    compute_arm,
    reference_position_mm,
)
from truepath.kinematics.machine.machine import Axis, LinearAxis, Machine, position_unit
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    find_unit,
    is_location,
    is_straightness,
    list_error_motions,
)
from truepath.results.error_tables import build_error_tables, evaluate

_DECIMALS = 4  # of a position, mm or deg: runs stop there again and again
_SAME_MM = 1e-6
_PROBE = 60  # configurations that determine how motions merge
_MERGES = 1e-6  # of a merged motion: left over by those it merges into
K = 2.0
_GRID = 9  # positions an axis


@dataclass(frozen=True, slots=True)
class _DirectError:
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

    def within(self, low: float, high: float) -> _DirectError:
        """Only the positions inside a travel."""
        inside = (self.position_mm >= low - 1e-6) & (self.position_mm <= high + 1e-6)
        return _DirectError(*(getattr(self, f.name)[inside] for f in fields(self)))

    def plus(self, other: _DirectError, share: float) -> _DirectError:
        """Sum with a share of another, within the range of the other."""
        first, last = other.position_mm[[0, -1]]
        inside_range = self.within(float(first), float(last))
        at = inside_range.position_mm

        def of(values: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, " n"]:
            return share * np.interp(at, other.position_mm, values)

        return replace(
            inside_range,
            mean=inside_range.mean + of(other.mean),
            sigma=np.hypot(inside_range.sigma, of(other.sigma)),
            forward=inside_range.forward + of(other.forward),
            backward=inside_range.backward + of(other.backward),
        )


def _combine_direct_error(
    symbol: str, reference: Sequence[DirectMeasurement], instrument: float
) -> _DirectError:
    """One error from all its measurements, both directions.

    instrument : standard uncertainty in addition to the spread of the runs, in the
        error's unit

    The spread of runs is pooled over all positions: five runs alone determine a
    standard deviation no better than to a third.
    """
    sides = [
        _merge_direction(
            [m for m in reference if (m.error, m.direction) == (symbol, sign)]
        )
        for sign in "+-"
    ]
    both = [side for side in sides if side.shape[1]]
    position = both[0][0]
    if len(both) == 2:
        shared = np.intersect1d(position, both[1][0])
        position = shared if len(shared) else np.union1d(position, both[1][0])
    forward, backward = (_look_up(side, position) for side in sides)
    known = np.isfinite(np.stack([forward[0], backward[0]]))
    count = known.sum(axis=0)
    mean = np.nansum(np.stack([forward[0], backward[0]]), axis=0) / count
    freedom = sum(float((runs - 1).sum()) for *_, runs in both)
    square = sum(float(((runs - 1) * spread**2).sum()) for *_, spread, runs in both)
    pooled = float(np.sqrt(square / freedom)) if freedom else 0.0
    runs = np.where(known, np.stack([forward[2], backward[2]]), np.inf)
    variance = (pooled**2 / runs).sum(axis=0) / count**2
    return _DirectError(
        position,
        mean,
        np.sqrt(variance + instrument**2),
        forward[0],
        backward[0],
        forward[1],
        backward[1],
    )


def _merge_direction(
    parts: Sequence[DirectMeasurement],
) -> Float64[np.ndarray, "4 m"]:
    """Positions in ascending order, mean, spread and number of runs at each."""
    if not parts:
        return np.empty((4, 0))
    position = np.round(np.concatenate([p.position_mm for p in parts]), _DECIMALS)
    value = np.concatenate([p.value for p in parts])
    positions, index, runs = np.unique(
        position, return_inverse=True, return_counts=True
    )
    mean = np.bincount(index, value) / runs
    square = np.bincount(index, (value - mean[index]) ** 2)
    spread = np.sqrt(square / np.maximum(runs - 1, 1))
    return np.stack([positions, mean, spread, runs])


def _look_up(
    side: Float64[np.ndarray, "4 m"], position_mm: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "3 n"]:
    """Mean, spread and runs at positions; a mean is NaN where it was not measured."""
    found = np.zeros((3, len(position_mm)))
    found[0] = np.nan
    _, here, there = np.intersect1d(
        position_mm, side[0], assume_unique=True, return_indices=True
    )
    found[:, here] = side[1:, there]
    return found


def _index_motions(result: CalibrationResult) -> dict[str, ErrorMotion]:
    return {motion.symbol: motion for motion in result.model.identifiable_motions}


def _build_convention(
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


def _find_merged_shares(
    result: CalibrationResult, axis: Axis, symbol: str, direct: dict[str, _DirectError]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Shares of other motions of the axis that the result has in this one.

    The shares are by motion, in the unit of this one per unit of that one; then come
    the motions that the reference does not know.
    """
    known = [s for s in list_error_motions(axis.name) if s in _index_motions(result)]
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
    residual = np.linalg.norm(own - columns @ found)
    if residual > _MERGES * max(float(np.linalg.norm(own)), 1.0):
        return {}
    small = _MERGES * max(float(np.abs(found).max()), 1e-12)
    return {
        symbol: float(c)
        for symbol, c in zip(known, found, strict=True)
        if abs(c) > small
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedNumber:
    """A squareness or a location in both, with standard uncertainties (k = 1).

    unit : "um" or "urad", of every value; n is () here
    """

    symbol: str
    unit: str
    value: Float64[np.ndarray, "*n"]
    sigma: Float64[np.ndarray, "*n"]
    reference: Float64[np.ndarray, "*n"]
    reference_sigma: Float64[np.ndarray, "*n"]

    @property
    def difference(self) -> Float64[np.ndarray, "*n"]:
        """Result less reference."""
        return self.value - self.reference

    @property
    def combined(self) -> Float64[np.ndarray, "*n"]:
        """Standard uncertainty of the difference; 0 where both are 0 by convention."""
        return np.hypot(self.sigma, self.reference_sigma)

    @property
    def normalised(self) -> Float64[np.ndarray, "*n"]:
        """E_n; 0 where a value is 0 by convention."""
        known = self.combined > 0
        half = np.where(known, K * self.combined, 1.0)
        return np.where(known, self.difference / half, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedError(ComparedNumber):
    """One error motion in both, in the convention of the paper.

    position_mm : (n,) of the axis; deg where `position_unit` says so
    forward, backward : (n,) direct values of one direction; NaN where not measured
    forward_spread, backward_spread : (n,) standard deviations over the runs
    merged : motions whose share the direct values were given, as the result has it
    missing : motions whose share the result has and the reference does not know
    """

    position_unit: str
    position_mm: Float64[np.ndarray, " n"]
    forward: Float64[np.ndarray, " n"]
    backward: Float64[np.ndarray, " n"]
    forward_spread: Float64[np.ndarray, " n"]
    backward_spread: Float64[np.ndarray, " n"]
    merged: tuple[str, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Both sides; `not_compared` has a reason for each symbol that one lacks."""

    errors: tuple[ComparedError, ...]
    numbers: tuple[ComparedNumber, ...]
    not_compared: dict[str, str]

    def error(self, symbol: str) -> ComparedError | None:
        """None where it was not compared."""
        return next((e for e in self.errors if e.symbol == symbol), None)


@dataclass(frozen=True, slots=True)
class ReferenceUncertainty:
    """Standard uncertainty of the direct instrument, without spread of runs."""

    um: float = 0.0
    urad: float = 0.0

    def of(self, unit_name: str) -> float:
        """In "um" or "urad"."""
        return self.urad if unit_name == "urad" else self.um


def compare(
    result: CalibrationResult,
    reference: Sequence[DirectMeasurement],
    instrument: ReferenceUncertainty | None = None,
) -> Comparison:
    """Differences in the convention of this module.

    instrument : uncertainty of the reference that its repeated runs do not show

    Raises BadInput if no error is known to both, or one is stated in a wrong unit.
    """
    instrument = instrument or ReferenceUncertainty()
    for one in reference:
        if one.unit != find_unit(one.error):
            raise BadInput(
                f"the reference states {one.error} in {one.unit}; it is measured in "
                f"{find_unit(one.error)}"
            )
    direct = {
        symbol: _combine_direct_error(
            symbol, reference, instrument.of(find_unit(symbol))
        )
        for symbol in dict.fromkeys(one.error for one in reference)
    }
    errors: list[ComparedError] = []
    refused: dict[str, str] = {}
    for axis in result.machine.axes:
        for symbol in list_error_motions(axis.name):
            outcome = _compare_error(result, axis, symbol, direct)
            if isinstance(outcome, str):
                refused[symbol] = outcome
            else:
                errors.append(outcome)
    numbers = tuple(_compare_numbers(result, direct))
    stated = {e.symbol for e in errors} | {n.symbol for n in numbers} | set(refused)
    refused |= {s: "the result does not state it" for s in direct if s not in stated}
    if not errors and not numbers:
        raise BadInput(
            "result and reference have no error in common; the reference measures "
            f"{', '.join(direct)}, the result tells {', '.join(_index_motions(result))}"
        )
    return Comparison(tuple(errors), numbers, refused)


def _compare_error(
    result: CalibrationResult, axis: Axis, symbol: str, direct: dict[str, _DirectError]
) -> ComparedError | str:
    motions = _index_motions(result)
    if symbol not in motions:
        return "the result does not tell it with the measured targets"
    if symbol not in direct:
        return "the reference does not measure it"
    theirs = direct[symbol].within(axis.low, axis.high)
    if len(theirs.position_mm) < 2:
        return "the reference has fewer than two positions in the travel"
    shares, missing = _find_merged_shares(result, axis, symbol, direct)
    for other, share in shares.items():
        theirs = theirs.plus(direct[other], share)
    gauge = _build_convention(symbol, axis, theirs.position_mm)
    removed = theirs.mean - gauge @ theirs.mean  # of both directions: reversal stays
    rows = gauge @ motions[symbol].rows(theirs.position_mm)
    value, sigma = evaluate(symbol, rows, *result.reduce_to_targets.part(symbol))
    return ComparedError(
        symbol=symbol,
        unit=find_unit(symbol),
        position_unit=position_unit(axis),
        position_mm=theirs.position_mm,
        value=value,
        sigma=sigma,
        reference=gauge @ theirs.mean,
        reference_sigma=np.sqrt((gauge**2) @ theirs.sigma**2),
        forward=theirs.forward - removed,
        backward=theirs.backward - removed,
        forward_spread=theirs.forward_spread,
        backward_spread=theirs.backward_spread,
        merged=tuple(shares),
        missing=missing,
    )


def _compare_numbers(
    result: CalibrationResult, direct: dict[str, _DirectError]
) -> Iterator[ComparedNumber]:
    tables = build_error_tables(result)
    ours = {e.symbol: e for e in (*tables.squareness, *tables.locations)}
    for symbol, theirs in direct.items():
        if symbol not in ours or not (symbol in SQUARENESS or is_location(symbol)):
            continue
        yield ComparedNumber(
            symbol=symbol,
            unit=find_unit(symbol),
            value=np.array(ours[symbol].value),
            sigma=np.array(ours[symbol].uncertainty),
            reference=np.array(theirs.mean.mean()),
            reference_sigma=np.array(np.sqrt(np.mean(theirs.sigma**2))),
        )


@dataclass(frozen=True, slots=True)
class ComparedVolume:
    """Volumetric errors on a grid, squareness left out (section 2.3.2, figure 9).

    position : (n, axes); rotary axes are at their zero
    value_um, reference_um : (n, 3) of the errors that both know
    """

    position: Float64[np.ndarray, "n a"]
    value_um: Float64[np.ndarray, "n 3"]
    reference_um: Float64[np.ndarray, "n 3"]

    @property
    def difference_um(self) -> Float64[np.ndarray, "n 3"]:
        """Result less reference."""
        return self.value_um - self.reference_um


def mean_length(error: Float64[np.ndarray, "n 3"]) -> float:
    """Mean length of vectors: the paper's mean absolute error."""
    return float(np.linalg.norm(error, axis=1).mean())


def compare_volumes(machine: Machine, comparison: Comparison) -> ComparedVolume | None:
    """None if no error of a linear axis was compared."""
    straight = {axis.name for axis in machine.linear_axes}
    errors = [e for e in comparison.errors if e.symbol[2] in straight]
    if not errors:
        return None
    columns: list[Float64[np.ndarray, " g"]] = []
    for axis in machine.axes:
        if isinstance(axis, LinearAxis):
            own = [e.position_mm for e in errors if e.symbol[2] == axis.name]
            low = max((float(each[0]) for each in own), default=axis.low)
            high = min((float(each[-1]) for each in own), default=axis.high)
            columns.append(np.linspace(low, high, _GRID))
        else:
            columns.append(np.array([reference_position_mm(axis)]))
    mesh = np.meshgrid(*columns, indexing="ij")
    position = np.stack([part.ravel() for part in mesh], axis=1)
    at = make_standstill(machine, position)
    value, reference = np.zeros((len(position), 3)), np.zeros((len(position), 3))
    for error in errors:
        # µm per µm, or µm per µrad: the arm is in mm per rad.
        arm = compute_arm(error.symbol, at) * (UM_PER_MM / scale_of(error.unit))
        where = at.axis_mm(error.symbol[2])
        for total, stated in ((value, error.value), (reference, error.reference)):
            total += arm * np.interp(where, error.position_mm, stated)[:, None]
    return ComparedVolume(position, value, reference)
