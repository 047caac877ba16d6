"""A machine over time as `trend.json` and one HTML page."""

from __future__ import annotations

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
    HOUR_S,
    NOT_TOLD,
    Quantiles,
    RecalibrationForecast,
    TablesAt,
    Trend,
    describe_outlook,
    trend_json,
)
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.results.error_tables import ErrorTable, SingleError

TREND, REPORT = "trend.json", "report.html"
_HEIGHT = 150.0
_STATES = {
    "quick": ("What settles quickly", "µm"),
    "quick_s": ("its time constant", "h"),
    "slow": ("What settles slowly", "µm"),
    "slow_s": ("its time constant", "h"),
    "walk": ("What walks in one hour", "µm"),
    "day": ("What a day of the hall does", "µm"),
    "per_kelvin": ("What one kelvin of all sensors does", "µm"),
}


def write_trend(trend: Trend, folder: str | Path) -> dict[str, Any]:
    """The result is the content of `trend.json`."""
    content = trend_json(trend)
    page = _render_trend_report(trend).encode()
    write_files(Path(folder), {REPORT: page, TREND: encode_json(content)})
    return content


def _render_trend_report(trend: Trend) -> str:
    times = (*trend.at_runs, *trend.later)
    return render_page(
        "trend.html",
        {
            "machine": trend.machine.name,
            "verdict": trend.verdict,
            "sentence": describe_outlook(trend.outlook),
            "chart": _draw_outlook(trend.outlook),
            "changes": [
                (_name(at), _state_quantiles(at.change_um, 1.0, 2)) for at in times
            ],
            "states": [
                (text, *_state_size(trend.sizes[name], name), unit)
                for name, (text, unit) in _STATES.items()
                if name in trend.sizes
            ],
            "head": ("Error", "", *(_name(at) for at in times)),
            "entries": _list_entries(times),
            "not_told": NOT_TOLD,
        },
    )


def _draw_outlook(outlook: RecalibrationForecast) -> Markup:
    frame = Frame(LEFT + 6.0, TOP, WIDTH - EDGE, TOP + _HEIGHT)
    hours = outlook.time_s / HOUR_S
    top = float(max(outlook.high_um.max(), outlook.limit_um or 0.0))
    x = frame.make_x(float(hours[0]), float(hours[-1]))
    y = frame.make_y(0.0, 1.05 * top, margin=0.0)
    lines = [
        draw_curve(x.place(hours), y.place(outlook.median_um), Colour.ACCENT),
        draw_curve(x.place(hours), y.place(outlook.high_um), Colour.SECOND),
    ]
    if outlook.limit_um is not None:
        limit = frame.draw_level(y, outlook.limit_um, Colour.INK, width=0.8, dash="4 2")
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
    for number, table in enumerate(times[0].tables.tables):
        each = [at.tables.tables[number] for at in times]
        rows += [_state_place(each, k) for k in range(len(table.position_mm))]
    for name in ("squareness", "locations"):
        columns = zip(*(getattr(at.tables, name) for at in times), strict=True)
        rows += [_state_single(each) for each in columns]
    return rows


def _state_place(tables: list[ErrorTable], k: int) -> tuple[str, ...]:
    first = tables[0]
    place = f"{format_number(float(first.position_mm[k]), 0)} {first.position_unit}"
    stated = (
        format_expanded(float(t.value[k]), float(t.uncertainty[k])) for t in tables
    )
    return f"{first.symbol} {SIGN[first.unit]}", place, *stated


def _state_single(each: tuple[SingleError, ...]) -> tuple[str, ...]:
    text = describe_symbol(each[0].symbol)
    stated = (format_expanded(one.value, one.uncertainty) for one in each)
    return f"{each[0].symbol} {SIGN[each[0].unit]}", text, *stated


def _state_size(size: Quantiles, name: str) -> tuple[str]:
    scale = 1.0 / HOUR_S if name.endswith("_s") else 1.0
    return (_state_quantiles(size, scale, 2),)


def _state_quantiles(size: Quantiles, scale: float, digits: int) -> str:
    median, low, high = (
        format_number(scale * value, digits)
        for value in (size.median, size.low, size.high)
    )
    return f"{median} ({low} to {high})"


def _name(at: TablesAt) -> str:
    hours = f"{format_number(at.time_s / HOUR_S, 2)} h"
    return f"{at.name}, {hours}" if at.name else f"{hours}, predicted"
