"""Cells to seconds: numbers in a unit, a time of day, or a date with a time.

Stamps that were rounded, or set in bursts, become the times of equidistant rows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BundleError
from truepath.files.imports.cells import Cells, find_decimal, read_numbers
from truepath.files.imports.columns import DATE, Column, TextOptions

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_DAY_S, _MINUTE_S = 86400.0, 60.0
_OF_DAY = re.compile(
    r"(?<![\d:])(\d{1,2}):([0-5]\d):((?:[0-5]\d|60)(?:[.,:]\d+)?)\s*([ap]\.?m\.?)?"
    r"\s*(?:Z|UTC|([+-])(\d\d):?(\d\d))?$",
    re.IGNORECASE,
)
_ZONE = re.compile(r"(?:Z|UTC|[+-]\d\d:?\d\d)$", re.IGNORECASE)
_RATES_HZ = (0.9, 20_000.0)  # of a stream
_LONGEST = 400.0  # times the duration of the motion: longest recording
_COUNTERS = [2.0**bits * f for bits in (16, 24, 32) for f in (1.0, 1e-3, 1e-6)]
_COUNTERS += [s * f for s in (60.0, 3600.0, _DAY_S) for f in (1.0, 1e3, 1e6)]
_SHARE = 0.4  # of the rows: so many follow at once where stamps come in bursts
_FEW_ROWS, _SCATTER = 3.0, 9.0  # rows; times their scatter beyond rounding, one row
_BESIDE = 5  # stamps that show whether what comes late stays late
_LATE = 1.1  # of that way: how far stamps may lie off rows that come evenly
_LATE_S = 0.02  # and of a computer that was busy
_ROUND = 0.005  # of a rate: so far it may be off a whole number of rows a second
_LEAST = 100  # rows that determine a rate


def read_clock(
    cells: Cells,
    time: Column,
    date_column: Column | None,
    options: TextOptions,
    decimal: str,
    least_s: float,
) -> tuple[NDArray[np.float64], str, str]:
    """Seconds since the first row, how they were read, and when it was.

    That is in ISO 8601, in the zone of the file, else of this computer; empty where
    no date is stated, or day and month could be either. Raises BundleError.

    decimal : of the positions
    least_s : duration of the commanded motion
    """
    texts = cells.columns[time.index]
    if not any(":" in text for text in texts[:: len(texts) // 100 + 1]):
        return *_read_counted(cells, time, options, decimal, least_s), ""
    started = ""
    time_s = _read_of_day(cells, time)
    days = texts if date_column is None else cells.columns[date_column.index]
    if DATE.search(days[0]):
        elapsed, first = _read_days(cells, days, options)
        time_s, how = time_s + _DAY_S * elapsed, "date and time"
        if first is not None:
            at = datetime(first.year, first.month, first.day)
            at += timedelta(seconds=float(time_s[0]))
            has_zone = _ZONE.search(texts[0].strip()) is not None
            at = at.replace(tzinfo=UTC) if has_zone else at.astimezone()
            started = at.isoformat(timespec="seconds")
    else:
        time_s, how = _unwrap_midnight(cells, time, time_s, options), "time of day"
    return time_s - time_s[0], how, started


@dataclass(frozen=True, slots=True)
class EvenTimes:
    """Equidistant times of rows between the places where rows are missing.

    unknown : rows that may be before or after missing ones
    missing : first row after each place, and how many are missing there
    """

    time_s: NDArray[np.float64]
    words: str
    unknown: NDArray[np.bool_]
    missing: tuple[tuple[int, int], ...]


def even_out(
    time_s: NDArray[np.float64], number: NDArray[np.float64]
) -> EvenTimes | None:
    """Even times for stamps that are rounded or come in bursts, else None.

    number : of the rows, as their software counted them
    """
    step = np.diff(time_s)
    if len(step) < _LEAST or (step < 0).any() or not (step > 0).any():
        return None
    mean = float(step[step <= np.percentile(step, 99.9)].mean())
    tied = bool((step == 0).any())
    if not tied and (step < 0.2 * mean).mean() < _SHARE:  # of the mean step
        return None
    heads = np.flatnonzero(step > (0.0 if tied else mean)) + 1
    if len(heads) < 3:
        return None
    head_s, head_n = time_s[heads], number[heads]
    way_s, rows = np.diff(head_s), np.diff(head_n)
    usual = float(np.median(way_s / rows))
    lacks = way_s / usual - rows
    holes = _find_holes(head_s - usual * head_n, lacks, usual)
    part = np.append(0, np.cumsum(np.isin(np.arange(len(lacks)), holes)))
    count = np.bincount(part)
    away_n = head_n - (np.bincount(part, head_n) / count)[part]
    if away_n.any():
        usual = float(away_n @ head_s / (away_n @ away_n))
    whole = np.rint(1.0 / usual)
    choices = [1.0 / whole] if abs(usual * whole - 1.0) < _ROUND else []
    way = float(np.median(way_s))
    row = np.arange(len(time_s))
    of_row = np.searchsorted(heads[holes + 1], row, side="right")
    full = way / usual
    for each in (*choices, usual):
        begin_s = np.bincount(part, head_s - each * head_n) / count
        even = begin_s[of_row] + each * number
        unknown = np.zeros(len(row), bool)
        for k in holes.tolist():
            if rows[k] < full - _FEW_ROWS:
                first, end = int(heads[k]), int(heads[k + 1])
                share = np.arange(end - first) / (end - first)
                even[first:end] = even[first] + share * (even[end] - even[first])
                unknown[first:end] = True
        late = np.where(unknown, np.nan, time_s - even)
        parts = (x[~np.isnan(x)] for x in np.split(late, heads[holes + 1]))
        spread = [float(np.ptp(x)) for x in parts if len(x)]
        if spread and max(spread) < _LATE * way + max(_LATE_S, 2.0 * each):
            words = f"stamps {way:.3g} s apart, {way / each:.3g} rows in each: "
            words += f"rows come at {1 / each:.6g} Hz"
            lost = [(int(heads[k + 1]), round(float(lacks[k]))) for k in holes.tolist()]
            return EvenTimes(even - even[0], words, unknown, tuple(lost))
    return None


def _find_holes(
    late_s: NDArray[np.float64], lacks: NDArray[np.float64], usual_s: float
) -> NDArray[np.int64]:
    """Between which heads rows are missing: from there on all are later."""
    scatter = float(np.median(np.abs(lacks - np.median(lacks))))
    least = max(_FEW_ROWS, _SCATTER * (scatter - 1.0))
    found: list[int] = []
    for k in np.flatnonzero(lacks > least).tolist():
        before, after = late_s[max(k - _BESIDE, 0) : k + 1], late_s[k + 1 :][:_BESIDE]
        if float(np.median(after) - np.median(before)) > least * usual_s:
            found.append(k)
    return np.array(found, np.int64)


def _read_counted(
    cells: Cells, time: Column, options: TextOptions, decimal: str, least_s: float
) -> tuple[NDArray[np.float64], str]:
    unit = options.time_unit or time.unit
    decimal = options.decimal or find_decimal(cells, [time.index], decimal)
    values, wraps = _unwrap_counter(read_numbers(cells, time.index, decimal))
    values -= values[0]
    if unit in SECONDS:
        return SECONDS[unit] * values, unit + wraps
    span = float(values[-1])
    rate = (len(values) - 1) / span if span > 0 else 0.0
    fitting = [
        u
        for u, f in SECONDS.items()
        if _RATES_HZ[0] < rate / f < _RATES_HZ[1]
        and 0.5 * least_s < f * span < _LONGEST * least_s
    ]
    rates = {
        u: f"{u}: {rate / f:.4g} Hz for {f * span:.4g} s" for u, f in SECONDS.items()
    }
    if len(fitting) == 1:
        how = f"{rates[fitting[0]]}, as no other unit fits what was commanded{wraps}"
        return SECONDS[fitting[0]] * values, how
    told = ", ".join(rates.values())
    raise BundleError(
        f"states no unit of time ({told}; motion: {least_s:.4g} s)",
        file=cells.file,
        column=time.name,
        remedy="say --time-unit s, ms or us",
    )


def _unwrap_counter(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    step = np.diff(values)
    back = np.flatnonzero(step < 0)
    if not len(back) or not (step > 0).any():
        return values, ""
    usual = float(np.median(step[step > 0]))
    reach = 50.0 * usual  # median steps that a counter may be from its end
    before, after = values[back], values[back + 1]
    for size in _COUNTERS:
        ends = (np.abs(before - size) < reach) | (np.abs(before - size / 2) < reach)
        if (ends & (np.abs(after + size - before) < reach)).all():
            turns = np.append(0.0, np.cumsum(step < 0))
            return (
                values + size * turns,
                f", its counter began anew at {before[0]:.12g}",
            )
    return values, ""


def _read_of_day(cells: Cells, time: Column) -> NDArray[np.float64]:
    """Seconds since midnight; texts shared by many rows are parsed once."""
    texts = cells.columns[time.index]
    if 2 * len({*texts}) < len(texts):
        return _read_words(cells, time, texts)
    parts = [text.removesuffix("Z").rpartition(":") for text in texts]
    minutes = [part[0] for part in parts]
    if any(":" in m.rpartition(":")[0] for m in {*minutes}):
        return _read_words(cells, time, texts)
    try:
        second_s = np.array("\n".join([part[2] for part in parts]).split("\n"), float)
    except ValueError:
        return _read_words(cells, time, texts)
    if second_s.max() >= _MINUTE_S + 1.0 or second_s.min() < 0.0:
        return _read_words(cells, time, texts)
    return second_s + _read_words(cells, time, [f"{m}:00" for m in minutes])


def _read_words(
    cells: Cells, time: Column, texts: Sequence[str]
) -> NDArray[np.float64]:
    words = list(dict.fromkeys(texts))
    found = [_OF_DAY.search(word) for word in words]
    if None in found:
        row = texts.index(words[found.index(None)])
        shown = f"is {cells.columns[time.index][row][:40]!r}, no time"
        remedy = "a time is HH:MM:SS.fff, with or without a date before it"
        raise cells.error(shown, row, time.index, remedy)
    read = [match.groups() for match in found if match]
    second_of = dict(zip(words, (_add_up(*each) for each in read), strict=True))
    return np.array([second_of[text] for text in texts])


def _add_up(
    hour: str,
    minute: str,
    second: str,
    half: str | None,
    sign: str | None,
    zone_hours: str,
    zone_minutes: str,
) -> float:
    hours = int(hour)
    if half:
        hours = hours % 12 + (12 if half[0] in "pP" else 0)
    seconds = float(second.replace(",", ".").replace(":", "."))
    time_s = 3600.0 * hours + _MINUTE_S * int(minute) + seconds
    if sign:  # ahead of UTC; summer time may begin within a recording
        ahead = 60 * int(zone_hours) + int(zone_minutes)
        time_s -= _MINUTE_S * (ahead if sign == "+" else -ahead)
    return time_s


def _unwrap_midnight(
    cells: Cells, time: Column, time_s: NDArray[np.float64], options: TextOptions
) -> NDArray[np.float64]:
    back = np.diff(time_s) < -0.5 * _DAY_S
    if back.any() and not options.across_midnight:
        row = int(np.argmax(back)) + 1
        shown = f"goes back from {cells.columns[time.index][row - 1]}"
        remedy = "say --across-midnight if the recording ran into the next day"
        raise cells.error(shown, row, time.index, remedy)
    return time_s + _DAY_S * np.append(0, np.cumsum(back))


def _read_days(
    cells: Cells, texts: Sequence[str], options: TextOptions
) -> tuple[NDArray[np.float64], date | None]:
    """Days since the first, and which that is, where it can be only one."""
    first = [text.partition("T")[0].partition(" ")[0] for text in texts]
    short_of = {
        text: found[0] if (found := DATE.search(text)) else text for text in {*first}
    }
    short = [short_of[text] for text in first]
    words = list(dict.fromkeys(short))
    orders = [options.date_order] if options.date_order else ["dmy", "mdy"]
    readings = [_order_days(words, order) for order in orders]
    fitting = [days for days in readings if days is not None]
    if not fitting:
        raise BundleError(
            f"{words[0]!r} is no date that is read here",
            file=cells.file,
            remedy="export dates as YYYY-MM-DD, or say --date-order dmy or mdy",
        )
    if len(fitting) > 1:  # no recording pauses for a month
        on = [d for d in fitting if all(0 <= b - a <= 1 for a, b in pairwise(d))]
        fitting = on or fitting
    steps = {tuple(b - a for a, b in pairwise(days)) for days in fitting}
    if len(steps) > 1:
        raise BundleError(
            f"{words[0]} to {words[1]}: day and month could be either",
            file=cells.file,
            remedy="say --date-order dmy or mdy",
        )
    day_of = dict(zip(words, fitting[0], strict=True))
    day = date.fromordinal(fitting[0][0])
    elapsed = np.array([day_of[word] - fitting[0][0] for word in short], float)
    return elapsed, day if len({days[0] for days in fitting}) == 1 else None


def _order_days(words: list[str], order: str) -> list[int] | None:
    days: list[int] = []
    for word in words:
        found = DATE.search(word)
        if found is None:
            return None
        a, mark, b, c = found.groups()
        if len(a) == 4:
            year, month, day = a, b, c
        elif order == "dmy" or mark == ".":
            day, month, year = a, b, c
        else:
            month, day, year = a, b, c
        try:
            days.append(date(int(year), int(month), int(day)).toordinal())
        except ValueError:
            return None
    return days
