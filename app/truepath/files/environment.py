"""Readings of sensors during a Run, and the correction of its ranges for the air.

A tracker divides by an index of refraction. Where that is the index of the air, nothing
remains to be done. Where it is a fixed one, r = r_shown · assumed index / index of the
air. Quantities of the air that were not measured have typical values, with their
uncertainty.

A Run states which party has corrected it; what is exported is never corrected again.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BadInput
from truepath.numerics.air_index import compute_air_index, compute_site_pressure_hpa
from truepath_drivers.interfaces.records import (
    AirSamples,
    TemperatureSamples,
    TrackerSamples,
)
from truepath_drivers.interfaces.tracker_records import Light, TrackerCapabilities

Series = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times and readings of one channel, NaN where there was none."""

DEGC, PRESSURE, HUMIDITY = "_degC", "pressure_hPa", "humidity_percent"
# Longest hole that is bridged: an axis scale warms over minutes.
_SHORT_S, _LONG_S, _HOLE_SHARE, _HOLE_STEPS = 15.0, 120.0, 0.2, 3.0
INSTRUMENT, SERVICE = "instrument", "truepath"
NOBODY, UNKNOWN = "nobody", "unknown"
CAUSES = {
    "no-light": "neither tracker nor settings state its light",
    "no-temperature": "the temperature of the air was not measured",
    "temperature-gaps": "the temperature of the air is not known all the time",
    "pressure-gaps": "the pressure of the air is not known all the time",
    "nothing-known": "nothing is known of the air",
}
"""Why ranges could not be corrected, or not by air that was measured; the operator page
says the same kinds in its languages."""
_AIR_DEGC, _ALTITUDE = "air" + DEGC, "altitude_m"
MEASURED = {_AIR_DEGC: 0.5, PRESSURE: 1.0, HUMIDITY: 10.0}
"""Standard uncertainties of what sensors show, as air that the beam meets."""
ASSUMED = {
    _AIR_DEGC: 5.0,
    PRESSURE: 10.0,
    HUMIDITY: 25.0,
    _ALTITUDE: 1000.0 / 12.0**0.5,
}
"""Those of what nobody measured: a hall, the weather at a known altitude, and an
altitude anywhere from 0 to 1000 m."""
_USUAL_DEGC, _USUAL_PERCENT, _USUAL_ALTITUDE_M = 20.0, 50.0, 500.0
_USUAL_AIR = (_USUAL_DEGC, 1013.25, _USUAL_PERCENT)
UNCORRECTED_PPM = 270.0  # a hall from vacuum: the assumed index is unknown


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


@dataclass(frozen=True, slots=True)
class Refraction:
    """Which party has corrected the ranges for the air.

    by : `instrument`; `truepath`, here; `nobody`; `unknown`
    light : of an instrument that does not correct
    index : mean that was applied, and before that mean air in °C, hPa, %; only of ours
    why : nothing could be done, or not with measured air
    assumed : names of `ASSUMED` that were not measured; only of ours
    """

    by: str = UNKNOWN
    light: Light | None = None
    index: float | None = None
    air: tuple[float, float, float] | None = None
    why: str = ""
    assumed: tuple[str, ...] = ()


def choose_refraction(
    capabilities: TrackerCapabilities, stated: Light | None
) -> Refraction:
    """Refraction at the start of a measurement; `stated` is of the settings.

    Raises BadInput where the settings would correct what the instrument corrects.
    """
    if capabilities.corrects_air:
        if stated is not None:
            raise BadInput(
                "setting tracker_light: this tracker corrects for the air itself, "
                "and must not be corrected twice; remove the setting"
            )
        return Refraction(INSTRUMENT)
    light = stated or capabilities.light
    if light is None:
        by = UNKNOWN if capabilities.corrects_air is None else NOBODY
        why = "" if by == UNKNOWN else CAUSES["no-light"]
        return Refraction(by, why=why)
    return Refraction(NOBODY, light)


def find_cause(refraction: Refraction) -> tuple[str, str]:
    """Why ranges are not corrected, as one of `CAUSES` and as a sentence.

    The kind is empty where a file has other words.
    """
    why = refraction.why or CAUSES["nothing-known"]
    return next((kind for kind, text in CAUSES.items() if text == why), ""), why


def lacks_air(refraction: Refraction, channels: Collection[str]) -> bool:
    """Whether ranges have to be corrected, and the air is not measured."""
    return refraction.by == NOBODY and not {_AIR_DEGC, PRESSURE} <= set(channels)


def correct_refraction(
    refraction: Refraction,
    tracker: TrackerSamples,
    temperature: TemperatureSamples | None,
    air: AirSamples | None,
    altitude_m: float | None = None,
) -> tuple[Refraction, TrackerSamples]:
    """Correct the samples for the air.

    Does nothing unless they are uncorrected and the light is known.

    altitude_m : of the site; None where it is not stated
    """
    light, time_s = refraction.light, tracker.device_time_s
    if refraction.by != NOBODY or light is None or not len(time_s):
        return refraction, tracker
    found, why = _find_air(temperature, air, time_s)
    assumed = [name for name in MEASURED if name not in found]
    if PRESSURE in assumed and altitude_m is None:
        assumed.append(_ALTITUDE)
    usual = (_USUAL_DEGC, _compute_typical_hpa(altitude_m), _USUAL_PERCENT)
    whole = [
        found.get(name, np.full(len(time_s), value))
        for name, value in zip(MEASURED, usual, strict=True)
    ]
    index = compute_air_index(light.wavelength_nm, *whole, is_group=light.is_group)
    position_mm = tracker.position_mm * (light.assumed_index / index)[:, None]
    degc, hpa, percent = (float(values.mean()) for values in whole)
    told = Refraction(
        SERVICE, light, float(index.mean()), (degc, hpa, percent), why, tuple(assumed)
    )
    return told, replace(tracker, position_mm=position_mm)


def assumed_range_factor(
    refraction: Refraction, channels: Collection[str], altitude_m: float | None = None
) -> float:
    """Factor on ranges in typical air, where sensor readings come too late.

    1 where nothing will be corrected: a Run and its live estimate are alike.
    """
    light = refraction.light
    if refraction.by != NOBODY or light is None:
        return 1.0
    usual = _USUAL_AIR
    if altitude_m is not None or PRESSURE not in channels:
        usual = (_USUAL_DEGC, _compute_typical_hpa(altitude_m), _USUAL_PERCENT)
    air = (np.array([value]) for value in usual)
    index = compute_air_index(light.wavelength_nm, *air, is_group=light.is_group)
    return light.assumed_index / float(index[0])


def find_factor(refraction: Refraction) -> float:
    """Mean factor applied here to the ranges of the tracker; 1 for none."""
    if refraction.light is None or refraction.index is None:
        return 1.0
    return refraction.light.assumed_index / refraction.index


def range_scale_uncertainty_ppm(refraction: Refraction) -> tuple[float, float, float]:
    """Standard uncertainty of all ranges, ppm, and ppm per K and per hPa.

    It is common to the whole Run, and to the positioning errors of all axes.
    """
    light = refraction.light or Light(633.0, is_group=False)
    sizes = [
        (ASSUMED if name in refraction.assumed else MEASURED)[name] for name in MEASURED
    ]
    away = [[0.0, 0.0, 0.0], *np.diag(sizes)]
    if _ALTITUDE in refraction.assumed:
        higher_m = _USUAL_ALTITUDE_M + ASSUMED[_ALTITUDE]
        less_hpa = _compute_typical_hpa(None) - compute_site_pressure_hpa(higher_m)
        away.append([0.0, less_hpa, 0.0])
    at = np.array(refraction.air or _USUAL_AIR) + np.array(away)
    index = compute_air_index(light.wavelength_nm, *at.T, is_group=light.is_group)
    change = np.abs(1e6 * (index[1:] - index[0]))
    total = float(np.linalg.norm(change))
    return total, float(change[0] / sizes[0]), float(change[1] / sizes[1])


def state_length_ppm(refraction: Refraction, tracker_ppm: float) -> float:
    """Standard uncertainty of all lengths by air and tracker, ppm.

    Where it is unknown which party corrects for the air, an instrument that does is
    assumed.

    tracker_ppm : standard uncertainty of the tracker's ranges in proportion to
        themselves
    """
    air_ppm = UNCORRECTED_PPM
    if refraction.by != NOBODY:
        air_ppm = range_scale_uncertainty_ppm(refraction)[0]
    return math.hypot(air_ppm, tracker_ppm)


def refraction_to_json(refraction: Refraction) -> dict[str, Any]:
    """Content of the key `refraction` of a Run file and a bundle."""
    return asdict(refraction) | {"assumed": list(refraction.assumed)}


def refraction_from_json(content: Any) -> Refraction:
    """Unknown refraction for None. Raises ValueError, KeyError, TypeError."""
    if content is None:
        return Refraction()
    by, light = content["by"], content.get("light")
    if by not in (known := (INSTRUMENT, SERVICE, NOBODY, UNKNOWN)):
        raise ValueError(f"refraction: by is {by!r}, none of {', '.join(known)}")
    assumed = tuple(content.get("assumed", ()))
    if unknown := set(assumed) - set(ASSUMED):
        raise ValueError(f"refraction: assumed names {', '.join(sorted(unknown))}")
    return Refraction(
        by,
        None if light is None else Light(**light),
        content.get("index"),
        None if content.get("air") is None else tuple(content["air"]),
        content.get("why", ""),
        assumed,
    )


def _compute_typical_hpa(altitude_m: float | None) -> float:
    return compute_site_pressure_hpa(
        _USUAL_ALTITUDE_M if altitude_m is None else altitude_m
    )


def _find_air(
    temperature: TemperatureSamples | None,
    air: AirSamples | None,
    time_s: NDArray[np.float64],
) -> tuple[dict[str, NDArray[np.float64]], str]:
    span = float(time_s.min()), float(time_s.max())
    found: dict[str, NDArray[np.float64]] = {}
    why = CAUSES["no-temperature"]
    if temperature is not None and "air" in temperature.names:
        why = CAUSES["temperature-gaps"]
        warm = temperature.celsius[:, temperature.names.index("air")]
        if is_usable(temperature.time_s, warm, *span):
            found[_AIR_DEGC] = interpolate(temperature.time_s, warm, time_s)
            why = CAUSES["pressure-gaps"]
    if air is not None:
        shown = {PRESSURE: air.pressure_hpa, HUMIDITY: air.humidity_percent}
        for name, values in shown.items():
            if is_usable(air.time_s, values, *span):
                found[name] = interpolate(air.time_s, values, time_s)
    return found, "" if {_AIR_DEGC, PRESSURE} <= set(found) else why
