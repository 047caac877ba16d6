"""The volumetric error where all axes move, rotary ones too, before and with files."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.error_map import ErrorMap, find_own_arm
from truepath.app.compensation.format import Correction
from truepath.app.compensation.remaining_error import (
    COVERAGE,
    SIDES,
    RemainingError,
    draw_errors_mm,
    find_scale,
    remove_from_both,
)
from truepath.app.compensation.rotary_left import (
    RotaryFiles,
    draw_half_turns_rad,
    sample_positions,
)
from truepath.app.kinematics.conditions import Conditions, make_standstill
from truepath.app.kinematics.effects.location_error import list_axis_locations


def measure_over_axes(
    errors: ErrorMap, correction: Correction, files: RotaryFiles
) -> dict[str, Any] | None:
    """Return the mean length of the error, µm; None for a machine of straight axes.

    correction : what the control adds to straight axes; files : what else it does

    Before and after are of the map; expected after is of errors that the measurement
    allows, as in the account of straight axes.
    """
    if not errors.machine.rotary_axes:
        return None
    at = make_standstill(errors.machine, sample_positions(errors))
    error = np.stack([_find_error_mm(errors, at, side) for side in SIDES])
    moved = np.stack([_move(errors, at, correction, files, side) for side in SIDES])
    drawn = _draw_errors_mm(errors, at)
    before, after = (
        _remove_rigid(at, left, drawn, find_scale(errors.result))
        for left in (error, error + moved)
    )
    expected = after.state() or {}
    return {
        "before": before.state_map()["mean"],
        "before_expanded_uncertainty": COVERAGE * before.find_map_uncertainty_um(),
        "after": after.state_map()["mean"],
        "after_expected": expected["mean"],
        "after_expanded_uncertainty": COVERAGE * expected["mean_uncertainty"],
        "coverage_factor": COVERAGE,
        "on": f"mean length over {len(at)} positions that fill the travel of all axes "
        "evenly, up and down, without rigid motion of the workpiece; expected after: "
        "of errors that the measurement allows, drawn from its covariance",
    }


def _find_error_mm(
    errors: ErrorMap, at: Conditions, side: float
) -> Float64[np.ndarray, "n 3"]:
    """Return the error in a direction of all axes, lost motion of rotary ones too."""
    error = errors.error_mm(at.position_mm, side)
    for axis in errors.machine.rotary_axes:
        at_deg = at.position_mm[:, errors.machine.axis_names.index(axis.name)]
        half = side * errors.half_turn_rad(axis.name, at_deg)
        error += half[:, None] * find_own_arm(axis, at)
    return error


def _move(
    errors: ErrorMap,
    at: Conditions,
    correction: Correction,
    files: RotaryFiles,
    side: float,
) -> Float64[np.ndarray, "n 3"]:
    machine, sent = errors.machine, at.position_mm.copy()
    for column, name in enumerate(machine.axis_names):
        if name in files.added:
            sent[:, column] += files.added[name].read(at.position_mm[:, column], side)
    straight = [machine.axis_names.index(name) for name in "XYZ"]
    sent[:, straight] += correction(at.position_mm, side)
    moved = make_standstill(machine, sent).chain.point_mm - at.chain.point_mm
    if files.is_composed:  # the correction has the locations in it
        return moved
    for axis in machine.rotary_axes:
        for one in list_axis_locations(axis):
            if value := files.located.get(one.symbol):
                moved -= one.jacobian(at)[:, :, 0] * value
    return moved


def _draw_errors_mm(errors: ErrorMap, at: Conditions) -> Float64[np.ndarray, "s n 3 d"]:
    """Return what the map may be wrong by, lost motion of rotary axes with it."""
    drawn = draw_errors_mm(errors, at.position_mm)
    for axis in errors.machine.rotary_axes:
        at_deg = at.position_mm[:, errors.machine.axis_names.index(axis.name)]
        half = draw_half_turns_rad(errors, axis, at_deg, drawn.shape[3])
        moved = find_own_arm(axis, at)[:, :, None] * half[:, None]
        for number, side in enumerate(SIDES):
            drawn[number] += side * moved
    return drawn


def _remove_rigid(
    at: Conditions,
    left_mm: Float64[np.ndarray, "s n 3"],
    drawn_mm: Float64[np.ndarray, "s n 3 d"],
    scale: float,
) -> RemainingError:
    """Return errors without the rigid motion that both directions have in common."""
    weight, point_mm = np.full(len(at), 1.0 / len(at)), at.chain.point_mm
    return RemainingError(
        point_mm,
        remove_from_both(point_mm, list(left_mm), weight),
        remove_from_both(point_mm, list(drawn_mm), weight),
        np.ones(len(at), bool),
        weight,
        scale,
    )
