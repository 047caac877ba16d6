"""Corrects the ranges of a Run for the air, once: as it is read.

A tracker divides by an index of refraction. Where it takes that of the air, nothing is
left to do. Where it takes a fixed one, r = r_shown · assumed index / index of the air.
A Run says who has done it; what is exported is never corrected again.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truepath.errors import BadInput
from truepath.files.environment.environment import interpolate, is_usable
from truepath.numerics.air_index import find_air_index
from truepath_drivers.interfaces.records import (
    AirSamples,
    TemperatureSamples,
    TrackerSamples,
)
from truepath_drivers.interfaces.tracker_records import Light, TrackerCapabilities

INSTRUMENT, SERVICE = "instrument", "truepath"
NOBODY, UNKNOWN = "nobody", "unknown"
USUAL_HUMIDITY = 50.0  # wrong by 30 %: 0.26 ppm at 20 °C
CAUSES = {
    "no-light": "neither tracker nor settings state its light",
    "no-temperature": "the temperature of the air was not measured",
    "temperature-gaps": "the temperature of the air is not known all the time",
    "pressure-gaps": "the pressure of the air is not known all the time",
    "nothing-known": "nothing is known of the air",
}
"""Why nothing could be done; the operator page says the same kinds in its languages."""
_BY = (INSTRUMENT, SERVICE, NOBODY, UNKNOWN)
_AIR = "air"
# What sensors are taken to be right to, standard uncertainty, with what the beam meets.
SIGMA_K, SIGMA_HPA, SIGMA_PERCENT = 0.5, 1.0, 10.0
_USUAL_AIR = (20.0, 1013.25, USUAL_HUMIDITY)
UNCORRECTED_PPM = 270.0  # a hall from vacuum, which an instrument may have assumed
_NM = 633.0


@dataclass(frozen=True, slots=True)
class Refraction:
    """Who has corrected the ranges for the air.

    by : `instrument`; `truepath`, here; `nobody`; `unknown` where nobody says
    light : of an instrument that does not correct
    index : mean that was applied, and before that mean air in °C, hPa, %; only of ours
    why : nothing could be done
    """

    by: str = UNKNOWN
    light: Light | None = None
    index: float | None = None
    air: tuple[float, float, float] | None = None
    why: str = ""


def choose_refraction(
    capabilities: TrackerCapabilities, stated: Light | None
) -> Refraction:
    """Return what a measurement begins with; `stated` is of the settings.

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
    """Return why ranges are not corrected, as one of `CAUSES` and in words.

    The kind is empty where a file states other words.
    """
    why = refraction.why or CAUSES["nothing-known"]
    return next((kind for kind, text in CAUSES.items() if text == why), ""), why


def lacks_air(refraction: Refraction, channels: Collection[str]) -> bool:
    """Tell whether ranges will stay uncorrected for want of sensors."""
    is_open = refraction.by == NOBODY
    return is_open and not {"air_degC", "pressure_hPa"} <= set(channels)


def correct_refraction(
    refraction: Refraction,
    tracker: TrackerSamples,
    temperature: TemperatureSamples | None,
    air: AirSamples | None,
) -> tuple[Refraction, TrackerSamples]:
    """Return the samples corrected for the air, and who has done it.

    Does nothing unless nobody has yet and light and air are known.
    """
    light, time_s = refraction.light, tracker.device_time_s
    if refraction.by != NOBODY or light is None or not len(time_s):
        return refraction, tracker
    found = _find_air(temperature, air, time_s)
    if isinstance(found, str):
        return replace(refraction, why=found), tracker
    index = find_air_index(light.wavelength_nm, *found, is_group=light.is_group)
    position_mm = tracker.position_mm * (light.assumed_index / index)[:, None]
    degc, hpa, percent = (float(values.mean()) for values in found)
    told = Refraction(SERVICE, light, float(index.mean()), (degc, hpa, percent))
    return told, replace(tracker, position_mm=position_mm)


def guess_scale(refraction: Refraction, channels: Collection[str]) -> float:
    """Return the factor on ranges in usual air, for what cannot wait for its sensors.

    1 where nothing will be corrected: a Run and its live estimate are alike.
    """
    light = refraction.light
    if refraction.by != NOBODY or light is None or lacks_air(refraction, channels):
        return 1.0
    air = (np.array([value]) for value in _USUAL_AIR)
    index = find_air_index(light.wavelength_nm, *air, is_group=light.is_group)
    return light.assumed_index / float(index[0])


def state_scale_ppm(refraction: Refraction) -> tuple[float, float, float]:
    """Return the standard uncertainty of all ranges in ppm, and that of a K and a hPa.

    It is common to the whole Run, and to the positioning errors of all axes.
    """
    light = refraction.light or Light(_NM, is_group=False)
    sizes = [SIGMA_K, SIGMA_HPA, SIGMA_PERCENT]
    at = np.tile(np.array(refraction.air or _USUAL_AIR, float), (4, 1))
    at[1:] += np.diag(sizes)
    index = find_air_index(light.wavelength_nm, *at.T, is_group=light.is_group)
    change = np.abs(1e6 * (index[1:] - index[0]))
    total = float(np.linalg.norm(change))
    return total, float(change[0] / SIGMA_K), float(change[1] / SIGMA_HPA)


def state_length_ppm(refraction: Refraction, tracker_ppm: float) -> float:
    """Return the standard uncertainty of all lengths by air and tracker, ppm.

    Where nobody says who corrects for the air, an instrument that does is assumed.

    tracker_ppm : what the tracker's ranges are uncertain by in proportion to themselves
    """
    is_open = refraction.by == NOBODY
    air_ppm = UNCORRECTED_PPM if is_open else state_scale_ppm(refraction)[0]
    return math.hypot(air_ppm, tracker_ppm)


def refraction_to_json(refraction: Refraction) -> dict[str, Any]:
    """Return what a Run file and a bundle keep of it."""
    return asdict(refraction)


def refraction_from_json(content: Any) -> Refraction:
    """Return what was kept; what nobody has said is unknown. Raises ValueError."""
    if content is None:
        return Refraction()
    by, light = content["by"], content.get("light")
    if by not in _BY:
        raise ValueError(f"refraction: by is {by!r}, none of {', '.join(_BY)}")
    return Refraction(
        by,
        None if light is None else Light(**light),
        content.get("index"),
        None if content.get("air") is None else tuple(content["air"]),
        content.get("why", ""),
    )


def _find_air(
    temperature: TemperatureSamples | None,
    air: AirSamples | None,
    time_s: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | str:
    """Return °C, hPa and % at times, or why they are not known."""
    span = float(time_s.min()), float(time_s.max())
    if temperature is None or _AIR not in temperature.names:
        return CAUSES["no-temperature"]
    warm = temperature.celsius[:, temperature.names.index(_AIR)]
    if not is_usable(temperature.time_s, warm, *span):
        return CAUSES["temperature-gaps"]
    if air is None or not is_usable(air.time_s, air.pressure_hpa, *span):
        return CAUSES["pressure-gaps"]
    damp = np.full(len(time_s), USUAL_HUMIDITY)
    if is_usable(air.time_s, air.humidity_percent, *span):
        damp = interpolate(air.time_s, air.humidity_percent, time_s)
    return (
        interpolate(temperature.time_s, warm, time_s),
        interpolate(air.time_s, air.pressure_hpa, time_s),
        damp,
    )
