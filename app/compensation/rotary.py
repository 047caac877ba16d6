"""The positioning of rotary axes as tables, and what files leave of it.

ECC is a turn of the tool relative to the workpiece. A head so turns too far by it; a
table, which turns the workpiece, too little. The tables hold how far the axis itself
turns beyond its command.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.stats import qmc

from truepath.app.compensation.axis_places import describe_locations
from truepath.app.compensation.error_map import ErrorMap
from truepath.app.compensation.rotary_tables import (
    RotaryAddition,
    RotaryTable,
)
from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.conditions import make_standstill
from truepath.app.kinematics.effects.error_motion import (
    find_arm,
    reference_position_mm,
)
from truepath.app.kinematics.machine import RotaryAxis
from truepath.app.kinematics.symbols import TURNS, list_error_motions, list_locations

SPACING_DEG = 2.5
_PLACES = 512  # all over the travel of all axes
_URAD = 1e6


def tabulate_rotary(errors: ErrorMap, most_points: int) -> tuple[RotaryTable, ...]:
    """Return a table for each rotary axis whose positioning the result has."""
    return tuple(
        _tabulate(errors, axis, most_points)
        for axis in errors.machine.rotary_axes
        if _has_positioning(errors, axis)
    )


def describe_rotary(
    errors: ErrorMap,
    tables: tuple[RotaryTable, ...],
    added: Mapping[str, RotaryAddition],
    located: Mapping[str, float],
    *,
    is_composed: bool = False,
) -> dict[str, Any]:
    """Return by axis what files leave of its positioning, and what no file has.

    added : what the controller adds, read back from the files
    located : location by symbol that it then knows, mm and rad
    is_composed : it takes what the tables say away by its straight axes: the angle
        stays, the tool is right

    Root mean squares: of the angle over the travel, and of what it does to the tool
    over the travel of all axes. Where nothing is known of the positioning, both are
    left out.
    """
    rows = {table.axis.name: table for table in tables}
    position = sample_positions(errors)
    return {
        axis.name: {
            "table": _describe_table(rows.get(axis.name)),
            **dict(
                _measure_left(
                    errors,
                    axis,
                    position,
                    added.get(axis.name),
                    rows.get(axis.name) if is_composed else None,
                )
            ),
            **dict(describe_locations(errors, axis, position, located)),
            "not_in_files": [
                one
                for one in _list_unwritten(errors, axis)
                if one not in located and not (is_composed and one[0] == "E")
            ],
        }
        for axis in errors.machine.rotary_axes
    }


def sample_positions(errors: ErrorMap) -> Float64[np.ndarray, "n a"]:
    """Return positions that fill the travel of all axes evenly."""
    axes = errors.machine.axes
    low, high = (np.array([getattr(a, end) for a in axes]) for end in ("low", "high"))
    unit = qmc.Sobol(len(axes), rng=np.random.default_rng(0)).random(_PLACES)
    return low + unit * (high - low)


def find_sense(errors: ErrorMap, axis: RotaryAxis) -> float:
    """Return 1 where the axis turns the tool, −1 where it turns the workpiece."""
    return -1.0 if axis.name in errors.machine.workpiece_side else 1.0


def _has_positioning(errors: ErrorMap, axis: RotaryAxis) -> bool:
    own = f"E{axis.name}{axis.name}"
    motions = errors.result.model.identifiable_motions
    return any(one.symbol == own for one in motions)


def _find_positioning_rad(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Return ECC of a C axis at positions; the nearest measured ones beyond these."""
    at_deg = _keep_to_measured(errors, axis, at_deg)
    return errors.rotation_rad(axis.name, at_deg)[:, TURNS.index(axis.name)]


def _keep_to_measured(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    measured = errors.result.measured.get(axis.name)
    if measured is None or axis.turns_fully:
        return at_deg
    return np.clip(at_deg, *measured)


def _tabulate(errors: ErrorMap, axis: RotaryAxis, most_points: int) -> RotaryTable:
    high = axis.low + 360.0 if axis.turns_fully else axis.high
    wanted = math.ceil((high - axis.low) / SPACING_DEG - 1e-9) + 1
    at_deg = np.linspace(axis.low, high, int(np.clip(wanted, 2, most_points)))
    zero = np.array([reference_position_mm(axis)])
    value, at_zero = (_find_positioning_rad(errors, axis, at) for at in (at_deg, zero))
    error_deg = find_sense(errors, axis) * np.degrees(value - at_zero)
    motions = _find_motions(errors, axis, at_deg)
    if axis.turns_fully:
        error_deg[-1], motions[-1] = error_deg[0], motions[0]
    return RotaryTable(axis, at_deg, error_deg, motions)


def _find_motions(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 6"]:
    """Return E and ω as the result has them; 0 where it does not know one."""
    at_deg = _keep_to_measured(errors, axis, at_deg)
    symbols, model = list_error_motions(axis.name), errors.result.model
    motions = np.zeros((len(at_deg), len(symbols)))
    for one in model.identifiable_motions:
        if one.symbol in symbols:
            value = one.rows(at_deg) @ errors.result.theta[model.slices[one.name]]
            motions[:, symbols.index(one.symbol)] = value
    return motions


def _describe_table(table: RotaryTable | None) -> dict[str, Any] | None:
    if table is None:
        return None
    return {
        "points": len(table.position_deg),
        "spacing_deg": table.spacing_deg,
        "from_deg": float(table.position_deg[0]),
        "to_deg": float(table.position_deg[-1]),
        "repeats_each_turn": table.axis.turns_fully,
    }


def _measure_left(
    errors: ErrorMap,
    axis: RotaryAxis,
    position: Float64[np.ndarray, "n a"],
    added: RotaryAddition | None,
    composed: RotaryTable | None,
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield root mean squares of the angle and of what it does at the tool."""
    if not _has_positioning(errors, axis):
        return
    at_deg = position[:, errors.machine.axis_names.index(axis.name)]
    before = _find_positioning_rad(errors, axis, at_deg)
    after = before
    if added is not None:
        turned = np.radians(added.read(at_deg))
        after = before + find_sense(errors, axis) * turned
    arm = find_arm(
        f"E{axis.name}{axis.name}", make_standstill(errors.machine, position)
    )
    length_mm = np.linalg.norm(arm, axis=1)
    both = {"before": before, "after": after}
    yield "positioning_urad", {k: _URAD * _rms(v) for k, v in both.items()}
    if composed is not None:
        own = composed.motions[:, 3 + TURNS.index(axis.name)]
        period = 360.0 if axis.turns_fully else None
        taken = np.interp(at_deg, composed.position_deg, own, period=period)
        both["after"] = before - taken
    yield "at_tool_um", {k: UM_PER_MM * _rms(length_mm * v) for k, v in both.items()}


def _rms(value: Float64[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(value**2)))


def _list_unwritten(errors: ErrorMap, axis: RotaryAxis) -> Iterator[str]:
    """Yield what the result states of the axis and no table of an axis can have."""
    model = errors.result.model
    own = f"E{axis.name}{axis.name}"
    known = {one.symbol for one in model.identifiable_motions} | set(model.slices)
    for symbol in (*list_error_motions(axis.name), *list_locations(axis.name)):
        if symbol != own and symbol in known:
            yield symbol
