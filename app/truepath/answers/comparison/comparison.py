"""A result compared with a direct measurement: single error motions, and the volume.

sanders-2023, section 2.3. Both sides are converted to one convention over the positions
that both know: positioning and turns are 0 at the axis zero, else at the lowest
position; straightness is 0 there and at the highest. What one target cannot distinguish
from other motions (a turn of the last axis) is merged into the direct values in the
same way, so that like is compared with like. The values of both directions are
averaged: the map of a result is the mean of both.

The normalised error is E_n = d / (2 √(u² + u_ref²)) as in ISO/IEC 17043: |E_n| ≤ 1
means that both agree within their expanded uncertainties (k = 2). u of positioning
includes the scale of air and tracker, which tables leave out: the reference has another
one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.answers.comparison.direct_error import (
    DirectError,
    build_convention,
    combine_direct_error,
    find_merged_shares,
    index_motions,
)
from truepath.errors import BadInput
from truepath.files.bundle.run import DirectMeasurement
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import UM_PER_MM, scale_of
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import compute_arm, reference_position_mm
from truepath.kinematics.machine.machine import Axis, LinearAxis, Machine, position_unit
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    find_unit,
    is_location,
    list_error_motions,
)
from truepath.results.error_tables import build_error_tables, evaluate

K = 2.0
GRID = 9  # positions an axis


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
    _reject_units(reference)
    direct = {
        symbol: combine_direct_error(
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
            f"{', '.join(direct)}, the result tells {', '.join(index_motions(result))}"
        )
    return Comparison(tuple(errors), numbers, refused)


def _reject_units(reference: Sequence[DirectMeasurement]) -> None:
    for one in reference:
        if one.unit != find_unit(one.error):
            raise BadInput(
                f"the reference states {one.error} in {one.unit}; it is measured in "
                f"{find_unit(one.error)}"
            )


def _compare_error(
    result: CalibrationResult, axis: Axis, symbol: str, direct: dict[str, DirectError]
) -> ComparedError | str:
    motions = index_motions(result)
    if symbol not in motions:
        return "the result does not tell it with the measured targets"
    if symbol not in direct:
        return "the reference does not measure it"
    theirs = direct[symbol].within(axis.low, axis.high)
    if len(theirs.position_mm) < 2:
        return "the reference has fewer than two positions in the travel"
    shares, missing = find_merged_shares(result, axis, symbol, direct)
    for other, share in shares.items():
        theirs = theirs.plus(direct[other], share)
    gauge = build_convention(symbol, axis, theirs.position_mm)
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
    result: CalibrationResult, direct: dict[str, DirectError]
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
    position = _make_grid(machine, errors)
    at = make_standstill(machine, position)
    value, reference = np.zeros((len(position), 3)), np.zeros((len(position), 3))
    for error in errors:
        # µm per µm, or µm per µrad: the arm is in mm per rad.
        arm = compute_arm(error.symbol, at) * (UM_PER_MM / scale_of(error.unit))
        where = at.axis_mm(error.symbol[2])
        for total, stated in ((value, error.value), (reference, error.reference)):
            total += arm * np.interp(where, error.position_mm, stated)[:, None]
    return ComparedVolume(position, value, reference)


def _make_grid(
    machine: Machine, errors: list[ComparedError]
) -> Float64[np.ndarray, "n a"]:
    columns = [
        _choose_positions(axis, [e for e in errors if e.symbol[2] == axis.name])
        if isinstance(axis, LinearAxis)
        else np.array([reference_position_mm(axis)])
        for axis in machine.axes
    ]
    mesh = np.meshgrid(*columns, indexing="ij")
    return np.stack([part.ravel() for part in mesh], axis=1)


def _choose_positions(axis: LinearAxis, errors: list[ComparedError]) -> np.ndarray:
    low = max((float(e.position_mm[0]) for e in errors), default=axis.low)
    high = min((float(e.position_mm[-1]) for e in errors), default=axis.high)
    return np.linspace(low, high, GRID)
