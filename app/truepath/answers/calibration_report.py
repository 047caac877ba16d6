"""The report of one calibration, its files `result.json` and `error_tables.csv`.

The report is one HTML file that needs no other. Its sections are in the order of ISO/TR
16907: machine and measurement, error motions, volumetric error, residuals, limits,
validation, documentation. Uncertainties are expanded (k = 2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from truepath.answers.model_difference import format_parameter
from truepath.answers.shown.error_figures import (
    draw_error_motions,
    draw_residuals,
    draw_volume,
)
from truepath.answers.shown.page import (
    SIGN,
    View,
    format_expanded,
    format_number,
    render_page,
    render_part,
)
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.errors import BundleError
from truepath.estimation.solve.batch import SeatEstimate
from truepath.files.bundle.run import Run, RunSummary, SampleQuality
from truepath.files.environment import ChannelFacts
from truepath.files.units import UM_PER_MM, URAD_PER_RAD
from truepath.kinematics.effects.family import Quantity
from truepath.kinematics.machine.machine import Axis, position_unit
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.kinematics.machine.symbols import list_error_motions as symbols_of
from truepath.numerics.adaptive_trials import NORMAL_FACTOR
from truepath.results.error_tables import (
    ErrorTable,
    compute_half_differences,
    error_tables_csv,
)
from truepath.results.grade_json import format_text
from truepath.results.monte_carlo_results import MAP, TrialQuantity, TrialResults
from truepath.results.result_json import (
    describe_refraction,
    describe_scale,
    result_json,
)
from truepath.results.result_summary import Findings, RunFindings
from truepath.results.updated_effects import describe_use, list_updated_effects
from truepath.results.volumetric_error import Figure

_GOOD_FIT = 1.15  # residual over noise up to which the model explains the measurement
_K = 2.0
_HOW = {"otf": "on the fly", "standstill": "at standstill"}
RESULT, TABLES, REPORT = "result.json", "error_tables.csv", "report.html"


def _format_figure(figure: Figure) -> str:
    return format_expanded(figure.value_um, figure.uncertainty_um)


def _describe_error_motions(findings: Findings) -> View:
    axes = findings.estimate.model.machine.axes
    return {
        "sizes": [
            (
                symbol,
                describe_symbol(symbol),
                *_format_sizes(findings.tables.table(symbol)),
            )
            for axis in axes
            for symbol in symbols_of(axis.name)
        ],
        "axes": [
            {
                "name": axis.name,
                "figure": draw_error_motions([findings.estimate], axis),
                **_list_values(findings, axis),
            }
            for axis in axes
        ],
    }


def _describe_squareness(findings: Findings) -> View:
    tables = findings.tables
    return {
        "rows": [
            (
                one.symbol,
                describe_symbol(one.symbol),
                f"{format_expanded(one.value, one.uncertainty)} {SIGN[one.unit]}",
            )
            for one in (*tables.squareness, *tables.locations)
        ]
    }


def _describe_direction(findings: Findings) -> View:
    halves = compute_half_differences(findings.estimate)
    rows: list[tuple[str, str, str]] = []
    for half in halves:
        if np.any(np.abs(half.value) > _K * half.uncertainty):
            i = int(np.argmax(np.abs(half.value)))
            value = format_expanded(half.value[i], half.uncertainty[i])
            text = f"{value} {SIGN[half.unit]}"
            rows.append((half.symbol, describe_symbol(half.symbol), text))
    return {"halves": halves, "rows": rows}


def _describe_volume(findings: Findings) -> View:
    volume = findings.volumetric
    worst = int(np.argmax(np.linalg.norm(volume.error_um, axis=1)))
    axes = findings.estimate.model.machine.axes
    position = zip(axes, volume.position_mm[worst], strict=True)
    error = zip(volume.error_um[worst], volume.uncertainty_um[worst], strict=True)
    states = (("Before compensation", volume.before), ("After, expected", volume.after))
    return {
        "rows": [
            (
                name,
                *(_format_figure(f) for f in (spread.mean, spread.p95, spread.largest)),
            )
            for name, spread in states
        ],
        "points": len(volume.position_mm),
        "worst_at": ", ".join(
            f"{axis.name} {format_number(value, 0)} {position_unit(axis)}"
            for axis, value in position
        ),
        "worst": ", ".join(format_expanded(value, sigma) for value, sigma in error),
        "figure_of_volume": draw_volume(findings),
    }


def _describe_effects(findings: Findings) -> View:
    estimate, model = findings.estimate, findings.provenance.model
    repeats_model = findings.provenance.repeats_model
    effects = list_updated_effects(estimate.known, estimate, estimate.chances)
    return {
        "use": model and describe_use(model, repeats_model=repeats_model),
        "rows": [
            (
                one.title,
                "not used" if repeats_model else _format_effect(one.before),
                _format_effect(one.after),
            )
            for one in effects
        ],
        "contradicted": [one.title for one in effects if one.agrees is False],
    }


def _format_sizes(table: ErrorTable | None) -> tuple[str | None, ...]:
    if table is None:
        return "", "", None
    sizes = np.ptp(table.value), np.abs(table.value).max()
    texts = [format_number(float(size)) for size in sizes]
    texts.append(format_number(_K * float(table.uncertainty.max()), 2))
    return tuple(f"{text} {SIGN[table.unit]}" for text in texts)


def _list_values(findings: Findings, axis: Axis) -> View:
    every = [findings.tables.table(symbol) for symbol in symbols_of(axis.name)]
    tables = [t for t in every if t is not None]
    positions: list[float] = tables[0].position_mm.tolist() if tables else []
    head = [f"{axis.name}, {position_unit(axis)}"]
    return {
        "head": head + [f"{t.symbol}, {SIGN[t.unit]}" for t in tables],
        "rows": [
            (
                format_number(position, 2),
                *(format_expanded(t.value[i], t.uncertainty[i]) for t in tables),
            )
            for i, position in enumerate(positions)
        ],
    }


def _format_effect(parameters: Mapping[str, Quantity]) -> str:
    return "; ".join(
        format_parameter(name, number.value, number.uncertainty)
        for name, number in parameters.items()
    )


def _name_runs(findings: Findings) -> str:
    runs = findings.provenance.runs
    if len(runs) == 1:
        return f"Run {runs[0].name}, measured {_HOW[runs[0].mode]}"
    named = ", ".join(f"{run.name} ({_HOW[run.mode]})" for run in runs)
    return f"Runs {named}, measured"


def _residual_over_noise(findings: Findings) -> float:
    return findings.estimate.rms_mm / max(findings.estimate.floor_mm, 1e-12)


def _describe_machine(findings: Findings) -> View:
    machine, grade = findings.estimate.model.machine, findings.grade
    return {
        "machine": machine,
        "travel": ", ".join(_format_travel(a, a.low, a.high) for a in machine.axes),
        "targets": "; ".join(
            f"{t.name} ({offset}) mm on the {t.on}".strip()
            for t in machine.targets
            for offset in [", ".join(format_number(value) for value in t.offset_mm)]
        ),
        "grade": None
        if grade is None
        else {
            "number": f"{grade.number:.2f}",
            "text": format_text(grade),
            "sample_sigma_um": format_number(UM_PER_MM * grade.sample_sigma_mm, 1),
        },
        "runs": [_describe_measurement(findings, run) for run in findings.runs],
    }


def _describe_residuals(findings: Findings) -> View:
    return {
        "rms_um": UM_PER_MM * findings.estimate.rms_mm,
        "floor_um": UM_PER_MM * findings.estimate.floor_mm,
        "ratio": _residual_over_noise(findings),
        "good_fit": _GOOD_FIT,
        "runs": [_describe_run_residuals(run) for run in findings.runs],
    }


def _describe_limits(findings: Findings) -> View:
    ends: list[str] = []
    for axis in findings.estimate.model.machine.axes:
        low, high = findings.estimate.measured.get(axis.name, (axis.low, axis.high))
        for begin, end in ((axis.low, low), (high, axis.high)):
            if begin < end:
                ends.append(_format_travel(axis, begin, end))
    return {"found": findings.estimate.observability, "extrapolated": ends}


def _describe_validation(findings: Findings) -> View:
    before, after = findings.volumetric.before.mean, findings.volumetric.after.mean
    trials = findings.trials
    return {
        "share": after.value_um / max(before.value_um, 1e-12),
        "trials": None if trials is None else describe_trials(trials),
    }


def describe_trials(trials: TrialResults) -> View:
    """Linear uncertainty compared with the trials, quantity by quantity."""
    return {
        "found": trials,
        "trials": f"{trials.trials:,}",
        "failed": [q.name for q in trials.quantities if not q.agrees.all()],
        "rows": [_format_quantity(q) for q in trials.quantities],
    }


def _describe_documentation(findings: Findings) -> View:
    return {
        "timing": any(run.mode == "otf" for run in findings.provenance.runs),
        "runs": [_describe_pose(run) for run in findings.runs],
    }


def _format_travel(axis: Axis, low: float, high: float) -> str:
    span = f"{format_number(low, 0)} to {format_number(high, 0)}"
    return f"{axis.name} {span} {position_unit(axis)}"


def _format_quantity(q: TrialQuantity) -> tuple[str, ...]:
    i = int(np.argmax(q.linear))
    is_map = q.name == MAP
    half = (q.high[i] - q.low[i]) / 2.0
    sizes = _K * q.linear[i], _K * q.sigma[i], NORMAL_FACTOR * q.linear[i], half
    return (
        "" if is_map else q.name,
        "volumetric error" if is_map else describe_symbol(q.name),
        *(f"{format_number(size, 3)} {SIGN[q.unit]}" for size in sizes),
        f"{int(q.agrees.sum())} of {len(q.agrees)}",
    )


def _describe_measurement(findings: Findings, run: RunFindings) -> View:
    summary, estimate = run.summary, run.estimate
    brought = findings.contributions
    without_um = findings.get_uncertainty_without_run_um(run)
    return {
        "summary": summary,
        "estimate": estimate,
        "feed": " to ".join(
            dict.fromkeys(f"{feed:,.0f}" for feed in summary.feed_mm_min or ())
        ),
        "minutes": f"{summary.measured_s / 60.0:.1f}",
        "samples": f"{estimate.offered_samples:,}",
        "used": 100.0 * estimate.used_samples / max(estimate.offered_samples, 1),
        "cells": f"{estimate.cells:,}",
        "distance_m": f"{run.noise.distance_mm / 1000.0:.2f}",
        "rate_hz": f"{estimate.tracker.rate_hz:g}",
        "sensors": [_format_sensor(one) for one in summary.sensors],
        "refraction": describe_refraction(summary.refraction),
        "scale": describe_scale(summary.refraction),
        "interruptions": describe_interruptions(summary),
        "quality": _describe_quality(summary.quality),
        "seats": [_describe_seat(seat) for seat in estimate.seats],
        "brought": None
        if brought is None or without_um is None
        else {
            "with_um": f"{_K * UM_PER_MM * brought.sigma_mm:.2f}",
            "without_um": f"{_K * without_um:.2f}",
        },
    }


def _describe_quality(found: SampleQuality | None) -> str:
    """Empty where the tracker reports no quality."""
    if found is None:
        return ""
    share = "" if found.told == 1.0 else f", told of {100.0 * found.told:.0f} %"
    return (
        f"{found.mean:.2f} in the mean, one of twenty below {found.low:.2f}, as the "
        f"tracker tells it (1 is best){share}"
    )


def _format_sensor(one: ChannelFacts) -> tuple[str, ...]:
    name, _, unit = one.name.rpartition("_")
    numbers = ("–",) * 4
    if one.readings:
        values = one.mean, one.low, one.high, one.change
        numbers = tuple(format_number(value, 2) for value in values)
    used = "yes" if one.is_used else f"no: nothing for {one.hole_s:.0f} s"
    counts = f"{one.readings:,} in {one.rows:,} rows"
    sign = {"degC": "°C", "hPa": "hPa", "percent": "%"}[unit]
    return name, sign, *numbers, counts, used


def describe_interruptions(summary: RunSummary) -> str:
    """Beam breaks, lost samples, searches, and repeated lines; empty for nothing."""
    found, texts = summary.interruptions, list[str]()
    if found.breaks:
        times = "once" if found.breaks == 1 else f"{found.breaks} times"
        texts.append(f"the beam was broken {times}, {found.broken_s:.1f} s in all")
    if found.gaps:
        places = "one place" if found.gaps == 1 else f"{found.gaps} places"
        texts.append(f"{found.lost_samples:,} samples lost in {places}")
    if found.searches or found.found:
        tries = found.searches + found.found
        times = "once" if tries == 1 else f"{tries} times"
        texts.append(f"the tracker searched {times} and found it {found.found} times")
    if summary.driven_again:
        texts.append(f"driven twice: {', '.join(summary.driven_again)}")
    return "; ".join(texts)


def _describe_seat(seat: SeatEstimate) -> View:
    shift = (UM_PER_MM * seat.shift_mm).tolist()
    half = (_K * UM_PER_MM * seat.sigma_mm).tolist()
    return {
        "name": seat.target.name,
        "shift_um": ", ".join(f"{value:.1f}" for value in shift),
        "half_um": ", ".join(f"{value:.2g}" for value in half),
        "against": " against the first target" if seat.target.on == "tool" else "",
    }


def _describe_run_residuals(run: RunFindings) -> View:
    noise, jitter = run.noise, run.noise.along_travel_um
    parts = (
        ("One sample, as the tracker states", noise.stated_um),
        ("One sample, white part found", noise.white_um),
        ("Correlated part found", noise.ou_um),
    )
    return {
        "summary": run.summary,
        "figure": draw_residuals(run),
        "noise": [
            (name, *(format_number(v, 2) for v in values)) for name, values in parts
        ],
        "distance_m": f"{noise.distance_mm / 1000.0:.2f}",
        "correlation_time_s": f"{noise.ou_time_s:.2g}",
        "along_um": None if jitter is None else f"{jitter:.2g}",
    }


def _describe_pose(run: RunFindings) -> View:
    sigma = np.sqrt(np.maximum(np.diag(run.estimate.pose_covariance), 0.0))
    scale = _K * np.repeat([UM_PER_MM, URAD_PER_RAD], 3)
    half = [f"{value:.2g}" for value in scale * sigma]
    station = run.estimate.pose.invert().translation_mm.tolist()
    return {
        "summary": run.summary,
        "station_mm": ", ".join(format_number(value) for value in station),
        "translation_um": ", ".join(half[:3]),
        "rotation_urad": ", ".join(half[3:]),
    }


_SECTIONS: dict[str, Callable[[Findings], View]] = {
    "machine": _describe_machine,
    "error_motions": _describe_error_motions,
    "squareness": _describe_squareness,
    "direction": _describe_direction,
    "volume": _describe_volume,
    "residuals": _describe_residuals,
    "limits": _describe_limits,
    "effects": _describe_effects,
    "validation": _describe_validation,
    "documentation": _describe_documentation,
}


@dataclass(frozen=True, slots=True)
class Analysis:
    """Contents of the files of an analysis.

    result : content of `result.json`; the others are texts of the files of that name
    """

    found: Findings
    result: dict[str, Any]
    tables_csv: str
    report_html: str


def read_runs(
    places: Sequence[str | Path], read: Callable[[Path], Run]
) -> tuple[Run, ...]:
    """Raises BundleError; of several Runs `file` begins with the name of that Run."""
    return tuple(_read(Path(place), read, len(places)) for place in places)


def _read(place: Path, read: Callable[[Path], Run], count: int) -> Run:
    try:
        return read(place)
    except BundleError as error:
        if count == 1:
            raise
        raise BundleError(
            error.problem,
            file=f"{place.name}: {error.file}",
            row=error.row,
            column=error.column,
            remedy=error.remedy,
        ) from error


def render_analysis(found: Findings) -> Analysis:
    """`result.json`, `error_tables.csv` and `report.html`, not yet written."""
    return Analysis(
        found,
        result_json(found),
        error_tables_csv(found.tables, found.verdict),
        render_calibration_report(found),
    )


def write_analysis(analysis: Analysis, folder: str | Path) -> None:
    """Each file is written completely or not at all."""
    # The result last: where it exists, the others exist as well.
    files = {
        TABLES: analysis.tables_csv.encode(),
        REPORT: analysis.report_html.encode(),
        RESULT: encode_json(analysis.result),
    }
    write_files(Path(folder), files)


def render_calibration_report(findings: Findings) -> str:
    """One HTML page with its style sheet and figures inside."""
    before, after = findings.volumetric.before, findings.volumetric.after
    both = findings.both_directions
    created = findings.provenance.created
    numbers = _number_sections(findings)
    return render_page(
        "calibration.html",
        {
            "machine": findings.estimate.model.machine.name,
            "measured": _name_runs(findings),
            "created": f"{created:%Y-%m-%d %H:%M} {created.tzname() or ''}",
            "verdict": findings.verdict,
            "before": before.mean.value_um,
            "largest": _format_figure(before.largest),
            "both": both and _format_figure(both.before.mean),
            "lost": both and _format_figure(both.left.mean),
            "after": after.mean.value_um,
            "share": after.mean.value_um / max(before.mean.value_um, 1e-12),
            "ratio": _residual_over_noise(findings),
            "good_fit": _GOOD_FIT,
            "known": len(findings.tables.tables),
            "motions": 6 * len(findings.estimate.model.machine.axes),
            "software": findings.provenance.software_version,
            "number_of": numbers,
            "sections": [render_section(name, findings) for name in numbers],
        },
    )


def render_section(name: str, findings: Findings) -> Markup:
    """The same markup as in the report, with the section's number there."""
    numbers = _number_sections(findings)
    common = {"findings": findings, "number": numbers[name], "number_of": numbers}
    view = common | _SECTIONS[name](findings)
    return render_part(f"calibration/{name}.html", view)


def _number_sections(findings: Findings) -> dict[str, int]:
    has_model = findings.provenance.model is not None
    names = [name for name in _SECTIONS if has_model or name != "effects"]
    return {name: number for number, name in enumerate(names, start=1)}
