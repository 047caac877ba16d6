"""An exported recording as samples, points and temperatures, with how it was read."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BadInput, BundleError
from truepath.files.bundle.run import PointRows, RunEvent
from truepath.files.bundle.sensor_gate import gate_columns
from truepath.files.environment import split_columns
from truepath.files.imports.cells import (
    LENGTH_MM,
    Cells,
    find_decimal,
    read_cells,
    read_numbers,
)
from truepath.files.imports.clock import EvenTimes, even_out, read_clock
from truepath.files.imports.columns import (
    Column,
    TextOptions,
    describe_columns,
    find_column,
    recognise_columns,
    state_rate,
    state_unit,
)
from truepath.files.imports.point_names import (
    STREAM_ROWS,
    LocateShots,
    Shots,
    find_points,
)
from truepath.motion.configurations import Commanded, Configurations
from truepath.motion.motion_times import travel_time_s
from truepath_drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples

NOT_VALID, NO_POSITION = 1, 2  # status of samples that are not to be used
_GOOD = frozenset(("ok", "good", "valid", "true", "yes", "locked", "gut", "gültig"))
_BAD = frozenset(("invalid", "false", "no", "lost", "broken", "error", "ungültig"))
_MOST_RATIO = 5.0  # of extents; an inch is 25.4 mm
_NEAR = 2.0  # of extents: only one of the usual units comes so near
_USUAL_UNITS = ("mm", "m", "inch", "um")
_AWAY = 1e-3  # of the positions: rows that lie there are no place next to the origin
_FEW = 0.01  # of the rows: so many may have come twice
_OTHER_RATE = 0.02  # of a rate: what times of a file may be off
_SHOT_S = 1e-6  # between shots that share a stamp
_AXES = re.compile(r"^([+-]?)([xyz])$")
_LONG_GAP_S, _STUCK_ROWS = 10.0, 50
_MOST_NOTES = 3  # of each kind
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Recording:
    """Content of a file, and each decision of its reader as a sentence.

    commanded : of the samples: the stops of a path where they are shots
    columns : all of the file, those without a role are left out
    row_of : name of a point in the file to its row, from 1
    started : in ISO 8601, empty where the file has no date
    problems : ambiguities; where there are some, the rest is based on guesses
    """

    commanded: Commanded
    samples: TrackerSamples
    points: PointRows | None
    temperature: TemperatureSamples | None
    columns: tuple[Column, ...]
    first_row: tuple[str, ...]
    facts: dict[str, str]
    notes: tuple[str, ...]
    row_of: dict[str, int]
    events: tuple[RunEvent, ...] = ()
    problems: tuple[BundleError, ...] = ()
    started: str = ""


class _Problems:
    """Collects ambiguities, so that all are reported at once."""

    def __init__(self, known: Sequence[BundleError]) -> None:
        self.known = list(known)

    def attempt(self, call: Callable[[], _T], guess: _T) -> _T:
        try:
            return call()
        except BundleError as error:
            self.known.append(error)
            return guess


def read_recording(
    data: bytes,
    file: str,
    commanded: Commanded,
    options: TextOptions,
    names: Sequence[str] = (),
    find_locations: LocateShots | None = None,
) -> Recording:
    """Read an exported recording of commanded rows, with all its problems.

    names : of the commanded points, if they have any
    find_locations : finds the point of each shot

    Raises BundleError where there are no columns of numbers.
    """
    cells = read_cells(data, file, options.delimiter)
    columns, doubles = recognise_columns(cells, options.columns)
    problems = _Problems([*cells.problems, *doubles])
    attempt = problems.attempt
    position = np.full((len(cells), 3), np.nan)
    decimal, unit, why = options.decimal or "point", "", "not known"
    axes = attempt(lambda: _require_axes(cells, columns), [])
    if axes:
        places = [column.index for column in axes]
        decimal = attempt(
            lambda: options.decimal or find_decimal(cells, places), decimal
        )
        position = attempt(lambda: _read_positions(cells, places, decimal), position)
    status = attempt(
        lambda: _read_status(cells, find_column(columns, "status"), options),
        np.zeros(len(cells), np.int64),
    )
    status[~np.isfinite(position).all(axis=1)] = NO_POSITION
    status[lost := _find_lost_beam(position)] = NO_POSITION
    if axes:
        seen = position[status == 0]
        unit, why = attempt(
            lambda: _choose_unit(cells, axes, seen, commanded, options),
            (_guess_unit(seen, commanded), ", if anything"),
        )
    position_mm = LENGTH_MM.get(unit, 1.0) * _swap_axes(position, options.axes)
    if isinstance(commanded, Path) and len(cells) < STREAM_ROWS * len(commanded):
        commanded = _list_stops(commanded)
    guess_s = np.arange(len(cells), dtype=np.float64)
    guess_s *= _guess_step_s(cells, commanded)
    time_s, clock, started, beside = attempt(
        lambda: _read_times(cells, columns, commanded, options, decimal),
        (guess_s, "not known", "", ()),
    )
    shots = Shots(position_mm, status == 0, time_s)
    rows, mapping, said = attempt(
        lambda: find_points(cells, columns, commanded, shots, names, find_locations),
        (None, {}, ()),
    )
    ordered = attempt(
        lambda: _order_times(cells, columns, time_s, rows),
        _Ordered.plain(guess_s),
    )
    status[ordered.unknown] = NOT_VALID
    time_s, kept = ordered.time_s, ~ordered.repeated
    temperature, doubted = attempt(
        lambda: _read_temperatures(cells, columns, time_s, kept, decimal), (None, ())
    )
    samples = TrackerSamples(np.arange(len(time_s)), time_s, position_mm, status)
    points = None
    if rows is None:
        samples = samples.select(kept)
    else:
        used = (status == 0) & (rows >= 0)
        samples, points = _average_points(samples.select(used), rows[used])
    facts = {"rows": f"{len(cells)}", "separator": cells.delimiter}
    facts |= {"decimals": decimal, "unit": unit + why, "time": clock}
    facts |= {"started": started or "no date, or not a sure one"}
    facts |= {"axes": options.axes, **_count(samples, points)}
    if mapping:
        told = [f"{name} is {row}" for name, row in mapping.items()]
        told = told if len(told) <= 12 else [*told[:5], "…", told[-1]]
        facts["rows of points"] = ", ".join(told)
    notes = [*cells.notes, *beside, *said, *ordered.notes]
    if lost.any():
        notes.append(f"{lost.sum()} rows of 0, 0, 0 are taken for a lost beam")
    if rows is None:
        notes += _note_oddities(np.asarray(cells.row_of)[kept], samples)
    return Recording(
        commanded,
        samples,
        points,
        temperature,
        tuple(columns),
        tuple(column[0] for column in cells.columns),
        facts,
        (*notes, *(event.text for event in doubted)),
        mapping,
        doubted,
        tuple(problems.known),
        started,
    )


def _list_stops(path: Path) -> Configurations:
    stands = path.dwell_s > 0.0
    stands = stands if stands.any() else ~stands
    kept = np.flatnonzero(stands).tolist()
    target = tuple(path.target[k] for k in kept) if path.target else ()
    return Configurations(path.axes, path.position[kept], path.dwell_s[kept], target)


def _guess_unit(position: NDArray[np.float64], commanded: Commanded) -> str:
    aim, extent = _measure_commanded_extent(commanded), _measure_extent(position)
    if not (aim and extent):
        return "mm"
    return min(_USUAL_UNITS, key=lambda u: abs(np.log(LENGTH_MM[u] * extent / aim)))


def _guess_step_s(cells: Cells, commanded: Commanded) -> float:
    return max(_motion_time_s(commanded), 1.0) / len(cells)


def _motion_time_s(commanded: Commanded) -> float:
    if isinstance(commanded, Path):
        return travel_time_s(commanded)
    return float(commanded.dwell_s.sum())


def _find_lost_beam(position: NDArray[np.float64]) -> NDArray[np.bool_]:
    origin = (position == 0.0).all(axis=1)
    known = np.flatnonzero(~origin & np.isfinite(position).all(axis=1))
    if origin.any() and len(known):
        size = np.linalg.norm(position[known], axis=1)
        before = np.searchsorted(known, np.flatnonzero(origin)) - 1
        origin[origin] = size[np.maximum(before, 0)] > _AWAY * size.max()
    return origin


@dataclass(frozen=True, slots=True)
class _Ordered:
    """Times that increase; which rows come twice, or have no certain time."""

    time_s: NDArray[np.float64]
    repeated: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    notes: tuple[str, ...] = ()

    @classmethod
    def plain(cls, time_s: NDArray[np.float64]) -> _Ordered:
        none = np.zeros(len(time_s), bool)
        return cls(time_s, none, none)


def _order_times(
    cells: Cells,
    columns: list[Column],
    time_s: NDArray[np.float64],
    rows: NDArray[np.int64] | None,
) -> _Ordered:
    """Times that increase.

    A row of a stream that repeats the one before is left out; not where many share a
    stamp: there rows at a standstill differ in nothing else.
    """
    if rows is not None:  # shots within one second
        return _Ordered.plain(time_s + _SHOT_S * np.arange(len(time_s)))
    repeated, unknown = np.zeros((2, len(cells)), bool)
    notes: list[str] = []
    tied = (np.flatnonzero(np.diff(time_s) == 0) + 1).tolist()
    if len(tied) <= _FEW * len(cells):
        again = [k for k in tied if all(c[k] == c[k - 1] for c in cells.columns)]
        if again:
            repeated[again] = True
            notes.append(f"{len(again)} rows that repeat the one before left out")
    inside = np.flatnonzero(~repeated)
    time_s = time_s.copy()
    number = _read_numbering(cells, columns)
    for counted in (number[inside], np.arange(len(inside), dtype=float)):
        even = even_out(time_s[inside], counted)
        if even is not None:
            time_s[inside], unknown[inside] = even.time_s, even.unknown
            notes += [even.words, *_describe_missing(cells, inside, even)]
            break
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
    return _Ordered(time_s, repeated, unknown, tuple(notes))


def _describe_missing(
    cells: Cells, inside: NDArray[np.int64], even: EvenTimes
) -> list[str]:
    if not even.missing:
        return []
    told = [f"{n} before row {cells.row_of[inside[k]]}" for k, n in even.missing]
    shown = ", ".join(told[:_MOST_NOTES]) + (", …" if len(told) > _MOST_NOTES else "")
    total = sum(count for _, count in even.missing)
    notes = [f"{total} rows are missing by their times: {shown}"]
    if even.unknown.any():
        notes.append(
            f"{even.unknown.sum()} rows are not used: where beside the missing ones "
            "they belong is not known"
        )
    return notes


def _read_numbering(cells: Cells, columns: list[Column]) -> NDArray[np.float64]:
    """Row numbers of the software, from 0; else the rows counted."""
    rows = np.arange(len(cells), dtype=float)
    for column in columns:
        texts = cells.columns[column.index]
        if column.role != "point" or not all(map(str.isdecimal, texts)):
            continue
        number = np.array(texts, float)
        if (np.diff(number) >= 1.0).all():
            return number - number[0]
    return rows


def _require_axes(cells: Cells, columns: list[Column]) -> list[Column]:
    missing = [role for role in "xyz" if find_column(columns, role) is None]
    if missing:
        _require(cells, columns, ", ".join(missing))
    return [_require(cells, columns, role) for role in "xyz"]


def _read_positions(
    cells: Cells, places: list[int], decimal: str
) -> NDArray[np.float64]:
    return np.stack([read_numbers(cells, k, decimal) for k in places], axis=1)


def _require(
    cells: Cells, columns: list[Column], role: str, step_s: float = 1.0
) -> Column:
    if found := find_column(columns, role):
        return found
    remedy = ", ".join(f"--column {each}=NUMBER" for each in role.split(", "))
    remedy = f"say {remedy}"
    if role == "time":
        rate = 1.0 / step_s
        remedy += f", or --rate HZ if rows come evenly (about {rate:.3g} by the path)"
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
    if not len(position):
        raise BundleError("holds no position", file=cells.file, remedy="record again")
    aim, extent = _measure_commanded_extent(commanded), _measure_extent(position)
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


def _swap_axes(position: NDArray[np.float64], axes: str) -> NDArray[np.float64]:
    words = [_AXES.match(word.strip().lower()) for word in axes.split(",")]
    found = [word.groups() for word in words if word]
    if len(words) != 3 or sorted(name for _, name in found) != ["x", "y", "z"]:
        raise BadInput(f"--axes {axes}: write each of x, y, z once, as in x,-y,z")
    signs = np.array([-1.0 if sign == "-" else 1.0 for sign, _ in found])
    return signs * position[:, ["xyz".index(name) for _, name in found]]


def _measure_commanded_extent(commanded: Commanded) -> float:
    is_linear = [name in "XYZ" for name in commanded.axes]
    return _measure_extent(commanded.position[:, is_linear])


def _measure_extent(position: NDArray[np.float64]) -> float:
    """Twice the distance from the median that 5 % of the positions exceed."""
    away = np.linalg.norm(position - np.median(position, axis=0), axis=1)
    return float(2.0 * np.percentile(away, 95)) if len(away) else 0.0


def _read_times(
    cells: Cells,
    columns: list[Column],
    commanded: Commanded,
    options: TextOptions,
    decimal: str,
) -> tuple[NDArray[np.float64], str, str, tuple[str, ...]]:
    time, date = find_column(columns, "time"), find_column(columns, "date")
    rate_hz = options.rate_hz or (state_rate(cells) if time is None else None)
    least_s = _motion_time_s(commanded)
    if rate_hz is not None:
        time_s = _read_numbering(cells, columns) / rate_hz
        notes: list[str] = []
        started = ""
        if time is not None:
            with suppress(BundleError):
                read = read_clock(cells, time, date, options, decimal, least_s)
                stamps, _, started = read
                notes += _compare_rate(stamps, time_s, rate_hz)
        return time_s, f"{rate_hz:g} rows a second", started, tuple(notes)
    are_few = len(cells) < STREAM_ROWS * len(commanded)
    if are_few and not isinstance(commanded, Path) and time is None:
        return np.arange(len(cells), dtype=float), "none; points in order", "", ()
    time = _require(cells, columns, "time", _guess_step_s(cells, commanded))
    return *read_clock(cells, time, date, options, decimal, least_s), ()


def _compare_rate(
    stamp_s: NDArray[np.float64], time_s: NDArray[np.float64], rate_hz: float
) -> list[str]:
    took_s, by_rate_s = float(stamp_s[-1]), float(time_s[-1])
    if took_s <= 0.0 or abs(by_rate_s / took_s - 1.0) < _OTHER_RATE:
        return []
    own = rate_hz * by_rate_s / took_s
    return [f"--rate {rate_hz:g} contradicts the times of the file: {own:.4g} Hz"]


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
    """Rows at which a temperature changes, the first and the last.

    Rejected readings are NaN, and reported.
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
