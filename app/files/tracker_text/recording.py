"""An exported recording as samples, points and temperatures, with how it was read."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truepath.app.errors import BadInput, BundleError
from truepath.app.files.environment import split_columns
from truepath.app.files.run import PointRows, RunEvent
from truepath.app.files.sensor_gate import gate_columns
from truepath.app.files.tracker_text.cells import Cells, read_cells
from truepath.app.files.tracker_text.clock import read_clock
from truepath.app.files.tracker_text.columns import (
    LENGTH_MM,
    Column,
    recognise_columns,
    state_unit,
)
from truepath.app.files.tracker_text.numbers import find_decimal, read_numbers
from truepath.app.files.tracker_text.oddities import note_oddities
from truepath.app.files.tracker_text.options import TextOptions
from truepath.app.motion.configurations import Commanded, Configurations
from truepath.drivers.interfaces.records import TemperatureSamples, TrackerSamples

NOT_VALID, NO_POSITION = 1, 2  # status of samples that are not to be used
_GOOD = frozenset(("ok", "good", "valid", "true", "yes", "locked", "gut", "gültig"))
_BAD = frozenset(("invalid", "false", "no", "lost", "broken", "error", "ungültig"))
_MOST_RATIO = 5.0  # of extents; an inch is 25.4 mm
_STREAM_ROWS = 10  # a point; fewer rows are no stream
_AXES = re.compile(r"^([+-]?)([xyz])$")


@dataclass(frozen=True, slots=True)
class Recording:
    """What a file holds, and each decision of its reader in words.

    columns : all of the file, those without a role are left out
    """

    samples: TrackerSamples
    points: PointRows | None
    temperature: TemperatureSamples | None
    columns: tuple[Column, ...]
    first_row: tuple[str, ...]
    facts: dict[str, str]
    notes: tuple[str, ...]
    events: tuple[RunEvent, ...] = ()


def read_recording(
    data: bytes, file: str, commanded: Commanded, options: TextOptions
) -> Recording:
    """Read an exported recording of what was commanded. Raises BundleError."""
    cells = read_cells(data, file, options.delimiter)
    cells, repeats = _drop_repeats(cells)
    columns = recognise_columns(cells, options.columns)
    by_role = {column.role: column for column in columns if column.role}
    axes = [_require(cells, by_role, role) for role in "xyz"]
    decimal = options.decimal or find_decimal(cells, [c.index for c in axes])
    position = np.stack([read_numbers(cells, c.index, decimal) for c in axes], axis=1)
    status = _read_status(cells, by_role.get("status"), options)
    status[np.isnan(position).any(axis=1)] = NO_POSITION
    unit = _choose_unit(cells, axes, position[status == 0], commanded, options)
    position_mm = LENGTH_MM[unit] * _turn_axes(position, options.axes)
    _refuse_wrong_size(cells, position_mm[status == 0], commanded, unit)
    time_s, clock = _read_times(cells, by_role, commanded, options)
    temperature, doubted = _read_temperatures(cells, columns, time_s)
    samples = TrackerSamples(np.arange(len(time_s)), time_s, position_mm, status)
    rows = _find_points(cells, columns, commanded, time_s)
    points = None
    if rows is not None:
        samples, points = _average_points(
            samples.select(status == 0), rows[status == 0]
        )
    facts = {"separator": cells.delimiter, "decimals": decimal, "unit": unit}
    facts |= {"time": clock, "axes": options.axes, **_count(samples, points)}
    return Recording(
        samples,
        points,
        temperature,
        tuple(columns),
        cells.rows[0],
        facts,
        (
            *cells.notes,
            *repeats,
            *(event.text for event in doubted),
            *(note_oddities(cells, samples) if rows is None else ()),
        ),
        doubted,
    )


def _drop_repeats(cells: Cells) -> tuple[Cells, tuple[str, ...]]:
    """Leave out rows that are the row before once more: a sample that came twice."""
    rows = cells.rows
    kept = [k for k in range(len(rows)) if k == 0 or rows[k] != rows[k - 1]]
    if len(kept) == len(rows):
        return cells, ()
    unique = tuple(rows[k] for k in kept), tuple(cells.row_of[k] for k in kept)
    note = f"{len(rows) - len(kept)} rows that repeat the one before left out"
    return replace(cells, rows=unique[0], row_of=unique[1]), (note,)


def _require(cells: Cells, by_role: dict[str, Column], role: str) -> Column:
    if role in by_role:
        return by_role[role]
    found = ", ".join(cells.names) or f"{len(cells.rows[0])} columns without names"
    raise BundleError(
        f"has no column recognised as {role}",
        file=cells.file,
        remedy=f"say --column {role}=NUMBER; the file has {found[:160]}",
    )


def _read_status(
    cells: Cells, column: Column | None, options: TextOptions
) -> NDArray[np.int64]:
    if column is None:
        return np.zeros(len(cells.rows), np.int64)
    words = cells.column(column.index)
    known = {word.casefold() for word in words}
    if options.valid:
        valid = {word.casefold() for word in options.valid}
    elif known <= _GOOD | _BAD:
        valid = _GOOD
    else:
        raise BundleError(
            f"holds {', '.join(sorted(known))[:80]}: which are valid is not known",
            file=cells.file,
            column=column.name,
            remedy="say --valid VALUE, once for each",
        )
    good = np.array([word.casefold() in valid for word in words])
    if not good.any():
        raise BundleError(
            f"holds no valid sample, only {', '.join(sorted(known))[:80]}",
            file=cells.file,
            column=column.name,
            remedy="say --valid VALUE, once for each",
        )
    return np.where(good, 0, NOT_VALID)


def _choose_unit(
    cells: Cells,
    axes: list[Column],
    position: NDArray[np.float64],
    commanded: Commanded,
    options: TextOptions,
) -> str:
    if options.unit:
        return options.unit
    stated = {column.unit for column in axes if column.unit}
    above = state_unit(cells)
    stated |= {above} if above else set()
    if len(stated) > 1:
        problem = f"states more than one unit of positions: {', '.join(sorted(stated))}"
    elif stated and stated <= LENGTH_MM.keys():
        return stated.pop()
    else:
        extent = _measure_extent(position)
        told = ", ".join(f"{u}: {f * extent:.4g} mm" for u, f in LENGTH_MM.items())
        aim = _measure_extent(_linear(commanded))
        problem = (
            f"states no unit of positions; their extent is {told}, "
            f"the commanded one {aim:.4g} mm"
        )
    remedy = "say --unit mm, m or inch"
    raise BundleError(problem, file=cells.file, remedy=remedy)


def _turn_axes(position: NDArray[np.float64], axes: str) -> NDArray[np.float64]:
    words = [_AXES.match(word.strip().lower()) for word in axes.split(",")]
    found = [word.groups() for word in words if word]
    if len(words) != 3 or sorted(name for _, name in found) != ["x", "y", "z"]:
        raise BadInput(f"--axes {axes}: write each of x, y, z once, as in x,-y,z")
    signs = np.array([-1.0 if sign == "-" else 1.0 for sign, _ in found])
    return signs * position[:, ["xyz".index(name) for _, name in found]]


def _linear(commanded: Commanded) -> NDArray[np.float64]:
    return commanded.position[:, [name in "XYZ" for name in commanded.axes]]


def _measure_extent(position: NDArray[np.float64]) -> float:
    """Return twice the distance from the mean that few positions exceed."""
    away = np.linalg.norm(position - np.median(position, axis=0), axis=1)
    return float(2.0 * np.percentile(away, 95)) if len(away) else 0.0


def _refuse_wrong_size(
    cells: Cells, position_mm: NDArray[np.float64], commanded: Commanded, unit: str
) -> None:
    if len(position_mm) == 0:
        raise BundleError("holds no position", file=cells.file, remedy="record again")
    extent, aim = _measure_extent(position_mm), _measure_extent(_linear(commanded))
    if aim and not aim / _MOST_RATIO < extent < aim * _MOST_RATIO:
        raise BundleError(
            f"positions extend over {extent:.4g} mm as {unit}, "
            f"what was commanded over {aim:.4g} mm",
            file=cells.file,
            remedy="correct --unit, or give the path that was driven",
        )


def _read_times(
    cells: Cells, by_role: dict[str, Column], commanded: Commanded, options: TextOptions
) -> tuple[NDArray[np.float64], str]:
    rows = len(cells.rows)
    if options.rate_hz is not None:
        return np.arange(rows) / options.rate_hz, f"{options.rate_hz:g} rows a second"
    are_few = rows < _STREAM_ROWS * len(commanded)
    if "time" not in by_role and isinstance(commanded, Configurations) and are_few:
        return np.arange(rows, dtype=float), "none; points in order"
    time = _require(cells, by_role, "time")
    time_s, how = read_clock(cells, time, by_role.get("date"), options)
    back = np.append(False, np.diff(time_s) <= 0)
    if back.any():
        row = int(np.argmax(back))
        raise cells.error(
            f"does not increase after {cells.rows[row - 1][time.index]}",
            row,
            time.index,
            "export times with more digits, or say --rate HZ if no row is missing",
        )
    return time_s, how


def _find_points(
    cells: Cells,
    columns: list[Column],
    commanded: Commanded,
    time_s: NDArray[np.float64],
) -> NDArray[np.int64] | None:
    """Return the commanded point of each row; None for a stream."""
    if not isinstance(commanded, Configurations):
        return None
    rows, points = len(cells.rows), len(commanded)
    named = [c for c in columns if c.role == "point"]
    numbers = [n for c in named if (n := _number_points(cells, c, points)) is not None]
    if len({tuple(n) for n in numbers}) > 1:
        raise BundleError(
            f"numbers points in {', '.join(c.name for c in named)}, differently",
            file=cells.file,
            remedy="choose one by --column point=NUMBER",
        )
    if numbers:
        return numbers[0]
    if rows == points:
        return np.arange(points)
    if rows >= _STREAM_ROWS * points and np.median(np.diff(time_s)) < 1.0:
        return None
    raise BundleError(
        f"has {rows} rows for {points} points and no column that numbers them",
        file=cells.file,
        remedy="say --column point=NUMBER; names end in the row of points.csv, from 1",
    )


def _number_points(
    cells: Cells, column: Column, points: int
) -> NDArray[np.int64] | None:
    """Return the numbers in which names end; None where they count rows or nothing."""
    found = [re.search(r"(\d+)\D*$", text) for text in cells.column(column.index)]
    if not all(found):
        return None
    number = np.array([int(match.group(1)) for match in found if match])
    if len(number) != points and (np.diff(number) == 1).all():
        return None
    bad = (number < 1) | (number > points)
    if bad.any():
        row = int(np.argmax(bad))
        shown = f"is {cells.rows[row][column.index]!r}, no point of {points}"
        remedy = "names end in the row of points.csv, from 1"
        raise cells.error(shown, row, column.index, remedy)
    return number - 1


def _average_points(
    samples: TrackerSamples, row: NDArray[np.int64]
) -> tuple[TrackerSamples, PointRows]:
    """Return the mean of each stay at a point."""
    starts = np.flatnonzero(np.append(True, np.diff(row) != 0))
    count = np.diff(np.append(starts, len(row)))
    stay = np.repeat(np.arange(len(starts)), count)
    mean_mm = np.add.reduceat(samples.position_mm, starts) / count[:, None]
    away = samples.position_mm - mean_mm[stay]
    squares = np.add.reduceat(np.einsum("ni,nj->nij", away, away), starts)
    covariance_mm2 = squares / np.maximum(count - 1, 1)[:, None, None]
    means = samples.select(starts)
    time_s = np.add.reduceat(samples.device_time_s, starts) / count
    means = TrackerSamples(
        np.arange(len(starts)), time_s, mean_mm, np.zeros(len(starts), np.int64)
    )
    return means, PointRows(row[starts], count, covariance_mm2)


def _read_temperatures(
    cells: Cells, columns: list[Column], time_s: NDArray[np.float64]
) -> tuple[TemperatureSamples | None, tuple[RunEvent, ...]]:
    """Return the rows at which a temperature changes, the first and the last.

    What is not believed is NaN, and told.
    """
    sensors = [column for column in columns if column.role.endswith("_degC")]
    if not sensors:
        return None, ()
    decimal = find_decimal(cells, [column.index for column in sensors])
    celsius = np.stack([read_numbers(cells, c.index, decimal) for c in sensors], axis=1)
    fahrenheit = [column.unit == "degF" for column in sensors]
    celsius[:, fahrenheit] = (celsius[:, fahrenheit] - 32.0) / 1.8
    keep = np.isfinite(celsius).all(axis=1) & np.append(True, np.diff(time_s) > 0)
    time_s, celsius = time_s[keep], celsius[keep]
    if not len(time_s):
        return None, ()
    change = np.append(True, (np.diff(celsius, axis=0) != 0).any(axis=1))
    change[-1] = True
    columns_degc = {c.role: v for c, v in zip(sensors, celsius[change].T, strict=True)}
    kept, doubted = gate_columns(time_s[change], columns_degc, None)
    return split_columns(time_s[change], kept)[0], doubted


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
