"""Errors over temperature as `temperature.json`, and in sentences.

The keys that give the machine at a temperature are in `files.earlier.temperature_file`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from truepath.answers.temperature.temperature_model import Dependence, TemperatureStudy
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.earlier.model_file import (
    ENCODING,
    build_number_rows,
    model_to_json,
    pack_symmetric,
)
from truepath.files.earlier.temperature_file import SCHEMA, TemperatureModel
from truepath.files.earlier.verdict import verdict_json
from truepath.results.error_tables import ErrorTable, build_error_tables, tables_json
from truepath.results.lost_motion import list_half_tables

NOT_TOLD = (
    "Shifts and turns of the whole volume, the growth of a spindle and drift of the "
    "zero of a straight axis among them: the tracker's place is free in every result.",
    "How lost motion depends on temperature: it is the mean of the results.",
    "Axes that warm differently from one another, and what lags behind the "
    "temperature: one temperature stands for the machine.",
    "An offset that the thermometers share in all results: ask for temperatures of the "
    "same thermometers.",
)


def temperature_json(study: TemperatureStudy) -> dict[str, Any]:
    """The whole content of `temperature.json`."""
    model = study.model
    reference, machine = model.reference, model.machine
    G = build_number_rows(reference.model)
    tables = build_error_tables(reference, reference.measured)
    return {
        "schema": SCHEMA,
        "machine": machine_to_json(machine),
        "mode": reference.mode,
        "verdict": verdict_json(reference.verdict),
        "reference_degC": model.reference_degc,
        "measured_degC": list(model.measured_degc),
        "valid_degC": list(model.valid_degc),
        "results": [
            {
                "name": one.name,
                "temperature_degC": one.temperature_degc,
                "temperature_uncertainty_K": one.sigma_k,
                "time_h": None if one.time_s is None else one.time_s / 3600.0,
            }
            for one in study.results
        ],
        **_findings_json(study),
        **tables_json(
            tables,
            list_half_tables(reference),
            "none",
            reference.measured,
            machine,
        ),
        "coefficients": coefficients_json(model),
        "observability": {"unobservable": list(reference.unobservable)},
        "provenance": dict(reference.provenance),
        "model": model_to_json(reference),
        "per_kelvin": model_to_json(model.coefficients),
        "between": {
            "of": "covariance of the numbers and their change, plus its transpose",
            "encoding": ENCODING,
            "data": pack_symmetric(G @ model.between @ G.T),
        },
    }


def _findings_json(study: TemperatureStudy) -> dict[str, Any]:
    return {
        "dependences": [dependence_json(one) for one in study.dependences],
        "expansion": {
            one.axis: {
                "value_um_per_m_K": one.value_um_per_m_k,
                "uncertainty_um_per_m_K": one.uncertainty_um_per_m_k,
                "is_significant": one.is_significant,
            }
            for one in study.expansions
        },
        "volumetric_um_per_K": {
            "value": study.volumetric_um_per_k,
            "uncertainty": study.volumetric_u_um_per_k,
        },
        "text": describe_study(study),
        "not_told": list(NOT_TOLD),
    }


def dependence_json(one: Dependence) -> dict[str, Any]:
    """Significance and scatter of one error motion."""
    scatter = one.scatter
    freedom = scatter.freedom if np.isfinite(scatter.freedom) else None
    return {
        "symbol": one.symbol,
        "is_significant": one.is_significant,
        "chance": one.chance,
        "largest": one.largest,
        "chi2_per_freedom": {
            "without_temperature": scatter.constant_ratio,
            "with_temperature": scatter.ratio,
        },
        "widened_by": scatter.widening * scatter.coverage,
        "effective_freedom": freedom,
    }


def coefficients_json(model: TemperatureModel) -> dict[str, Any]:
    """Tables of the change per kelvin, units in their keys."""
    tables = build_error_tables(model.coefficients, model.reference.measured)
    return {
        **{one.symbol: _columns_per_kelvin(one) for one in tables.tables},
        **{
            one.symbol: {
                f"value_{one.unit}_per_K": one.value,
                f"uncertainty_{one.unit}_per_K": one.uncertainty,
            }
            for one in (*tables.squareness, *tables.locations)
        },
    }


def _columns_per_kelvin(table: ErrorTable) -> dict[str, list[float]]:
    return {
        f"position_{table.position_unit}": table.position_mm.tolist(),
        f"value_{table.unit}_per_K": table.value.tolist(),
        f"uncertainty_{table.unit}_per_K": table.uncertainty.tolist(),
    }


def describe_study(study: TemperatureStudy) -> list[str]:
    """Sentences on what depends on temperature, and on other possible causes."""
    low, high = study.model.measured_degc
    sure = [one for one in study.dependences if one.is_significant]
    told: list[str] = []
    if sure:
        names = ", ".join(one.symbol for one in sure)
        told.append(
            f"From {low:.1f} to {high:.1f} °C these depend on temperature: {names}. "
            f"The volumetric error changes by {study.volumetric_um_per_k:.2f} µm/K, "
            "root mean square over the travel."
        )
    else:
        told.append(
            f"From {low:.1f} to {high:.1f} °C nothing is seen to depend on temperature."
        )
    told += [
        f"{one.axis} grows by {one.value_um_per_m_k:.1f} ± "
        f"{2.0 * one.uncertainty_um_per_m_k:.1f} µm/(m·K) (k = 2)."
        for one in study.expansions
        if one.is_significant
    ]
    loose = [d.symbol for d in study.dependences if d.scatter.ratio > 2.0]
    if loose:
        told.append(
            "Results differ by more than temperature and their uncertainties explain, "
            f"as set-ups do, in {', '.join(loose)}; the uncertainties are widened for "
            "it."
        )
    return [*told, *study.cautions]
