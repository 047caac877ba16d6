"""The volumetric error on a grid over the travel, before and after compensation.

Before is the estimated map. After, if −δ̂ is applied in full, the direction of the
remaining error is unknown; only its length follows from the stated uncertainty. With
files of a format, the errors that the format cannot correct remain as well, by the
reading of their controller.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import Correction
from truepath.compensation.order import read_stored_files
from truepath.compensation.residual_error import SIDES, remove_rigid_motion
from truepath.compensation.tables.error_map import ErrorMap, map_errors
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import read_whole, replace_file
from truepath.errors import BadInput
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    read_result,
)
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.results.prediction import find_unmeasured, predict
from truepath.results.volumetric_error import sample_parameters

SCHEMA = "volumetric-map/1"
STATES = ("before", "after")
_DECIMALS = 4  # of µm


@dataclass(frozen=True, slots=True)
class MapOrder:
    """The requested map.

    points : per axis; state : one of `STATES`
    compensation : name of stored files, for the state after; the full correction if
        None
    """

    points: int
    state: str
    compensation: str | None = None

    @property
    def name(self) -> str:
        """Unique per result: the same order makes the same map."""
        parts = (self.state, str(self.points), self.compensation)
        return "-".join(part for part in parts if part)


def store_map(
    source: Path, folder: Path, order: MapOrder, compensations: Path
) -> dict[str, Any]:
    """The map as a document, computed once and stored in the folder.

    Errors are in µm, as far as known the mean of both directions, at positions of a
    grid (rotary axes at their zero, X slowest), with k = 1. The length after is that
    expected of the remaining error.

    source : a result or model file; compensations : folder of stored files

    Raises BundleError with the place in the result; NotFound where no such files are
    stored; BadInput where files are named before compensation.
    """
    kept = folder / f"{order.name}.json"
    if not kept.is_file():
        result = read_result(source)
        errors = map_errors(result)
        correction = _read_correction(errors, order, compensations)
        content = _compute_map(result.verdict, errors, order, correction)
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(kept, encode_json(content))
    return json.loads(read_whole(kept, largest_bytes=LARGEST_BYTES))


def _compute_map(
    verdict: Verdict, errors: ErrorMap, order: MapOrder, correction: Correction | None
) -> dict[str, Any]:
    machine, position = errors.machine, _make_grid(errors, order.points)
    predicted = predict(errors.result, position)
    error = predicted.error_um
    length = np.linalg.norm(error, axis=1)
    if order.state == "after":
        error = _compute_residual_um(errors, position, correction)
        length = _compute_expected_length_um(errors, position, error)
    return {
        "schema": SCHEMA,
        "state": order.state,
        "compensation": order.compensation,
        "points": order.points,
        "axes": list(machine.axis_names),
        "target": machine.target().name,
        "verdict": verdict_json(verdict),
        "position": position.round(_DECIMALS).tolist(),
        "error_um": _round(error),
        "uncertainty_um": _round(predicted.uncertainty_um),
        "length_um": _round(length),
        "is_measured": (~find_unmeasured(errors.result, position)).tolist(),
    }


def _make_grid(errors: ErrorMap, points: int) -> Float64[np.ndarray, "n a"]:
    travel = [np.linspace(axis.low, axis.high, points) for axis in errors.axes]
    places = np.meshgrid(*travel, indexing="ij")
    position = np.tile(errors.middle_mm, (places[0].size, 1))
    for axis, place in zip(errors.axes, places, strict=True):
        position[:, errors.machine.axis_names.index(axis.name)] = place.ravel()
    return position


def _compute_residual_um(
    errors: ErrorMap,
    position: Float64[np.ndarray, "n a"],
    correction: Correction | None,
) -> Float64[np.ndarray, "n 3"]:
    if correction is None:
        return np.zeros((len(position), 3))
    sides = [
        errors.error_mm(position, side) + correction(position, side) for side in SIDES
    ]
    mean = np.mean(sides, axis=0)
    straight = [errors.machine.axis_names.index(axis.name) for axis in errors.axes]
    return UM_PER_MM * remove_rigid_motion(position[:, straight], mean)


def _compute_expected_length_um(
    errors: ErrorMap,
    position: Float64[np.ndarray, "n a"],
    left_um: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, " n"]:
    at = make_standstill(errors.machine, position)
    J = errors.volumetric_map.jacobian(at).reshape(3 * len(position), -1)
    drawn = UM_PER_MM * (J @ sample_parameters(errors.result.covariance))
    total = left_um[:, :, None] + drawn.reshape(len(position), 3, -1)
    return np.linalg.norm(total, axis=1).mean(axis=1)


def _read_correction(
    errors: ErrorMap, order: MapOrder, compensations: Path
) -> Correction | None:
    if order.compensation is None:
        return None
    if order.state != "after":
        raise BadInput(
            f"compensation {order.compensation!r} is of the state after, not of "
            f"{order.state}; ask for state=after, or leave compensation out"
        )
    return read_stored_files(
        compensations / order.compensation, errors.machine
    ).additional_correction


def _round(values: Float64[np.ndarray, "..."]) -> Sequence[Any]:
    return (values.round(_DECIMALS) + 0.0).tolist()
