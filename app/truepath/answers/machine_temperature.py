"""Dependence of a machine of the catalogue on temperature, as JSON documents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import lru_cache
from typing import Any

from truepath.answers.machine_history import Calibration

SCHEMA = "machine-temperature/1"
_KEPT = (
    "reference_degC",
    "measured_degC",
    "dependences",
    "expansion",
    "volumetric_um_per_K",
    "coefficients",
    "text",
    "not_told",
)


def machine_temperature_json(
    machine: str,
    calibrations: Sequence[Calibration],
    sensors: Sequence[str],
    reference_degc: float,
) -> dict[str, Any]:
    """Dependence on temperature from several calibrations.

    Raises BadInput, BundleError as `study_temperature` and `read_results`.
    """
    content, shown = _find_model(tuple(calibrations), tuple(sensors), reference_degc)
    return {
        "schema": SCHEMA,
        "machine": machine,
        "verdict": content["verdict"]["state"],
        "calibrations": shown,
        **{key: content[key] for key in _KEPT},
    }


def temperature_model_json(
    calibrations: Sequence[Calibration], sensors: Sequence[str], reference_degc: float
) -> Mapping[str, Any]:
    """Content of `temperature.json`, as `truepath temperature` writes it.

    Raises BadInput, BundleError as `machine_temperature_json`.
    """
    content, _ = _find_model(tuple(calibrations), tuple(sensors), reference_degc)
    return content


@lru_cache(maxsize=16)
def _find_model(
    calibrations: tuple[Calibration, ...],
    sensors: tuple[str, ...],
    reference_degc: float,
) -> tuple[Mapping[str, Any], Sequence[Mapping[str, Any]]]:
    # Imported on use: the service process does not load the numerical code.
    from truepath.answers.temperature import study_temperature
    from truepath.answers.temperature_report import read_results, temperature_json

    times = [datetime.fromisoformat(one.measured) for one in calibrations]
    results = read_results(
        [one.file for one in calibrations],
        [one.job_id for one in calibrations],
        times_h=[time.timestamp() / 3600.0 for time in times],
        sensors=sensors,
    )
    content = temperature_json(
        study_temperature(results, reference_degc=reference_degc)
    )
    stated = zip(calibrations, results, strict=True)
    return content, [
        {
            **one.describe(),
            "temperature_degC": result.temperature_degc,
            "temperature_uncertainty_K": result.sigma_k,
        }
        for one, result in stated
    ]
