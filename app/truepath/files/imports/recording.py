"""An exported recording as samples, points and temperatures, with how it was read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BadInput, BundleError
from truepath.files.bundle.run import PointRows, RunEvent
from truepath.files.bundle.sensor_gate import gate_columns
from truepath.files.environment.environment import split_columns
from truepath.files.imports.cells import Cells, read_cells
from truepath.files.imports.clock import even_out, read_clock
from truepath.files.imports.columns import (
    Column,
    describe_columns,
    find_column,
    recognise_columns,
    state_unit,
)
from truepath.files.imports.numbers import find_decimal, read_numbers
from truepath.files.imports.options import TextOptions
from truepath.files.imports.point_names import STREAM_ROWS, find_points
from truepath.files.imports.units import LENGTH_MM
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import travel_time_s
from truepath_drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples

NOT_VALID, NO_POSITION = 1, 2  # status of samples that are not to be used
_GOOD = frozenset(("ok", "good", "valid", "true", "yes", "locked", "gut", "gültig"))
_BAD = frozenset(("invalid", "false", "no", "lost", "broken", "error", "ungültig"))
_MOST_RATIO = 5.0  # of extents; an inch is 25.4 mm
_NEAR = 2.0  # of extents: so near only one of the usual units comes
_USUAL_UNITS = ("mm", "m", "inch", "um")
_AWAY = 1e-3  # of the positions: rows that lie there are no place next to the origin
_FEW = 0.01  # of the rows: so many may have come twice
_SHOT_S = 1e-6  # between shots that share a stamp
_MOST_SHOWN = 12
_AXES = re.compile(r"^([+-]?)([xyz])$")
_LONG_GAP_S, _STUCK_ROWS = 10.0, 50
_MOST_NOTES = 3  # of each kind


@dataclass(frozen=True, slots=True)
class Recording:
    """What a file holds, and each decision of its reader in words.

    columns : all of the file, those without a role are left out
    row_of : name of a point in the file to its row, from 1
    """

    samples: TrackerSamples
    points: PointRows | None
    temperature: TemperatureSamples | None
    columns: tuple[Column, ...]
    first_row: tuple[str, ...]
    facts: dict[str, str]
    notes: tuple[str, ...]
    row_of: dict[str, int]
    events: tuple[RunEvent, ...] = ()


def read_recording(
    data: bytes,
    file: str,
    commanded: Commanded,
    options: TextOptions,
    names: Sequence[str] = (),
) -> Recording:
    """Read an exported recording of what was commanded. Raises BundleError.

    names : of the commanded points, if they have any
    """
    cells = read_cells(data, file, options.delimiter)
    columns = recognise_columns(cells, options.columns)
    axes = [_require(cells, columns, role) for role in "xyz"]
    decimal = options.decimal or find_decimal(cells, [c.index for c in axes])
    position = np.stack([read_numbers(cells, c.index, decimal) for c in axes], axis=1)
    status = _read_status(cells, find_column(columns, "status"), options)
    status[~np.isfinite(position).all(axis=1)] = NO_POSITION
    status[lost := _find_origin(position)] = NO_POSITION
    unit, why = _choose_unit(cells, axes, position[status == 0], commanded, options)
    position_mm = LENGTH_MM[unit] * _turn_axes(position, options.axes)
    time_s, clock = _read_times(cells, columns, commanded, options, decimal)
    rows, mapping = find_points(cells, columns, commanded, time_s, names)
    time_s, kept, notes = _order_times(cells, columns, time_s, rows)
    temperature, doubted = _read_temperatures(cells, columns, time_s, kept, decimal)
    samples = TrackerSamples(np.arange(len(time_s)), time_s, position_mm, status)
    samples = samples.select(kept)
    points = None
    if rows is not None:
        samples, points = _average_points(
            samples.select(samples.status == 0), rows[status == 0]
        )
    facts = {"separator": cells.delimiter, "decimals": decimal, "unit": unit + why}
    facts |= {"time": clock, "axes": options.axes, **_count(samples, points)}
    if mapping:
        told = [f"{name} is {row}" for name, row in mapping.items()]
        told = told if len(told) <= _MOST_SHOWN else [*told[:5], "…", told[-1]]
        facts["rows of points"] = ", ".join(told)
    if lost.any():
        notes.append(f"{lost.sum()} rows of 0, 0, 0 are taken for a lost beam")
    if rows is None:
        notes += _note_oddities(np.asarray(cells.row_of)[kept], samples)
    return Recording(
        samples,
        points,
        temperature,
        tuple(columns),
        tuple(column[0] for column in cells.columns),
        facts,
        (*cells.notes, *notes, *(event.text for event in doubted)),
        mapping,
        doubted,
    )


def _find_origin(position: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which rows are 0, 0, 0 while the last ones before them are elsewhere."""
    origin = (position == 0.0).all(axis=1)
    known = np.flatnonzero(~origin & np.isfinite(position).all(axis=1))
    if origin.any() and len(known):
        size = np.linalg.norm(position[known], axis=1)
        before = np.searchsorted(known, np.flatnonzero(origin)) - 1
        origin[origin] = size[np.maximum(before, 0)] > _AWAY * size.max()
    return origin


def _order_times(
    cells: Cells,
    columns: list[Column],
    time_s: NDArray[np.float64],
    rows: NDArray[np.int64] | None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[str]]:
    """Return times that increase, which rows are kept, and notes.

    A row of a stream that is the one before once more came twice and is left out; not
    where many share a stamp: there they differ in nothing else at a standstill.
    """
    kept, notes = np.ones(len(cells), bool), list[str]()
    if rows is None:
        tied = (np.flatnonzero(np.diff(time_s) == 0) + 1).tolist()
        if len(tied) <= _FEW * len(kept):
            again = [k for k in tied if all(c[k] == c[k - 1] for c in cells.columns)]
            if again:
                kept[again] = False
                notes.append(f"{len(again)} rows that repeat the one before left out")
        time_s = time_s.copy()
        time_s[kept], words = even_out(time_s[kept])
        notes += [words] if words else []
    else:  # shots within one second
        time_s = time_s + _SHOT_S * np.arange(len(time_s))
    inside = np.flatnonzero(kept)
    back = np.diff(time_s[inside]) <= 0
    if back.any():
        row = int(inside[int(np.argmax(back)) + 1])
        time = _require(cells, columns, "time")
        raise cells.error(
            f"does not increase after {cells.columns[time.index][row - 1]}, "
            "and rows do not come evenly",
            row,
            time.index,
            "export times with more digits, or say --rate HZ if no row is missing",
        )
    return time_s, kept, notes


def _require(cells: Cells, columns: list[Column], role: str) -> Column:
    if found := find_column(columns, role):
        return found
    remedy = f"say --column {role}=NUMBER"
    remedy += ", or --rate HZ if rows come evenly" if role == "time" else ""
    raise BundleError(
        f"has no column recognised as {role}",
        file=cells.file,
        remedy=f"{remedy}; the file has {describe_columns(cells, columns)[:200]}",
    )


def _read_status(
    cells: Cells, column: Column | None, options: TextOptions
) -> NDArray[np.int64]:
    if column is None:
        return np.zeros(len(cells), np.int64)
    words = [word.casefold() for word in cells.columns[column.index]]
    known = set(words)
    valid = {word.casefold() for word in options.valid}
    if not valid and known <= _GOOD | _BAD:
        valid = _GOOD
    good = np.array([word in valid for word in words])
    if good.any():
        return np.where(good, 0, NOT_VALID)
    why = "none is valid" if valid else "which are valid is not known"
    raise BundleError(
        f"holds {', '.join(sorted(known))[:80]}: {why}",
        file=cells.file,
        column=column.name,
        remedy="say --valid VALUE, once for each",
    )


def _choose_unit(
    cells: Cells,
    axes: list[Column],
    position: NDArray[np.float64],
    commanded: Commanded,
    options: TextOptions,
) -> tuple[str, str]:
    """Return the unit of positions, and why, if the file does not state it."""
    if not len(position):
        raise BundleError("holds no position", file=cells.file, remedy="record again")
    is_linear = [name in "XYZ" for name in commanded.axes]
    aim = _measure_extent(commanded.position[:, is_linear])
    extent = _measure_extent(position)
    size = {unit: factor * extent for unit, factor in LENGTH_MM.items()}
    fitting = [u for u in _USUAL_UNITS if aim / _NEAR < size[u] < aim * _NEAR]
    stated = {options.unit}
    if not options.unit:
        stated = {state_unit(cells), *(c.unit for c in axes)} - {""}
    remedy = "say --unit mm, m or inch"
    if len(stated) > 1:
        problem = f"states more than one unit of positions: {', '.join(sorted(stated))}"
    elif stated and stated <= LENGTH_MM.keys():
        unit = stated.pop()
        if not aim or aim / _MOST_RATIO < size[unit] < aim * _MOST_RATIO:
            return unit, ""
        problem = f"positions extend over {size[unit]:.4g} mm as {unit}, "
        problem += f"what was commanded over {aim:.4g} mm"
        if fitting:
            times = LENGTH_MM[fitting[0]] / LENGTH_MM[unit]
            problem += f"; {times:g} times as much fits: they look like {fitting[0]}"
        remedy = "correct --unit, or give the path that was driven"
    elif len(fitting) == 1:
        shown = f"{size[fitting[0]]:.4g} mm of {aim:.4g} commanded"
        return fitting[0], f": {shown}, no other fits"
    else:
        told = ", ".join(f"{u}: {size[u]:.4g} mm" for u in _USUAL_UNITS)
        problem = f"states no unit of positions; their extent is {told}, "
        problem += f"the commanded one {aim:.4g} mm"
    raise BundleError(problem, file=cells.file, remedy=remedy)


def _turn_axes(position: NDArray[np.float64], axes: str) -> NDArray[np.float64]:
    words = [_AXES.match(word.strip().lower()) for word in axes.split(",")]
    found = [word.groups() for word in words if word]
    if len(words) != 3 or sorted(name for _, name in found) != ["x", "y", "z"]:
        raise BadInput(f"--axes {axes}: write each of x, y, z once, as in x,-y,z")
    signs = np.array([-1.0 if sign == "-" else 1.0 for sign, _ in found])
    return signs * position[:, ["xyz".index(name) for _, name in found]]


def _measure_extent(position: NDArray[np.float64]) -> float:
    """Return twice the distance from the mean that few positions exceed."""
    away = np.linalg.norm(position - np.median(position, axis=0), axis=1)
    return float(2.0 * np.percentile(away, 95)) if len(away) else 0.0


def _read_times(
    cells: Cells,
    columns: list[Column],
    commanded: Commanded,
    options: TextOptions,
    decimal: str,
) -> tuple[NDArray[np.float64], str]:
    rows = len(cells)
    if options.rate_hz is not None:
        return np.arange(rows) / options.rate_hz, f"{options.rate_hz:g} rows a second"
    are_few = rows < STREAM_ROWS * len(commanded)
    is_path = isinstance(commanded, Path)
    if are_few and not is_path and find_column(columns, "time") is None:
        return np.arange(rows, dtype=float), "none; points in order"
    time, date = _require(cells, columns, "time"), find_column(columns, "date")
    least_s = travel_time_s(commanded) if is_path else float(commanded.dwell_s.sum())
    return read_clock(cells, time, date, options, decimal, least_s)


def _average_points(
    samples: TrackerSamples, row: NDArray[np.int64]
) -> tuple[TrackerSamples, PointRows]:
    starts = np.flatnonzero(np.append(True, np.diff(row) != 0))
    count = np.diff(np.append(starts, len(row)))
    stay = np.repeat(np.arange(len(starts)), count)
    mean_mm = np.add.reduceat(samples.position_mm, starts) / count[:, None]
    away = samples.position_mm - mean_mm[stay]
    squares = np.add.reduceat(np.einsum("ni,nj->nij", away, away), starts)
    covariance_mm2 = squares / np.maximum(count - 1, 1)[:, None, None]
    time_s = np.add.reduceat(samples.device_time_s, starts) / count
    means = TrackerSamples(
        np.arange(len(starts)), time_s, mean_mm, np.zeros(len(starts), np.int64)
    )
    return means, PointRows(row[starts], count, covariance_mm2)


def _read_temperatures(
    cells: Cells,
    columns: list[Column],
    time_s: NDArray[np.float64],
    kept: NDArray[np.bool_],
    usual: str,
) -> tuple[TemperatureSamples | None, tuple[RunEvent, ...]]:
    """Return the rows at which a temperature changes, the first and the last.

    What is not believed is NaN, and reported.
    """
    sensors = [column for column in columns if column.role.endswith("_degC")]
    if not sensors:
        return None, ()
    decimal = find_decimal(cells, [column.index for column in sensors], usual)
    celsius = np.stack([read_numbers(cells, c.index, decimal) for c in sensors], axis=1)
    fahrenheit = [column.unit == "degF" for column in sensors]
    celsius[:, fahrenheit] = (celsius[:, fahrenheit] - 32.0) / 1.8
    keep = kept & np.isfinite(celsius).all(axis=1)
    time_s, celsius = time_s[keep], celsius[keep]
    if not len(time_s):
        return None, ()
    change = np.append(True, (np.diff(celsius, axis=0) != 0).any(axis=1))
    change[-1] = True
    columns_degc = {c.role: v for c, v in zip(sensors, celsius[change].T, strict=True)}
    believed, doubted = gate_columns(time_s[change], columns_degc, None)
    return split_columns(time_s[change], believed)[0], doubted


def _count(samples: TrackerSamples, points: PointRows | None) -> dict[str, str]:
    if points is not None:
        return {"points": f"{len(points.row)} of {points.count.sum()} shots"}
    step = np.diff(samples.device_time_s)
    usual = float(np.median(step)) if len(step) else 1.0
    lost = int(np.maximum(np.rint(step / usual) - 1, 0).sum())
    valid = int((samples.status == 0).sum())
    return {
        "samples": f"{len(samples)}, {valid} valid, {lost} missing by their times",
        "rate": f"{1 / usual:.4g} Hz for {step.sum():.1f} s",
    }


def _note_oddities(row_of: NDArray[np.int64], samples: TrackerSamples) -> list[str]:
    notes: list[str] = []
    gap_s = np.diff(samples.device_time_s)
    for k in np.flatnonzero(gap_s > _LONG_GAP_S)[:_MOST_NOTES].tolist():
        notes.append(f"a gap of {gap_s[k]:.6g} s before row {row_of[k + 1]}")
    same = (np.diff(samples.position_mm, axis=0) == 0.0).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.view(np.int8), [0]])))
    for first, last in edges.reshape(-1, 2).tolist():
        if last - first >= _STUCK_ROWS and len(notes) < 2 * _MOST_NOTES:
            rows = f"{row_of[first]} to {row_of[last]}"
            notes.append(f"rows {rows} repeat one position: was the beam lost?")
    return notes
