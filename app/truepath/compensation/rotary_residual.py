"""Remaining errors of each rotary axis, and of all axes together, with the files.

Root mean squares over the travel. Before is the map of the result, after what remains
of it with the files; expected after is what remains of errors that the measurement
allows, sampled from its covariance, as in the account of linear axes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    CompensationFormat,
    CompensationTables,
    Correction,
    Files,
    RotaryAddition,
    RotaryTable,
)
from truepath.compensation.residual_error import (
    COVERAGE,
    SIDES,
    ResidualError,
    expect_length,
    find_scale,
    remove_common_rigid_motion,
    sample_errors_mm,
)
from truepath.compensation.tables.error_map import ErrorMap, find_own_arm
from truepath.compensation.tables.rotary import (
    clip_to_measured,
    compute_positioning_rad,
    find_locations,
    find_sense,
    has_positioning,
)
from truepath.files.units import UM_PER_MM, URAD_PER_RAD
from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.effects.error_motion import list_axis_locations
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.symbols import (
    TURNS,
    list_error_motions,
    list_locations,
)
from truepath.results.volumetric_error import sample_parameters, sample_travel_evenly

NOT_STATED = "not in the result"
_IN_FILES = "in the files: both directions of the table"
_LEFT = "left by the files: they have no directions of this axis"
_PLACES = 512  # all over the travel of all axes
_SEED = 2  # of lost motion, which is sampled separately


@dataclass(frozen=True)
class RotaryFiles:
    """Rotary axes in files, read back as the control does.

    tables : as they were written; added : to rotary axes, by axis
    located : location by symbol in the control, mm and rad
    is_composed : the control corrects the tool by its linear axes alone: the angle
        stays
    """

    tables: tuple[RotaryTable, ...] = ()
    added: Mapping[str, RotaryAddition] = field(default_factory=dict[str, Any])
    located: Mapping[str, float] = field(default_factory=dict[str, float])
    is_composed: bool = False


def read_rotary_files(
    kind: CompensationFormat, content: CompensationTables, files: Files
) -> RotaryFiles:
    """The control's reading of its files. Raises BadInput."""
    return RotaryFiles(
        content.rotary,
        kind.read_rotary(files, content.machine),
        kind.read_locations(files, content.machine),
        kind.composes_rotary,
    )


def describe_rotary(errors: ErrorMap, files: RotaryFiles) -> dict[str, Any]:
    """Remaining errors by axis, and symbols that no file contains.

    An unknown positioning or location is left out; unknown lost motion is reported.
    """
    sample = _Sample(errors)
    rows = {table.axis.name: table for table in files.tables}
    return {
        axis.name: {
            "table": _describe_table(rows.get(axis.name), files.added.get(axis.name)),
            **dict(_measure_positioning(sample, axis, files, rows.get(axis.name))),
            **_measure_lost_motion(sample, axis, files.added.get(axis.name)),
            **dict(_measure_location(sample, axis, files.located)),
            "not_in_files": [
                one
                for one in _list_missing(errors, axis)
                if one not in files.located
                and not (files.is_composed and one[0] == "E")
            ],
        }
        for axis in errors.machine.rotary_axes
    }


def _sample_half_turns_rad(
    errors: ErrorMap, axis: RotaryAxis, at_deg: Float64[np.ndarray, " n"], draws: int
) -> Float64[np.ndarray, "n d"]:
    # Sampled errors of half the lost motion of an axis
    sigma = errors.half_difference_sigma(axis.name, at_deg)
    rng = np.random.default_rng([_SEED, TURNS.index(axis.name)])
    return np.outer(sigma, rng.standard_normal(draws))


@dataclass(frozen=True)
class _Sample:
    errors: ErrorMap

    @cached_property
    def position(self) -> Float64[np.ndarray, "n a"]:
        return sample_travel_evenly(self.errors.machine.axes, _PLACES)

    @cached_property
    def at(self) -> Conditions:
        return make_standstill(self.errors.machine, self.position)

    @cached_property
    def drawn(self) -> Float64[np.ndarray, "p d"]:
        return sample_parameters(self.errors.result.covariance)

    def read(self, axis: RotaryAxis) -> Float64[np.ndarray, " n"]:
        return self.position[:, self.errors.machine.axis_names.index(axis.name)]

    def sample_positioning(self, axis: RotaryAxis) -> Float64[np.ndarray, "n d"]:
        model, own = self.errors.result.model, f"E{axis.name}{axis.name}"
        (motion,) = (one for one in model.identifiable_motions if one.symbol == own)
        at_deg = clip_to_measured(self.errors, axis, self.read(axis))
        return motion.rows(at_deg) @ self.drawn[model.slices[motion.name]]

    def state(
        self,
        before: Float64[np.ndarray, "n k"],
        after: Float64[np.ndarray, "n k"],
        drawn: Float64[np.ndarray, "n k d"],
        scale: float,
    ) -> dict[str, float]:
        """Root mean squares of lengths over n positions, in a unit of `scale`."""
        of_map = scale * float(_rms(after[:, :, None])[0])
        each = scale * _rms(after[:, :, None] + drawn)
        expected, sigma = expect_length(each, of_map, find_scale(self.errors.result))
        return {
            "before": scale * float(_rms(before[:, :, None])[0]),
            "after": of_map,
            "after_expected": expected,
            "after_expanded_uncertainty": COVERAGE * sigma,
        }


def _rms(value: Float64[np.ndarray, "n k d"]) -> Float64[np.ndarray, " d"]:
    return np.sqrt((value**2).sum(axis=1).mean(axis=0))


def _describe_table(
    table: RotaryTable | None, added: RotaryAddition | None
) -> dict[str, Any] | None:
    if table is None:
        return None
    at = table.position_deg if added is None else added.position_deg
    repeats = table.axis.turns_fully if added is None else added.period_deg > 0.0
    return {
        "points": len(at),
        "spacing_deg": float(at[1] - at[0]),
        "from_deg": float(at[0]),
        "to_deg": float(at[-1]),
        "repeats_each_turn": repeats,
    }


def _measure_positioning(
    sample: _Sample, axis: RotaryAxis, files: RotaryFiles, table: RotaryTable | None
) -> Iterator[tuple[str, dict[str, float]]]:
    errors = sample.errors
    if not has_positioning(errors, axis):
        return
    at_deg = sample.read(axis)
    before = compute_positioning_rad(errors, axis, at_deg)
    after, added = before, files.added.get(axis.name)
    if added is not None:
        after = before + find_sense(errors, axis) * np.radians(added.read(at_deg))
    drawn = sample.sample_positioning(axis)
    columns = before[:, None], after[:, None], drawn[:, None]
    yield "positioning_urad", sample.state(*columns, URAD_PER_RAD)
    if table is not None and files.is_composed:
        own = table.motions[:, 3 + TURNS.index(axis.name)]
        period = 360.0 if axis.turns_fully else None
        after = before - np.interp(at_deg, table.position_deg, own, period=period)
    arm = find_own_arm(axis, sample.at)
    moved = (
        arm * before[:, None],
        arm * after[:, None],
        arm[:, :, None] * drawn[:, None],
    )
    yield "at_tool_um", sample.state(*moved, UM_PER_MM)


def _measure_lost_motion(
    sample: _Sample, axis: RotaryAxis, added: RotaryAddition | None
) -> dict[str, Any]:
    errors = sample.errors
    if f"E{axis.name}{axis.name}" not in errors.result.halves:
        return {"lost_motion": NOT_STATED, "lost_motion_urad": None}
    at_deg = clip_to_measured(errors, axis, sample.read(axis))
    half = errors.half_difference(axis.name, at_deg)
    after, is_written = half, added is not None and added.half_deg is not None
    if added is not None:
        both = [added.read(sample.read(axis), side) for side in (1.0, -1.0)]
        turned = np.radians(both[0] - both[1])
        after = half + find_sense(errors, axis) * 0.5 * turned
    draws = sample.drawn.shape[1]
    drawn = _sample_half_turns_rad(errors, axis, at_deg, draws)
    columns = half[:, None], after[:, None], drawn[:, None]
    return {
        "lost_motion": _IN_FILES if is_written else _LEFT,
        "lost_motion_urad": sample.state(*columns, 2.0 * URAD_PER_RAD),
    }


def _measure_location(
    sample: _Sample, axis: RotaryAxis, read: Mapping[str, float]
) -> Iterator[tuple[str, dict[str, float]]]:
    """Effect of an axis' location at the tool.

    read : location by symbol (mm, rad) in the control, from the files
    """
    slices = sample.errors.result.model.slices
    (place,) = (p for p in find_locations(sample.errors) if p.axis.name == axis.name)
    if not place.location:
        return
    before, after = np.zeros((2, len(sample.at), 3))
    drawn = np.zeros((*before.shape, sample.drawn.shape[1]))
    for one in list_axis_locations(axis):
        if one.symbol in place.location:
            column = one.jacobian(sample.at)[:, :, 0]
            value = place.location[one.symbol]
            before += column * value
            after += column * (value - read.get(one.symbol, 0.0))
            drawn += column[:, :, None] * sample.drawn[slices[one.symbol]][0]
    yield "location_at_tool_um", sample.state(before, after, drawn, UM_PER_MM)


def _list_missing(errors: ErrorMap, axis: RotaryAxis) -> Iterator[str]:
    model = errors.result.model
    own = f"E{axis.name}{axis.name}"
    known = {one.symbol for one in model.identifiable_motions} | set(model.slices)
    for symbol in (*list_error_motions(axis.name), *list_locations(axis.name)):
        if symbol != own and symbol in known:
            yield symbol


def measure_over_axes(
    errors: ErrorMap, correction: Correction, files: RotaryFiles
) -> dict[str, Any] | None:
    """Mean length of the error over all axes, µm; None for a machine of linear axes.

    correction : added by the control to linear axes; files : of rotary axes

    Before and after are of the map; expected after is of errors that the measurement
    allows, as in the account of linear axes.
    """
    if not errors.machine.rotary_axes:
        return None
    at = _Sample(errors).at
    error = np.stack([_compute_error_mm(errors, at, side) for side in SIDES])
    moved = np.stack(
        [_compute_motion_mm(errors, at, correction, files, side) for side in SIDES]
    )
    drawn = _sample_errors_mm(errors, at)
    before, after = (
        _remove_rigid(at, left, drawn, find_scale(errors.result))
        for left in (error, error + moved)
    )
    expected = after.summarise() or {}
    return {
        "before": before.summarise_map()["mean"],
        "before_expanded_uncertainty": COVERAGE * before.compute_map_uncertainty_um(),
        "after": after.summarise_map()["mean"],
        "after_expected": expected["mean"],
        "after_expanded_uncertainty": COVERAGE * expected["mean_uncertainty"],
        "coverage_factor": COVERAGE,
        "on": f"mean length over {len(at)} positions that fill the travel of all axes "
        "evenly, up and down, without rigid motion of the workpiece; expected after: "
        "of errors that the measurement allows, drawn from its covariance",
    }


def _compute_error_mm(
    errors: ErrorMap, at: Conditions, side: float
) -> Float64[np.ndarray, "n 3"]:
    error = errors.error_mm(at.position_mm, side)
    for axis in errors.machine.rotary_axes:
        at_deg = at.position_mm[:, errors.machine.axis_names.index(axis.name)]
        half = side * errors.half_difference(axis.name, at_deg)
        error += half[:, None] * find_own_arm(axis, at)
    return error


def _compute_motion_mm(
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


def _sample_errors_mm(
    errors: ErrorMap, at: Conditions
) -> Float64[np.ndarray, "s n 3 d"]:
    drawn = sample_errors_mm(errors, at.position_mm)
    for axis in errors.machine.rotary_axes:
        at_deg = at.position_mm[:, errors.machine.axis_names.index(axis.name)]
        half = _sample_half_turns_rad(errors, axis, at_deg, drawn.shape[3])
        moved = find_own_arm(axis, at)[:, :, None] * half[:, None]
        for number, side in enumerate(SIDES):
            drawn[number] += side * moved
    return drawn


def _remove_rigid(
    at: Conditions,
    left_mm: Float64[np.ndarray, "s n 3"],
    drawn_mm: Float64[np.ndarray, "s n 3 d"],
    scale: float,
) -> ResidualError:
    weight, point_mm = np.full(len(at), 1.0 / len(at)), at.chain.point_mm
    return ResidualError(
        point_mm,
        remove_common_rigid_motion(point_mm, list(left_mm), weight),
        remove_common_rigid_motion(point_mm, list(drawn_mm), weight),
        np.ones(len(at), bool),
        weight,
        scale,
    )
