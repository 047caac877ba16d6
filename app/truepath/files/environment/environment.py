"""Readings of sensors during a Run: one table of them, its facts, what may be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.records import AirSamples, TemperatureSamples

Series = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times and readings of one channel, NaN where there was none."""

DEGC, PRESSURE, HUMIDITY = "_degC", "pressure_hPa", "humidity_percent"
# Longest hole that is bridged: an axis scale warms over minutes.
_SHORT_S, _LONG_S, _HOLE_SHARE, _HOLE_STEPS = 15.0, 120.0, 0.2, 3.0


@dataclass(frozen=True, slots=True)
class ChannelFacts:
    """One sensor over a Run; numbers are NaN where it has no reading.

    name : column of `environment.csv`
    change : last reading minus first
    readings : accepted ones, in a table of so many rows
    hole_s : longest time without one
    is_used : no hole is too long for interpolation
    """

    name: str
    mean: float
    low: float
    high: float
    change: float
    readings: int
    rows: int
    hole_s: float
    is_used: bool


def tabulate_channels(
    series: Mapping[str, Series],
) -> tuple[TemperatureSamples | None, AirSamples | None]:
    """Channels in one table of all their times, NaN between."""
    series = {name: one for name, one in series.items() if len(one[0])}
    if not series:
        return None, None
    time_s = np.unique(np.concatenate([times for times, _ in series.values()]))
    columns = {name: np.full(len(time_s), np.nan) for name in series}
    for name, (times, values) in series.items():
        columns[name][np.searchsorted(time_s, times)] = values
    return split_columns(time_s, columns)


def split_columns(
    time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]
) -> tuple[TemperatureSamples | None, AirSamples | None]:
    """Temperatures and air from the columns of `environment.csv`."""
    warm = {name.removesuffix(DEGC): v for name, v in columns.items() if DEGC in name}
    temperature = air = None
    if warm:
        celsius = np.stack(list(warm.values()), axis=1)
        temperature = TemperatureSamples(tuple(warm), time_s, celsius)
    if PRESSURE in columns or HUMIDITY in columns:
        none = np.full(len(time_s), np.nan)
        air = AirSamples(
            time_s, columns.get(PRESSURE, none), columns.get(HUMIDITY, none)
        )
    return temperature, air


def name_columns(
    temperature: TemperatureSamples | None, air: AirSamples | None
) -> dict[str, Series]:
    """Every column of `environment.csv` with its times."""
    columns: dict[str, Series] = {}
    if temperature is not None:
        for name, values in zip(temperature.names, temperature.celsius.T, strict=True):
            columns[name + DEGC] = temperature.time_s, values
    if air is not None:
        for name, values in (
            (PRESSURE, air.pressure_hpa),
            (HUMIDITY, air.humidity_percent),
        ):
            if not np.isnan(values).all():
                columns[name] = air.time_s, values
    return columns


def fill_columns(
    columns: Mapping[str, Series], at_s: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Readings of the sensors at times, those with a long hole left out."""
    span = float(at_s.min()), float(at_s.max())
    return {
        name: interpolate(times, values, at_s)
        for name, (times, values) in columns.items()
        if is_usable(times, values, *span)
    }


def find_missing(facts: Sequence[ChannelFacts]) -> dict[str, str]:
    """Sensors that no analysis may use, and why."""
    return {
        one.name: f"no reading to be believed for {one.hole_s:.0f} s"
        for one in facts
        if not one.is_used
    }


def state_facts(
    temperature: TemperatureSamples | None,
    air: AirSamples | None,
    begin_s: float,
    end_s: float,
) -> tuple[ChannelFacts, ...]:
    """Facts of every sensor over a Run from `begin_s` to `end_s`."""
    columns = name_columns(temperature, air)
    return tuple(_state(n, *one, begin_s, end_s) for n, one in columns.items())


def is_usable(
    time_s: NDArray[np.float64],
    values: NDArray[np.float64],
    begin_s: float,
    end_s: float,
) -> bool:
    """Whether readings may be interpolated linearly over a time.

    They may not over a long hole, in which the reading is unknown. A table of one row
    was written by hand, and is valid all the time.
    """
    good = np.isfinite(values)
    if len(values) == 1 or not good.any():
        return bool(good.any())
    steps = np.diff(time_s[good])
    usual_s = float(np.median(steps)) if len(steps) else 0.0
    bridged_s = min(_LONG_S, max(_SHORT_S, _HOLE_SHARE * (end_s - begin_s)))
    limit_s = max(bridged_s, _HOLE_STEPS * usual_s)
    return _find_hole_s(time_s[good], begin_s, end_s) <= limit_s


def interpolate(
    time_s: NDArray[np.float64],
    values: NDArray[np.float64],
    at_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Readings at other times, linear between accepted ones."""
    good = np.isfinite(values)
    return np.interp(at_s, time_s[good], values[good])


def _find_hole_s(good_s: NDArray[np.float64], begin_s: float, end_s: float) -> float:
    inside = good_s[(good_s > begin_s) & (good_s < end_s)]
    before = good_s[good_s <= begin_s][-1:]
    after = good_s[good_s >= end_s][:1]
    ends = [
        *(before if len(before) else [begin_s]),
        *inside,
        *(after if len(after) else [end_s]),
    ]
    return float(np.max(np.diff(ends))) if len(ends) > 1 else 0.0


def _state(
    name: str,
    time_s: NDArray[np.float64],
    values: NDArray[np.float64],
    begin_s: float,
    end_s: float,
) -> ChannelFacts:
    shown = values[np.isfinite(values)]
    if not len(shown):
        none, all_s = float("nan"), end_s - begin_s
        return ChannelFacts(
            name, none, none, none, none, 0, len(values), all_s, is_used=False
        )
    good_s = time_s[np.isfinite(values)]
    return ChannelFacts(
        name,
        float(shown.mean()),
        float(shown.min()),
        float(shown.max()),
        float(shown[-1] - shown[0]),
        len(shown),
        len(values),
        _find_hole_s(good_s, begin_s, end_s),
        is_used=is_usable(time_s, values, begin_s, end_s),
    )
