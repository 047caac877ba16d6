"""Cells to seconds: numbers in a unit, a time of day, or a date with a time."""

from __future__ import annotations

import re
from datetime import date
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from truepath.app.errors import BundleError
from truepath.app.files.tracker_text.cells import Cells
from truepath.app.files.tracker_text.columns import Column
from truepath.app.files.tracker_text.numbers import find_decimal, read_numbers
from truepath.app.files.tracker_text.options import TextOptions

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_DAY_S = 86400.0
_OF_DAY = re.compile(
    r"(\d{1,2}):(\d\d):(\d\d(?:[.,:]\d+)?)\s*([ap]\.?m\.?)?"
    r"\s*(?:Z|UTC|([+-])(\d\d):?(\d\d))?$",
    re.IGNORECASE,
)
_DATE = re.compile(r"(\d{1,4})([-./])(\d{1,2})\2(\d{1,4})")


def read_clock(
    cells: Cells, time: Column, date_column: Column | None, options: TextOptions
) -> tuple[NDArray[np.float64], str]:
    """Return seconds since the first row, and how they were read."""
    texts = cells.column(time.index)
    if not any(":" in text for text in texts):
        return _read_counted(cells, time, options)
    days = cells.column(time.index if date_column is None else date_column.index)
    time_s = np.array([_read_of_day(cells, time, k) for k in range(len(texts))])
    if _DATE.search(days[0]):
        time_s += _DAY_S * _read_days(cells, days, options)
        how = "date and time"
    else:
        time_s, how = _unwrap_midnight(cells, time, time_s, options), "time of day"
    return time_s - time_s[0], how


def _read_counted(
    cells: Cells, time: Column, options: TextOptions
) -> tuple[NDArray[np.float64], str]:
    unit = options.time_unit or time.unit
    decimal = options.decimal or find_decimal(cells, [time.index])
    values = read_numbers(cells, time.index, decimal)
    values -= values[0]
    if unit in SECONDS:
        return SECONDS[unit] * values, unit
    step = float(np.median(np.diff(values))) if len(values) > 1 else 1.0
    rates = [f"{u}: {1 / (step * f):.4g} Hz" for u, f in SECONDS.items() if step > 0]
    raise BundleError(
        "states no unit of time" + (f" ({', '.join(rates)})" if rates else ""),
        file=cells.file,
        column=time.name,
        remedy="say --time-unit s, ms or us",
    )


def _read_of_day(cells: Cells, time: Column, row: int) -> float:
    found = _OF_DAY.search(cells.rows[row][time.index])
    if found is None or int(found[2]) > 59 or int(found[3][:2]) > 60:
        shown = f"is {cells.rows[row][time.index][:40]!r}, no time"
        remedy = "a time is HH:MM:SS.fff, with or without a date before it"
        raise cells.error(shown, row, time.index, remedy)
    hour, minute, second, half, sign, zone_hours, zone_minutes = found.groups()
    hours = int(hour)
    if half:
        hours = hours % 12 + 12 * (half[0].lower() == "p")
    second = re.sub("[,:]", ".", second)
    ahead_s = 0.0  # of UTC; summer time may begin within a recording
    if sign:
        ahead_s = float(f"{sign}1") * 60.0 * (60 * int(zone_hours) + int(zone_minutes))
    return 3600.0 * hours + 60.0 * int(minute) + float(second) - ahead_s


def _unwrap_midnight(
    cells: Cells, time: Column, time_s: NDArray[np.float64], options: TextOptions
) -> NDArray[np.float64]:
    back = np.diff(time_s) < -0.5 * _DAY_S
    if back.any() and not options.across_midnight:
        row = int(np.argmax(back)) + 1
        shown = f"goes back from {cells.rows[row - 1][time.index]}"
        remedy = "say --across-midnight if the recording ran into the next day"
        raise cells.error(shown, row, time.index, remedy)
    return time_s + _DAY_S * np.append(0, np.cumsum(back))


def _read_days(
    cells: Cells, texts: list[str], options: TextOptions
) -> NDArray[np.float64]:
    """Return the day of each row; the order of day and month must not matter."""
    words = list(dict.fromkeys(_shorten(text) for text in texts))
    orders = [options.date_order] if options.date_order else ["dmy", "mdy"]
    readings = [_order_days(words, order) for order in orders]
    fitting = [days for days in readings if days is not None]
    if not fitting:
        raise BundleError(
            f"{words[0]!r} is no date that is read here",
            file=cells.file,
            remedy="export dates as YYYY-MM-DD, or say --date-order dmy or mdy",
        )
    steps = {tuple(b - a for a, b in pairwise(days)) for days in fitting}
    if len(steps) > 1:
        raise BundleError(
            f"{words[0]} to {words[1]}: day and month could be either",
            file=cells.file,
            remedy="say --date-order dmy or mdy",
        )
    day_of = dict(zip(words, fitting[0], strict=True))
    first = fitting[0][0]
    return np.array([day_of[_shorten(text)] - first for text in texts], float)


def _shorten(text: str) -> str:
    found = _DATE.search(text)
    return found.group(0) if found else text


def _order_days(words: list[str], order: str) -> list[int] | None:
    days: list[int] = []
    for word in words:
        found = _DATE.search(word)
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
