"""A machine over time as `trend.json` and one HTML page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from markupsafe import Markup

from truepath.answers.shown.chart import (
    EDGE,
    LEFT,
    TOP,
    WIDTH,
    Colour,
    Frame,
    draw_curve,
    draw_image,
)
from truepath.answers.shown.error_figures import draw_legend
from truepath.answers.shown.page import (
    SIGN,
    format_expanded,
    format_number,
    render_page,
)
from truepath.answers.trend import (
    CHANCE,
    HOUR_S,
    Quantiles,
    RecalibrationForecast,
    TablesAt,
    Trend,
)
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.earlier.verdict import verdict_json
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.results.error_tables import tables_json

_HEIGHT = 150.0
# Key of the file, text of the page and its unit.
_STATES = {
    "quick": ("quick_um", "What settles quickly", "µm"),
    "quick_s": ("quick_s", "its time constant", "h"),
    "slow": ("slow_um", "What settles slowly", "µm"),
    "slow_s": ("slow_s", "its time constant", "h"),
    "walk": ("walk_um_in_one_hour", "What walks in one hour", "µm"),
    "day": ("day_um", "What a day of the hall does", "µm"),
    "per_kelvin": ("per_kelvin_um", "What one kelvin of all sensors does", "µm"),
}
_NOT_TOLD = (
    "Shifts and turns of the whole volume between Runs, the growth of a spindle among "
    "them: the tracker's place is free in every Run.",
    "What happens within a Run: each counts as one moment, its middle.",
    "Changes of lost motion and of anything else that depends on the direction of "
    "approach.",
    "What has not begun yet: another use of the machine, a crash, a change of its "
    "heating. The course goes on as it was, and as halls usually do.",
)


def describe_forecast(forecast: RecalibrationForecast) -> str:
    """One sentence on when to calibrate again."""
    if forecast.state == "not-known":
        return "When to calibrate again is not known: too few Runs, give three or more."
    if forecast.limit_um is None:
        return "No limit is stated, so nothing is said of when to calibrate again."
    limit = f"{forecast.limit_um:g} µm"
    hours = f"{format_number(float(forecast.time_s[-1]) / HOUR_S)} h"
    if forecast.due_s is None:
        return f"Not due: the machine stays below {limit} up to {hours}."
    if forecast.state == "already":
        return (
            f"Already: what is not known at the last Run may exceed {limit}. Measure "
            "more, or state a wider limit."
        )
    due = f"{format_number(forecast.due_s / HOUR_S)} h"
    chance = f"{100.0 * CHANCE:.0f} %"
    if forecast.expected_s is None:
        end = f"{100.0 * (forecast.exceeded or 0.0):.0f} %"
        return (
            f"The machine stays below {limit} up to {due}. Later cannot be said: the "
            f"chance to exceed it reaches {end} by {hours}. Measure once more by {due}."
        )
    expected = f"{format_number(forecast.expected_s / HOUR_S)} h"
    return (
        f"Calibrate again at {due} ({forecast.grade}): a chance of {chance} to exceed "
        f"{limit} by then, an even chance by {expected}."
    )


def trend_json(trend: Trend) -> dict[str, Any]:
    """The whole content of `trend.json`."""

    def encode_tables(at: TablesAt) -> dict[str, Any]:
        tables = tables_json(at.tables, (), "none", {}, trend.machine)
        del tables["direction"], tables["measured_range"]
        hours = at.time_s / HOUR_S
        return {"time_h": hours, "change_um": asdict(at.change_um), **tables}

    forecast = trend.forecast
    due, expected = forecast.due_s, forecast.expected_s
    return {
        "schema": "trend/1",
        "machine": machine_to_json(trend.machine),
        "verdict": verdict_json(trend.verdict),
        "runs": [
            {
                "name": at.name,
                "sha256": run.digest,
                "temperature_degC": run.temperature_degc,
                **encode_tables(at),
            }
            for run, at in zip(trend.runs, trend.at_runs, strict=True)
        ],
        "later": [encode_tables(at) for at in trend.later],
        "states": {_STATES[name][0]: asdict(one) for name, one in trend.sizes.items()},
        "sensors": list(trend.sensors),
        "outlook": {
            "state": forecast.state,
            "grade": forecast.grade,
            "sentence": describe_forecast(forecast),
            "limit_um": forecast.limit_um,
            "chance": CHANCE,
            "exceeded": forecast.exceeded,
            "due_h": None if due is None else due / HOUR_S,
            "expected_h": None if expected is None else expected / HOUR_S,
            "time_h": (forecast.time_s / HOUR_S).tolist(),
            "median_um": forecast.median_um.tolist(),
            "high_um": forecast.high_um.tolist(),
        },
        "not_told": list(_NOT_TOLD),
    }


def write_trend(trend: Trend, folder: str | Path) -> dict[str, Any]:
    """The result is the content of `trend.json`."""
    content = trend_json(trend)
    page = _render_trend_report(trend).encode()
    write_files(Path(folder), {"report.html": page, "trend.json": encode_json(content)})
    return content


def _render_trend_report(trend: Trend) -> str:
    times = (*trend.at_runs, *trend.later)
    return render_page(
        "trend.html",
        {
            "machine": trend.machine.name,
            "verdict": trend.verdict,
            "sentence": describe_forecast(trend.forecast),
            "chart": _draw_forecast(trend.forecast),
            "changes": [(_name(at), _format_quantiles(at.change_um)) for at in times],
            "states": [
                (text, _format_quantiles(trend.sizes[name], per_unit), unit)
                for name, (_, text, unit) in _STATES.items()
                for per_unit in [1.0 / HOUR_S if unit == "h" else 1.0]
                if name in trend.sizes
            ],
            "head": ("Error", "", *(_name(at) for at in times)),
            "entries": _list_entries(times),
            "not_told": _NOT_TOLD,
        },
    )


def _draw_forecast(forecast: RecalibrationForecast) -> Markup:
    frame = Frame(LEFT + 6.0, TOP, WIDTH - EDGE, TOP + _HEIGHT)
    hours = forecast.time_s / HOUR_S
    top = float(max(forecast.high_um.max(), forecast.limit_um or 0.0))
    x = frame.make_x(float(hours[0]), float(hours[-1]))
    y = frame.make_y(0.0, 1.05 * top, margin=0.0)
    lines = [
        draw_curve(x.place(hours), y.place(forecast.median_um), Colour.ACCENT),
        draw_curve(x.place(hours), y.place(forecast.high_um), Colour.SECOND),
    ]
    if forecast.limit_um is not None:
        limit = frame.draw_level(
            y, forecast.limit_um, Colour.INK, width=0.8, dash="4 2"
        )
        lines.append(limit)
    legend = ((Colour.ACCENT, "median"), (Colour.SECOND, "95 % of courses below"))
    return draw_image(
        TOP + _HEIGHT + 28.0,
        "How far the machine will be off the tables of the last Run",
        [
            frame.draw_axes(x, y, "hours after the first Run", "µm"),
            *lines,
            draw_legend(frame, legend),
        ],
    )


def _list_entries(times: tuple[TablesAt, ...]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for tables in zip(*(at.tables.tables for at in times), strict=True):
        first = tables[0]
        for k, position in enumerate(first.position_mm.tolist()):
            stated = (
                format_expanded(float(t.value[k]), float(t.uncertainty[k]))
                for t in tables
            )
            place = f"{format_number(position, 0)} {first.position_unit}"
            rows.append((f"{first.symbol} {SIGN[first.unit]}", place, *stated))
    singles = ((*at.tables.squareness, *at.tables.locations) for at in times)
    for each in zip(*singles, strict=True):
        stated = (format_expanded(one.value, one.uncertainty) for one in each)
        symbol = f"{each[0].symbol} {SIGN[each[0].unit]}"
        rows.append((symbol, describe_symbol(each[0].symbol), *stated))
    return rows


def _format_quantiles(size: Quantiles, scale: float = 1.0) -> str:
    median, low, high = (
        format_number(scale * value, 2) for value in (size.median, size.low, size.high)
    )
    return f"{median} ({low} to {high})"


def _name(at: TablesAt) -> str:
    hours = f"{format_number(at.time_s / HOUR_S, 2)} h"
    return f"{at.name}, {hours}" if at.name else f"{hours}, predicted"
