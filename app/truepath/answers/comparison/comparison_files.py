"""A comparison as `comparison.json` and `comparison.csv`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.answers.comparison.comparison import (
    ComparedError,
    ComparedNumber,
    ComparedVolume,
    Comparison,
    K,
    mean_length,
)
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.kinematics.machine.symbols import is_straightness, is_turn

SCHEMA = "comparison/1"
HEADER = (
    "error,position,position_unit,result,result_uncertainty,reference,"
    "reference_uncertainty,difference,combined_uncertainty,en,unit"
)
KINDS = ("positioning", "straightness", "turns")


def classify(symbol: str) -> str:
    """One of `KINDS`, the paper's kinds of error motions."""
    if is_turn(symbol):
        return "turns"
    return "straightness" if is_straightness(symbol) else "positioning"


def comparison_json(
    comparison: Comparison,
    volume: ComparedVolume | None,
    names: dict[str, str],
    verdict: Verdict,
) -> dict[str, Any]:
    """Content of `comparison.json`; uncertainties are standard ones.

    names : of the machine, the result and the reference; verdict : of the result
    """
    return {
        "schema": SCHEMA,
        **names,
        "verdict": verdict_json(verdict),
        "convention": "positioning and turns are 0 at the axis zero, else at the "
        "lowest position; straightness is 0 there and at the highest position; the "
        "mean of both directions",
        "errors": {e.symbol: _error_json(e) for e in comparison.errors},
        "numbers": {n.symbol: _columns_json(n) for n in comparison.numbers},
        "kinds": {kind: _kind_json(comparison, kind) for kind in KINDS},
        "volumetric": None if volume is None else _volume_json(volume),
        "not_compared": comparison.not_compared,
    }


def comparison_csv(comparison: Comparison) -> str:
    """Text of `comparison.csv`: one row per position."""
    rows = [",".join(row) for row in _list_rows(comparison)]
    return "".join(f"{line}\n" for line in (HEADER, *rows))


def compute_agreement(error: ComparedError) -> float:
    """Share of positions with |E_n| ≤ 1, without those that are 0 by convention."""
    known = error.combined > 0
    if not known.any():
        return 1.0
    return float((np.abs(error.normalised[known]) <= 1.0).mean())


def _error_json(error: ComparedError) -> dict[str, Any]:
    unit = error.unit
    return {
        f"position_{error.position_unit}": error.position_mm.tolist(),
        **_columns_json(error),
        f"forward_{unit}": _or_none(error.forward),
        f"backward_{unit}": _or_none(error.backward),
        f"largest_difference_{unit}": float(np.abs(error.difference).max()),
        f"mean_difference_{unit}": float(np.abs(error.difference).mean()),
        "largest_en": float(np.abs(error.normalised).max()),
        "share_within": compute_agreement(error),
        "merged": list(error.merged),
        "missing": list(error.missing),
    }


def _or_none(values: Float64[np.ndarray, " n"]) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in values.tolist()]


def _columns(one: ComparedNumber) -> dict[str, Float64[np.ndarray, "*n"]]:
    return {
        "result": one.value,
        "result_uncertainty": one.sigma,
        "reference": one.reference,
        "reference_uncertainty": one.reference_sigma,
        "difference": one.difference,
        "combined_uncertainty": one.combined,
        "en": one.normalised,
    }


def _columns_json(one: ComparedNumber) -> dict[str, Any]:
    return {
        key if key == "en" else f"{key}_{one.unit}": values.tolist()
        for key, values in _columns(one).items()
    }


def _kind_json(comparison: Comparison, kind: str) -> dict[str, Any] | None:
    """The figures that the paper states for a kind of motions."""
    errors = [e for e in comparison.errors if classify(e.symbol) == kind]
    if not errors:
        return None
    unit = errors[0].unit
    every = np.abs(np.concatenate([e.difference for e in errors]))
    return {
        "motions": len(errors),
        f"largest_difference_{unit}": float(every.max()),
        f"mean_difference_{unit}": float(every.mean()),
        f"largest_expanded_{unit}": K * max(float(e.combined.max()) for e in errors),
        "share_within": float(np.mean([compute_agreement(e) for e in errors])),
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


def _list_rows(comparison: Comparison) -> Iterator[list[str]]:
    for error in comparison.errors:
        columns = _columns(error).values()
        for at, *numbers in zip(error.position_mm, *columns, strict=True):
            cells = [f"{value:z.5f}" for value in numbers]
            place = f"{at:.4f}", error.position_unit
            yield [error.symbol, *place, *cells, error.unit]
    for one in comparison.numbers:
        cells = [f"{value:z.5f}" for value in _columns(one).values()]
        yield [one.symbol, "", "", *cells, one.unit]
