"""Errors over temperature: results read with their temperatures, JSON file, HTML page.

The keys that give the machine at a temperature are in `files.earlier.temperature_file`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from truepath.answers.shown.page import (
    SIGN,
    format_expanded,
    format_number,
    render_page,
)
from truepath.answers.temperature import (
    Dependence,
    ResultAtTemperature,
    TemperatureStudy,
)
from truepath.documents.file_model import encode_json, parse_json
from truepath.documents.whole_files import read_whole, write_files
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.run import number_names
from truepath.files.earlier.model_file import (
    ENCODING,
    build_number_rows,
    model_to_json,
    pack_symmetric,
)
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    result_from_json,
)
from truepath.files.earlier.temperature_file import SCHEMA, TemperatureModel
from truepath.files.earlier.verdict import verdict_json
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.results.error_tables import build_error_tables, tables_json
from truepath.results.lost_motion import list_half_tables

_THERMOMETER_K = 0.1  # of a typical thermometer, without what all results share
_NOT_TOLD = (
    "Shifts and turns of the whole volume, the growth of a spindle and drift of the "
    "zero of a straight axis among them: the tracker's place is free in every result.",
    "How lost motion depends on temperature: it is the mean of the results.",
    "Axes that warm differently from one another, and what lags behind the "
    "temperature: one temperature stands for the machine.",
    "An offset that the thermometers share in all results: ask for temperatures of the "
    "same thermometers.",
)


def _read_machine_temperature(
    content: Mapping[str, Any], name: str, sensors: Sequence[str], thermometer_k: float
) -> tuple[float, float]:
    """Temperature of a result and its standard uncertainty, °C and K.

    Runs are weighted by duration. The uncertainty combines that of the thermometers and
    the change of temperature during the measurement.
    """
    wanted = sensors or [s for s in content["machine"]["axes"] if s in "XYZ"]
    runs = content.get("runs") or ()
    if not runs:
        raise BadInput(f"{name} states no temperature; state it by --degc")
    temperatures = [_read_run(run, name, wanted) for run in runs]
    mean, low, high = np.array(temperatures).T
    weight = np.array([float(run["measured_s"]) for run in runs])
    weight /= weight.sum()
    # Standard deviation of an even spread over the range.
    change_k = float(high.max() - low.min()) / 12.0**0.5
    return float(weight @ mean), float(np.hypot(thermometer_k, change_k))


def _read_run(
    run: Mapping[str, Any], name: str, wanted: Sequence[str]
) -> tuple[float, float, float]:
    known = {
        str(one["name"]).removesuffix("_degC"): one
        for one in run.get("environment", {}).get("sensors") or ()
        if one["used"] and one["mean"] is not None
    }
    missing = [sensor for sensor in wanted if sensor not in known]
    if missing:
        others = ", ".join(known) or "none"
        raise BadInput(
            f"{name}: Run {run['name']} has no temperature of {missing[0]} (it has "
            f"{others}); choose others by --sensor, or state temperatures by --degc"
        )
    mean, low, high = (
        float(np.mean([known[sensor][key] for sensor in wanted]))
        for key in ("mean", "low", "high")
    )
    return mean, low, high


def read_results(
    files: Sequence[Path],
    names: Sequence[str] = (),
    *,
    times_h: Sequence[float] | None = None,
    degc: Sequence[float] | None = None,
    sensors: Sequence[str] = (),
    thermometer_k: float = _THERMOMETER_K,
) -> list[ResultAtTemperature]:
    """Read results with their temperatures.

    names : of the results; their paths where none are given
    sensors : whose mean is taken; those of the scales of the axes if none are given
    times_h : when each was measured, hours from any origin; None where unknown
    degc : temperature of each, in place of that in its file

    Raises BundleError with the place in a file, BadInput where a temperature is
    missing, NotUsable where a result is not to be used.
    """
    names = names or number_names([str(file) for file in files])
    found: list[ResultAtTemperature] = []
    for k, (file, name) in enumerate(zip(files, names, strict=True)):
        content = parse_json(read_whole(file, largest_bytes=LARGEST_BYTES), str(file))
        result = result_from_json(content, file=str(file))
        result.verdict.require_usable(f"{file}: the result")
        if degc is None:
            known: Any = content
            temperatures = _read_machine_temperature(
                known, name, sensors, thermometer_k
            )
        else:
            temperatures = float(degc[k]), thermometer_k
        time_s = None if times_h is None else 3600.0 * times_h[k]
        found.append(ResultAtTemperature(name, result, *temperatures, time_s))
    return found


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
        "dependences": [_dependence_json(one) for one in study.dependences],
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
        "text": _describe_study(study),
        "not_told": list(_NOT_TOLD),
        **tables_json(
            tables,
            list_half_tables(reference),
            "none",
            reference.measured,
            machine,
        ),
        "coefficients": _coefficients_json(model),
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


def _dependence_json(one: Dependence) -> dict[str, Any]:
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


def _coefficients_json(model: TemperatureModel) -> dict[str, Any]:
    tables = build_error_tables(model.coefficients, model.reference.measured)
    return {
        **{
            one.symbol: {
                f"position_{one.position_unit}": one.position_mm.tolist(),
                f"value_{one.unit}_per_K": one.value.tolist(),
                f"uncertainty_{one.unit}_per_K": one.uncertainty.tolist(),
            }
            for one in tables.tables
        },
        **{
            one.symbol: {
                f"value_{one.unit}_per_K": one.value,
                f"uncertainty_{one.unit}_per_K": one.uncertainty,
            }
            for one in (*tables.squareness, *tables.locations)
        },
    }


def _describe_study(study: TemperatureStudy) -> list[str]:
    low, high = study.model.measured_degc
    sure = [one for one in study.dependences if one.is_significant]
    texts: list[str] = []
    if sure:
        names = ", ".join(one.symbol for one in sure)
        texts.append(
            f"From {low:.1f} to {high:.1f} °C these depend on temperature: {names}. "
            f"The volumetric error changes by {study.volumetric_um_per_k:.2f} µm/K, "
            "root mean square over the travel."
        )
    else:
        texts.append(
            f"From {low:.1f} to {high:.1f} °C nothing is seen to depend on temperature."
        )
    texts += [
        f"{one.axis} grows by {one.value_um_per_m_k:.1f} ± "
        f"{2.0 * one.uncertainty_um_per_m_k:.1f} µm/(m·K) (k = 2)."
        for one in study.expansions
        if one.is_significant
    ]
    loose = [d.symbol for d in study.dependences if d.scatter.ratio > 2.0]
    if loose:
        texts.append(
            "Results differ by more than temperature and their uncertainties explain, "
            f"as set-ups do, in {', '.join(loose)}; the uncertainties are widened for "
            "it."
        )
    return [*texts, *study.cautions]


def write_temperature(study: TemperatureStudy, folder: str | Path) -> dict[str, Any]:
    """The result is the content of `temperature.json`."""
    content = temperature_json(study)
    page = _render_temperature_report(study).encode()
    files = {"report.html": page, "temperature.json": encode_json(content)}
    write_files(Path(folder), files)
    return content


def _render_temperature_report(study: TemperatureStudy) -> str:
    model = study.model
    return render_page(
        "temperature.html",
        {
            "machine": model.machine.name,
            "verdict": model.reference.verdict,
            "sentences": _describe_study(study),
            "results": [
                (
                    one.name,
                    format_expanded(one.temperature_degc, one.sigma_k),
                    "" if one.time_s is None else format_number(one.time_s / 3600.0),
                )
                for one in study.results
            ],
            "dependences": [
                (
                    one.symbol,
                    describe_symbol(one.symbol),
                    format_number(one.scatter.constant_ratio),
                    format_number(one.scatter.ratio),
                    f"{one.chance:.4f}",
                    "yes" if one.is_significant else "not seen",
                )
                for one in study.dependences
            ],
            "expansions": [
                (
                    one.axis,
                    format_expanded(one.value_um_per_m_k, one.uncertainty_um_per_m_k),
                )
                for one in study.expansions
            ],
            "reference": format_number(model.reference_degc),
            "entries": list(_list_entries(model)),
            "not_told": _NOT_TOLD,
        },
    )


def _list_entries(model: TemperatureModel) -> Iterator[tuple[str, ...]]:
    measured = model.reference.measured
    stated = build_error_tables(model.reference, measured)
    change = build_error_tables(model.coefficients, measured)
    for table, slope in zip(stated.tables, change.tables, strict=True):
        for k, at in enumerate(table.position_mm):
            yield (
                f"{table.symbol} {SIGN[table.unit]}",
                f"{format_number(float(at), 0)} {table.position_unit}",
                format_expanded(float(table.value[k]), float(table.uncertainty[k])),
                format_expanded(float(slope.value[k]), float(slope.uncertainty[k])),
            )
    singles = ((*of.squareness, *of.locations) for of in (stated, change))
    for single, slope in zip(*singles, strict=True):
        yield (
            f"{single.symbol} {SIGN[single.unit]}",
            describe_symbol(single.symbol),
            format_expanded(single.value, single.uncertainty),
            format_expanded(slope.value, slope.uncertainty),
        )
