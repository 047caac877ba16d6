"""Air and sensors of a Run in a result."""

from __future__ import annotations

import math
from typing import Any

from truepath.files.bundle.run import RunSummary
from truepath.files.environment import (
    INSTRUMENT,
    MEASURED,
    NOBODY,
    SERVICE,
    ChannelFacts,
    Refraction,
    find_cause,
    range_scale_uncertainty_ppm,
    refraction_to_json,
)

_CORRECTED = (INSTRUMENT, SERVICE)


def environment_json(summary: RunSummary) -> dict[str, Any]:
    """Sensors and their faults, refraction and the scale that it leaves uncertain."""
    refraction = summary.refraction
    ppm, per_k, per_hpa = range_scale_uncertainty_ppm(refraction)
    is_corrected = refraction.by in _CORRECTED
    return {
        "sensors": [_sensor_json(one) for one in summary.sensors],
        "told": list(summary.sensors_told),
        "refraction": refraction_to_json(refraction),
        "range_scale": {
            "uncertainty_ppm": ppm if is_corrected else None,
            "per_K_ppm": per_k,
            "per_hPa_ppm": per_hpa,
            "in_tables": True,
        },
    }


def describe_refraction(refraction: Refraction) -> str:
    """Which party corrected the ranges for the air; completes a sentence."""
    if refraction.by == INSTRUMENT:
        return "corrected by the instrument itself"
    if refraction.by == SERVICE and refraction.index is not None:
        light = refraction.light
        kind = "group " if light is not None and light.is_group else ""
        wave = "" if light is None else f" at {light.wavelength_nm:g} nm"
        ppm = 1e6 * (refraction.index - 1.0)
        told = f"corrected here, once: mean {kind}index 1 + {ppm:.2f}·10⁻⁶{wave}"
        return f"{told}, of usual air: {refraction.why}" if refraction.why else told
    if refraction.by == NOBODY:
        return f"NOT corrected: {find_cause(refraction)[1]}"
    return "not corrected here; whether the instrument does is not known"


def describe_scale(refraction: Refraction) -> str:
    """Uncertainty by the air of the scale of all ranges; completes a sentence."""
    ppm, per_k, per_hpa = range_scale_uncertainty_ppm(refraction)
    what = f"{per_k:.2f} ppm a K and {per_hpa:.2f} ppm a hPa that the air is mistaken"
    common = (
        "common to all ranges, and to the positioning errors of all axes alike; the "
        "uncertainties of the tables contain it"
    )
    if refraction.by not in _CORRECTED:
        return f"{what}, {common}"
    if refraction.why:
        return f"{ppm:.1f} ppm (k = 1) of usual air: {what}, {common}"
    at = f"{MEASURED['air_degC']:g} K and {MEASURED['pressure_hPa']:g} hPa"
    return f"{ppm:.1f} ppm (k = 1) where the air is known to {at}: {what}, {common}"


def _sensor_json(one: ChannelFacts) -> dict[str, Any]:
    numbers = {"mean": one.mean, "low": one.low, "high": one.high, "change": one.change}
    return {
        "name": one.name,
        **{key: None if math.isnan(v) else v for key, v in numbers.items()},
        "readings": one.readings,
        "rows": one.rows,
        "longest_without_s": one.hole_s,
        "used": one.is_used,
    }
