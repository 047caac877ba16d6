"""The volumetric error at any points, from a result alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64

from truepath.estimation.solve.extrapolation import (
    beyond_travel_variance_mm2,
    estimate_variations,
    full_travel,
)
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.earlier.verdict import Verdict
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.volumetric_map import build_volumetric_map

_USUAL_ENDS = 0.05  # of the travel: lines rarely go closer to its ends
_BLOCK = 1000  # points at a time: their Jacobian stays in the cache


@dataclass(frozen=True, slots=True)
class Prediction:
    """Volumetric error δ = actual − nominal at n points, without its rigid motion.

    error_um : (n, 3); uncertainty_um : (n, 3), standard uncertainty (k = 1)
    warnings : sentences for the user
    verdict : of the result that it is from
    """

    error_um: Float64[np.ndarray, "n 3"]
    uncertainty_um: Float64[np.ndarray, "n 3"]
    warnings: tuple[str, ...]
    verdict: Verdict = field(default_factory=Verdict)


def predict(
    result: CalibrationResult,
    position: Float64[np.ndarray, "n a"],
    targets: Sequence[str] = (),
) -> Prediction:
    """Predict the volumetric error at axis positions, in blocks of bounded size.

    position : (n, axes) in the column order of the machine; inside the travel or not
    targets : the target at each point; the first of the machine where left out
    """
    error, uncertainty = np.empty((len(position), 3)), np.empty((len(position), 3))
    told = result.reduce_to_targets
    known = estimate_variations(
        told.model,
        told.theta,
        result.measured or full_travel(result.machine),
        told.covariance,
    )
    for name, rows in _group_by_target(targets, len(position)):
        found = build_volumetric_map(result.model, name)
        offset = np.array(result.machine.target(name).offset_mm, float)
        for begin in range(0, len(rows), _BLOCK):
            block = rows[begin : begin + _BLOCK]
            offset_mm = np.tile(offset, (len(block), 1))
            at = make_standstill(result.machine, position[block], offset_mm)
            variance = found.sigma_mm(at, result.covariance) ** 2
            variance += beyond_travel_variance_mm2(at, told.model, known)
            error[block] = UM_PER_MM * found.error_mm(at, result.theta)
            uncertainty[block] = UM_PER_MM * np.sqrt(variance)
    return Prediction(
        error,
        uncertainty,
        tuple(_list_warnings(result, position, targets)),
        result.verdict,
    )


def find_unmeasured(
    result: CalibrationResult, position: Float64[np.ndarray, "n a"]
) -> Bool[np.ndarray, " n"]:
    """Points beyond the measured range by more than 5 % of the travel.

    position : (n, axes) in the column order of the machine
    """
    beyond = np.zeros(len(position), bool)
    for column, axis in enumerate(result.machine.axes):
        if axis.name in result.measured:
            low, high = result.measured[axis.name]
            slack = _USUAL_ENDS * (axis.high - axis.low)
            at = position[:, column]
            beyond |= (at < low - slack) | (at > high + slack)
    return beyond | _find_outside(result.machine, position)


def _group_by_target(
    targets: Sequence[str], count: int
) -> list[tuple[str, np.ndarray[tuple[int], np.dtype[np.int64]]]]:
    if not targets:
        return [("", np.arange(count))]
    names = np.array(targets)
    return [(str(name), np.flatnonzero(names == name)) for name in np.unique(names)]


def _list_warnings(
    result: CalibrationResult,
    position: Float64[np.ndarray, "n a"],
    targets: Sequence[str],
) -> Iterator[str]:
    outside = int(_find_outside(result.machine, position).sum())
    if outside:
        travel = ", ".join(
            f"{axis.name} {axis.low:g} to {axis.high:g}" for axis in result.machine.axes
        )
        yield (
            f"{outside} of {len(position)} points lie beyond the travel ({travel}): "
            "the errors are continued straight there, and the uncertainty grows as the "
            "motions bend within the travel"
        )
    unseen = int(find_unmeasured(result, position).sum()) - outside
    if unseen > 0:
        seen = ", ".join(
            f"{name} {low:.0f} to {high:.0f}"
            for name, (low, high) in result.measured.items()
        )
        yield (
            f"{unseen} of {len(position)} points lie in the travel but far beyond what "
            f"was measured ({seen}): extrapolated with a bounded slope, and with the "
            "uncertainty that goes with it"
        )
    if len(result.machine.targets) > 1 and not targets:
        name = result.machine.target().name
        yield f"the points name no target: {name} is meant, the first of the machine"


def _find_outside(
    machine: Machine, position: Float64[np.ndarray, "n a"]
) -> Bool[np.ndarray, " n"]:
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    slack = 1e-6 * (high - low)  # numbers that were rounded when they were written
    return ((position < low - slack) | (position > high + slack)).any(axis=1)
