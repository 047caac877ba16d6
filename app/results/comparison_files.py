"""A comparison as `comparison.json` and `comparison.csv`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.kinematics.symbols import is_straightness, is_turn
from app.results.comparison import ComparedError, ComparedNumber, Comparison, K
from app.results.comparison_volume import ComparedVolume, mean_length

SCHEMA = "comparison/1"
HEADER = (
    "error,position,position_unit,result,result_uncertainty,reference,"
    "reference_uncertainty,difference,combined_uncertainty,en,unit"
)
KINDS = ("positioning", "straightness", "turns")


def kind_of(symbol: str) -> str:
    """Return the paper's kind of an error motion."""
    if is_turn(symbol):
        return "turns"
    return "straightness" if is_straightness(symbol) else "positioning"


def comparison_json(
    comparison: Comparison, volume: ComparedVolume | None, names: dict[str, str]
) -> dict[str, Any]:
    """Return the content of `comparison.json`; uncertainties are standard ones.

    names : of the machine, the result and the reference
    """
    return {
        "schema": SCHEMA,
        **names,
        "convention": "positioning and turns are 0 at the axis zero, else at the "
        "lowest position; straightness is 0 there and at the highest position; the "
        "mean of both directions",
        "errors": {e.symbol: _error_json(e) for e in comparison.errors},
        "numbers": {n.symbol: _number_json(n) for n in comparison.numbers},
        "kinds": {kind: _kind_json(comparison, kind) for kind in KINDS},
        "volumetric": None if volume is None else _volume_json(volume),
        "not_compared": comparison.not_compared,
    }


def comparison_csv(comparison: Comparison) -> str:
    """Return the text of `comparison.csv`: a row a position."""
    return "".join(f"{line}\n" for line in _lines(comparison))


def largest(error: ComparedError) -> float:
    """Return the largest difference of an error motion."""
    return float(np.abs(error.difference).max())


def agreeing(error: ComparedError) -> float:
    """Return the share of positions at which both agree: |E_n| at most 1."""
    known = error.combined > 0
    if not known.any():
        return 1.0
    return float((np.abs(error.normalised[known]) <= 1.0).mean())


def _error_json(error: ComparedError) -> dict[str, Any]:
    unit = error.unit
    return {
        f"position_{error.position_unit}": error.position_mm.tolist(),
        f"result_{unit}": error.value.tolist(),
        f"result_uncertainty_{unit}": error.sigma.tolist(),
        f"reference_{unit}": error.reference.tolist(),
        f"reference_uncertainty_{unit}": error.reference_sigma.tolist(),
        f"forward_{unit}": _or_none(error.forward),
        f"backward_{unit}": _or_none(error.backward),
        f"difference_{unit}": error.difference.tolist(),
        f"combined_uncertainty_{unit}": error.combined.tolist(),
        "en": error.normalised.tolist(),
        f"largest_difference_{unit}": largest(error),
        f"mean_difference_{unit}": float(np.abs(error.difference).mean()),
        "largest_en": float(np.abs(error.normalised).max()),
        "share_within": agreeing(error),
        "merged": list(error.merged),
        "missing": list(error.missing),
    }


def _or_none(values: Float64[np.ndarray, " n"]) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in values.tolist()]


def _number_json(number: ComparedNumber) -> dict[str, float]:
    unit = number.unit
    return {
        f"result_{unit}": number.value,
        f"result_uncertainty_{unit}": number.sigma,
        f"reference_{unit}": number.reference,
        f"reference_uncertainty_{unit}": number.reference_sigma,
        f"difference_{unit}": number.difference,
        f"combined_uncertainty_{unit}": number.combined,
        "en": number.normalised,
    }


def _kind_json(comparison: Comparison, kind: str) -> dict[str, Any] | None:
    """Return the figures that the paper states for a kind of motions."""
    errors = [e for e in comparison.errors if kind_of(e.symbol) == kind]
    if not errors:
        return None
    unit = errors[0].unit
    every = np.abs(np.concatenate([e.difference for e in errors]))
    return {
        "motions": len(errors),
        f"largest_difference_{unit}": float(every.max()),
        f"mean_difference_{unit}": float(every.mean()),
        f"largest_expanded_{unit}": K * max(float(e.combined.max()) for e in errors),
        "share_within": float(np.mean([agreeing(e) for e in errors])),
    }


def _volume_json(volume: ComparedVolume) -> dict[str, Any]:
    return {
        "points": len(volume.position),
        "result_mean_um": mean_length(volume.value_um),
        "reference_mean_um": mean_length(volume.reference_um),
        "difference_mean_um": mean_length(volume.difference_um),
        "difference_largest_um": float(
            np.linalg.norm(volume.difference_um, axis=1).max()
        ),
        "note": "of the errors that both know, squareness left out, on a regular grid "
        "over the range of the reference",
    }


def _lines(comparison: Comparison) -> Iterator[str]:
    yield HEADER
    for error in comparison.errors:
        columns = (
            error.value,
            error.sigma,
            error.reference,
            error.reference_sigma,
            error.difference,
            error.combined,
            error.normalised,
        )
        for position, *row in zip(error.position_mm, *columns, strict=True):
            numbers = ",".join(f"{value:z.5f}" for value in row)
            yield (
                f"{error.symbol},{position:.4f},{error.position_unit},{numbers},"
                f"{error.unit}"
            )
    for n in comparison.numbers:
        row = (
            n.value,
            n.sigma,
            n.reference,
            n.reference_sigma,
            n.difference,
            n.combined,
            n.normalised,
        )
        numbers = ",".join(f"{value:z.5f}" for value in row)
        yield f"{n.symbol},,,{numbers},{n.unit}"
