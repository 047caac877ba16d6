"""Errors over temperature as one HTML file, and the files of `truepath temperature`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from truepath.answers.shown.page import (
    SIGN,
    format_expanded,
    format_number,
    render_page,
)
from truepath.answers.temperature.temperature_json import (
    NOT_TOLD,
    describe_study,
    temperature_json,
)
from truepath.answers.temperature.temperature_model import TemperatureStudy
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.files.earlier.temperature_file import TemperatureModel
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.results.error_tables import build_error_tables

TEMPERATURE, REPORT = "temperature.json", "report.html"


def write_temperature(study: TemperatureStudy, folder: str | Path) -> dict[str, Any]:
    """The result is the content of `temperature.json`."""
    content = temperature_json(study)
    page = render_temperature_report(study).encode()
    write_files(Path(folder), {REPORT: page, TEMPERATURE: encode_json(content)})
    return content


def render_temperature_report(study: TemperatureStudy) -> str:
    """One HTML page."""
    model = study.model
    return render_page(
        "temperature.html",
        {
            "machine": model.machine.name,
            "verdict": model.reference.verdict,
            "sentences": describe_study(study),
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
            "not_told": NOT_TOLD,
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
    for name in ("squareness", "locations"):
        pairs = zip(getattr(stated, name), getattr(change, name), strict=True)
        for single, slope in pairs:
            yield (
                f"{single.symbol} {SIGN[single.unit]}",
                describe_symbol(single.symbol),
                format_expanded(single.value, single.uncertainty),
                format_expanded(slope.value, slope.uncertainty),
            )
