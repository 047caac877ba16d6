"""Tables of a result for a format, and the format's use of them.

They replace those active during the measurement. If the control adds c, a measurement
finds the remaining error d. Tables hold the error, which is minus what is added: the
replacement of the active ones is d − c. E and ω of each axis in c are found by moving
it alone, and one other axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.active_files import ActiveFiles
from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
    RotaryAddition,
    RotaryAxisLocation,
    RotaryTable,
    TemperatureTables,
)
from truepath.compensation.tables.error_map import (
    ErrorMap,
    MeasuredRange,
    compute_measured_ranges,
    map_errors,
    tabulate_axis,
)
from truepath.compensation.tables.rotary import (
    exclude_locations,
    find_locations,
    tabulate_rotary,
)
from truepath.files.earlier.temperature_file import TemperatureModel
from truepath.kinematics.effects.error_motion import reference_position_mm

# What the angle k does at lever l: displacement o, and its sign.
_TURNS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


@dataclass(frozen=True, slots=True)
class StatedTemperature:
    """A temperature model, and the temperature for which files are requested."""

    model: TemperatureModel
    at_degc: float


@dataclass(frozen=True, slots=True)
class Tabulation:
    """Settings that turn errors into the tables of a format.

    stem : of the files' names; stamp : lines for their comments
    spacing_mm : of the rows, or the smallest that the controller's number of rows gives
    measured : range of each axis, and the content of its table beyond
    temperature : where the errors are of a temperature model
    active : files of the control during the measurement, which these replace
    """

    kind: CompensationFormat
    stem: str
    stamp: tuple[str, ...]
    spacing_mm: float
    measured: Mapping[str, MeasuredRange]
    temperature: StatedTemperature | None = None
    active: ActiveFiles | None = None

    def exclude_locations(self, errors: ErrorMap) -> ErrorMap:
        """Errors without the locations of rotary axes that the files contain."""
        stated = self.kind.list_written_locations(
            errors.machine, find_locations(errors)
        )
        return exclude_locations(errors, stated)

    def tabulate(self, errors: ErrorMap) -> CompensationTables:
        """Content of the files, combined with the active ones."""
        found = self.tabulate_found(errors)
        return _combine_tables(found, errors, self.active) if self.active else found

    def tabulate_found(self, errors: ErrorMap) -> CompensationTables:
        """Content of the files from the errors alone, without the active ones."""
        active = self.active and self.kind.read_rotary(
            self.active.texts, errors.machine
        )
        return CompensationTables(
            self.stem,
            errors.machine,
            self._tabulate_axes(self.exclude_locations(errors)),
            self.stamp,
            self.temperature and self._tabulate_change(self.temperature),
            tabulate_rotary(errors, self.kind.most_points, active or ())
            if self.kind.carries_rotary or self.kind.composes_rotary
            else (),
            find_locations(errors),
        )

    def _tabulate_axes(self, errors: ErrorMap) -> tuple[AxisTable, ...]:
        most = self.kind.limit_rows(errors.axes, self.spacing_mm)
        return tuple(
            tabulate_axis(
                errors, self.measured[axis.name], self.spacing_mm, most[axis.name]
            )
            for axis in errors.axes
        )

    def _tabulate_change(self, stated: StatedTemperature) -> TemperatureTables:
        change = map_errors(stated.model.coefficients)
        return TemperatureTables(
            stated.at_degc,
            *stated.model.valid_degc,
            self._tabulate_axes(change),
            stated.model.grows,
        )

    def write(self, errors: ErrorMap) -> dict[str, str]:
        """Files by name."""
        return self.kind.write(self.tabulate(errors))

    def read_back(self, errors: ErrorMap) -> Correction:
        """Addition by the controller once it has read the files.

        Less its addition by active files while the errors were measured.
        """
        return self.subtract(self.kind.read(self.write(errors), errors.machine))

    def subtract(self, correction: Correction) -> Correction:
        """Addition beyond that of the active files."""
        if (active := self.active) is None:
            return correction
        return lambda at, side: correction(at, side) - active.correction(at, side)

    def extrapolate(self, errors: ErrorMap) -> Tabulation:
        """The same, extrapolated by the model where nothing was measured."""
        measured = errors.result.measured
        every = compute_measured_ranges(errors.machine, measured, None)
        return replace(self, measured=every)


def compute_interpolation_losses_mm(
    errors: ErrorMap, tables: tuple[AxisTable, ...]
) -> list[Float64[np.ndarray, "n 3"]]:
    """Error of linear interpolation between rows, along the middle, by axis."""
    lost: list[Float64[np.ndarray, "n 3"]] = []
    for table in tables:
        at = 0.5 * (table.position_mm[1:] + table.position_mm[:-1])
        low, high = errors.result.measured.get(table.axis.name, (-np.inf, np.inf))
        kept = (table.position_mm[:-1] >= low) & (table.position_mm[1:] <= high)
        error = errors.error_mm(errors.move_axis(table.axis, at, errors.middle_mm))
        between = 0.5 * (table.mean_mm[1:] + table.mean_mm[:-1])
        left = (error - between)[kept]
        lost.append(left - left.mean(axis=0) if len(left) else left.reshape(0, 3))
    return [left for left in lost if len(left)]


def _combine_tables(
    content: CompensationTables, errors: ErrorMap, active: ActiveFiles
) -> CompensationTables:
    """The tables plus the active ones, at the same positions."""
    located = active.kind.read_locations(active.texts, errors.machine)
    added = active.kind.read_rotary(active.texts, errors.machine)
    return replace(
        content,
        tables=tuple(_combine_axis(one, errors, active) for one in content.tables),
        rotary=tuple(_combine_rotary(one, added) for one in content.rotary),
        places=tuple(_combine_place(one, located) for one in content.places),
    )


def _combine_axis(table: AxisTable, errors: ErrorMap, active: ActiveFiles) -> AxisTable:
    at_mm, own, zero = table.position_mm, table.own, table.reference

    def find_error(
        rest: Float64[np.ndarray, " a"], side: float, **moved_mm: float
    ) -> Float64[np.ndarray, "n 3"]:
        place = errors.move_axis(table.axis, at_mm, rest)
        for name, value_mm in moved_mm.items():
            place[:, errors.machine.axis_names.index(name)] = value_mm
        return -active.correction(place, side)

    up, down = (find_error(errors.middle_mm, side) for side in (1.0, -1.0))
    mean, half = 0.5 * (up + down), np.zeros_like(up)
    half[:, own] = 0.5 * (up - down)[:, own]
    forward, backward = mean + half, mean - half

    order, rest = errors.machine.order, errors.reference_mm
    lever, omega = np.zeros(3), np.zeros_like(up)
    for other in errors.axes:
        if order.index(other.name) > order.index(table.axis.name):
            out, ends = errors.axes.index(other), (other.low, other.high)
            lever[out] = rest[errors.machine.axis_names.index(other.name)]
            low, high = (find_error(rest, 1.0, **{other.name: end}) for end in ends)
            slope = (high - low) / (other.high - other.low)
            _take_larger(omega, slope - slope[zero], out)
    still = 0.5 * (find_error(rest, 1.0) + find_error(rest, -1.0))
    return replace(
        table,
        forward_mm=table.forward_mm + forward - forward[zero],
        backward_mm=table.backward_mm + backward - forward[zero],
        translation_mm=table.translation_mm
        + (still - still[zero])
        - np.cross(omega, lever),
        rotation_rad=table.rotation_rad + omega,
    )


def _take_larger(
    omega: Float64[np.ndarray, "n 3"], slope: Float64[np.ndarray, "n 3"], lever: int
) -> None:
    """Angles from the slope along a lever.

    A control that lacks a table does half of what an angle would: the larger half.
    """
    for out, k, other in _TURNS:
        for shown, sign, along in ((out, 1.0, other), (other, -1.0, out)):
            if along == lever and slope[:, shown].std() > omega[:, k].std():
                omega[:, k] = sign * slope[:, shown]


def _combine_rotary(
    table: RotaryTable, added: Mapping[str, RotaryAddition]
) -> RotaryTable:
    axis, at_deg = table.axis, table.position_deg
    if axis.name not in added:
        return table
    up, down = (added[axis.name].read(at_deg, side) for side in (1.0, -1.0))
    zero = added[axis.name].read(np.array([reference_position_mm(axis)]))
    return replace(
        table,
        error_deg=table.error_deg - (0.5 * (up + down) - zero),
        half_deg=table.half_deg - 0.5 * (up - down),
    )


def _combine_place(
    place: RotaryAxisLocation, located: Mapping[str, float]
) -> RotaryAxisLocation:
    own = {s: v for s, v in located.items() if s[2] == place.axis.name}
    known = {**dict.fromkeys(own, 0.0), **place.location}
    return replace(place, location={s: v + own.get(s, 0.0) for s, v in known.items()})
