"""A result against a direct measurement of single error motions.

sanders-2023, section 2.3. Both sides are put into one convention over the positions
that both know: positioning and turns are 0 at the axis zero, else at the lowest
position; straightness is 0 there and at the highest. What one target cannot tell from
other motions (a turn of the last axis) is merged into the direct values in the same
way, so that like is compared with like. The values of both directions are averaged: the
map of a result is the mean of both.

The normalised error is E_n = d / (2 √(u² + u_ref²)) as in ISO/IEC 17043: |E_n| ≤ 1 says
that both agree within their expanded uncertainties (k = 2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.errors import BadInput
from app.files.result_file import CalibrationResult
from app.files.run import DirectMeasurement
from app.files.units import scale_of
from app.kinematics.machine import Axis, position_unit
from app.kinematics.symbols import (
    SQUARENESS,
    describe_symbol,
    find_unit,
    is_location,
    list_error_motions,
)
from app.results.comparison_gauge import (
    build_convention,
    find_merged_shares,
    index_motions,
)
from app.results.direct_error import DirectError, direct_error
from app.results.error_tables import result_tables

K = 2.0


@dataclass(frozen=True, slots=True)
class ComparedError:
    """One error motion in both, in the convention of the paper.

    unit : "um" or "urad", of every value
    position_mm : (n,) of the axis; deg where `position_unit` says so
    sigma, reference_sigma : (n,) standard uncertainties (k = 1)
    forward, backward : (n,) direct values of one direction; NaN where not measured
    forward_spread, backward_spread : (n,) standard deviations over the runs
    merged : motions whose share the direct values were given, as the result has it
    missing : motions whose share the result has and the reference does not know
    """

    symbol: str
    unit: str
    position_unit: str
    position_mm: Float64[np.ndarray, " n"]
    value: Float64[np.ndarray, " n"]
    sigma: Float64[np.ndarray, " n"]
    reference: Float64[np.ndarray, " n"]
    reference_sigma: Float64[np.ndarray, " n"]
    forward: Float64[np.ndarray, " n"]
    backward: Float64[np.ndarray, " n"]
    forward_spread: Float64[np.ndarray, " n"]
    backward_spread: Float64[np.ndarray, " n"]
    merged: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def difference(self) -> Float64[np.ndarray, " n"]:
        """Result less reference."""
        return self.value - self.reference

    @property
    def combined(self) -> Float64[np.ndarray, " n"]:
        """Standard uncertainty of the difference; 0 where both are 0 by convention."""
        return np.hypot(self.sigma, self.reference_sigma)

    @property
    def normalised(self) -> Float64[np.ndarray, " n"]:
        """E_n of each position; 0 where a value is 0 by convention."""
        known = self.combined > 0
        half = np.where(known, K * self.combined, 1.0)
        return np.where(known, self.difference / half, 0.0)


@dataclass(frozen=True, slots=True)
class ComparedNumber:
    """A squareness or a location in both, with standard uncertainties."""

    symbol: str
    unit: str
    value: float
    sigma: float
    reference: float
    reference_sigma: float

    @property
    def difference(self) -> float:
        """Result less reference."""
        return self.value - self.reference

    @property
    def combined(self) -> float:
        """Standard uncertainty of the difference."""
        return float(np.hypot(self.sigma, self.reference_sigma))

    @property
    def normalised(self) -> float:
        """E_n."""
        return self.difference / (K * self.combined) if self.combined > 0 else 0.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """What both say; `not_compared` names a reason for each symbol that one lacks."""

    errors: tuple[ComparedError, ...]
    numbers: tuple[ComparedNumber, ...]
    not_compared: dict[str, str]

    def error(self, symbol: str) -> ComparedError | None:
        """Return an error motion, or None where it was not compared."""
        return next((e for e in self.errors if e.symbol == symbol), None)


@dataclass(frozen=True, slots=True)
class ReferenceUncertainty:
    """Standard uncertainty of the direct instrument beside what its runs show."""

    um: float = 0.0
    urad: float = 0.0

    def of(self, unit_name: str) -> float:
        """Return it in a unit."""
        return self.urad if unit_name == "urad" else self.um


def compare(
    result: CalibrationResult,
    reference: Sequence[DirectMeasurement],
    instrument: ReferenceUncertainty | None = None,
) -> Comparison:
    """Compare a result with direct measurements.

    instrument : uncertainty of the reference that its repeated runs do not show

    Raises BadInput if no error is known to both, or one is stated in a wrong unit.
    """
    stated = instrument or ReferenceUncertainty()
    _refuse_units(reference)
    direct = {
        symbol: direct_error(symbol, reference, stated.of(find_unit(symbol)))
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
    told = {e.symbol for e in errors} | {n.symbol for n in numbers} | set(refused)
    refused |= {s: "the result does not state it" for s in direct if s not in told}
    if not errors and not numbers:
        raise BadInput(
            "result and reference have no error in common; the reference measures "
            f"{', '.join(direct)}, the result tells {', '.join(index_motions(result))}"
        )
    return Comparison(tuple(errors), numbers, refused)


def _refuse_units(reference: Sequence[DirectMeasurement]) -> None:
    for one in reference:
        if one.unit != find_unit(one.error):
            raise BadInput(
                f"the reference states {one.error} in {one.unit}; it is measured in "
                f"{find_unit(one.error)}"
            )


def _compare_error(
    result: CalibrationResult, axis: Axis, symbol: str, direct: dict[str, DirectError]
) -> ComparedError | str:
    """Return both in one convention, or the reason why not."""
    motions = index_motions(result)
    if symbol not in motions:
        return "the result does not tell it with the measured targets"
    if symbol not in direct:
        return "the reference does not measure it"
    theirs = direct[symbol].within(axis.low, axis.high)
    if len(theirs.position_mm) < 2:
        return "the reference has fewer than two positions in the travel"
    shares, missing = find_merged_shares(result, axis, symbol, direct)
    theirs, merged = _add_shares(theirs, shares, direct)
    gauge = build_convention(symbol, axis, theirs.position_mm)
    rows = gauge @ motions[symbol].rows(theirs.position_mm)
    part = result.model.slices[symbol]
    scale = scale_of(find_unit(symbol))
    variance = np.einsum("np,np->n", rows @ result.covariance[part, part], rows)
    removed = theirs.mean - gauge @ theirs.mean  # of both directions: reversal stays
    return ComparedError(
        symbol,
        find_unit(symbol),
        position_unit(axis),
        theirs.position_mm,
        scale * (rows @ result.theta[part]),
        scale * np.sqrt(np.maximum(variance, 0.0)),
        gauge @ theirs.mean,
        np.sqrt((gauge**2) @ theirs.sigma**2),
        theirs.forward - removed,
        theirs.backward - removed,
        theirs.forward_spread,
        theirs.backward_spread,
        merged,
        missing,
    )


def _add_shares(
    theirs: DirectError, shares: dict[str, float], direct: dict[str, DirectError]
) -> tuple[DirectError, tuple[str, ...]]:
    for other, share in shares.items():
        theirs = theirs.plus(direct[other], share)
    return theirs, tuple(shares)


def _compare_numbers(
    result: CalibrationResult, direct: dict[str, DirectError]
) -> Iterator[ComparedNumber]:
    """Compare what belongs to no position."""
    tables = result_tables(result)
    ours = {e.symbol: e for e in (*tables.squareness, *tables.locations)}
    for symbol, theirs in direct.items():
        if symbol not in ours or not (symbol in SQUARENESS or is_location(symbol)):
            continue
        reference_sigma = float(np.sqrt(np.mean(theirs.sigma**2)))
        yield ComparedNumber(
            symbol,
            find_unit(symbol),
            ours[symbol].value,
            ours[symbol].uncertainty,
            float(theirs.mean.mean()),
            reference_sigma,
        )


def described(error: ComparedError) -> str:
    """Return the error in words, with what is merged into it."""
    text = describe_symbol(error.symbol)
    if error.merged:
        text += f", with its share of {', '.join(error.merged)}"
    if error.missing:
        text += f"; holds a share of {', '.join(error.missing)}, not in the reference"
    return text
