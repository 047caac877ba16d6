"""Sections on the numbers: volumetric error, budget, tables, squareness, ISO 230-2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from truepath.answers.certificate.figures import (
    compute_slices,
    draw_histograms,
    draw_slices,
    inline_colours,
)
from truepath.answers.certificate.issue import (
    Certificate,
    Content,
    ResultSource,
    is_compensation_confirmed,
)
from truepath.answers.certificate.language import Language
from truepath.answers.certificate.stated_results import list_volumetric_errors
from truepath.answers.shown.error_figures import MotionTexts, draw_error_motions
from truepath.answers.shown.page import SIGN, View
from truepath.answers.verification.positioning_figures import (
    HalfDifference,
    PositioningFigures,
    Stated,
    compute_positioning_figures,
)
from truepath.compensation.tables.reference_temperature import (
    REFERENCE_DEGC,
    STEEL_UM_PER_M_K,
    find_measured_degc,
)
from truepath.kinematics.machine.machine import Axis, position_unit
from truepath.kinematics.machine.symbols import list_error_motions
from truepath.results.volumetric_error import compute_volumetric_error

_K = 2.0
_AT_ONCE = 3  # error motions of a table side by side on paper
_POSITION_SIGN = {"mm": "mm", "deg": "°"}


def describe_lengths(
    measured_degc: tuple[float, float] | None, language: Language
) -> str:
    """Sentence that lengths are not normalised to 20 °C; °C as (low, high)."""
    at = language.text("lengths_unknown")
    if measured_degc is not None:
        ends = dict.fromkeys(language.number(end, 1) for end in measured_degc)
        at = f"{' … '.join(ends)} °C"
    return language.text(
        "lengths_are",
        at=at,
        reference=f"{REFERENCE_DEGC:g}",
        steel=language.number(STEEL_UM_PER_M_K, 1),
    )


def describe_measured_lengths(provenance: Mapping[str, Any], language: Language) -> str:
    """The same, with the temperature from the provenance of a result."""
    return describe_lengths(find_measured_degc(provenance), language)


def describe_brief(certificate: Certificate, language: Language) -> View:
    """The volumetric error as found, expected after compensation, and as left."""
    note = ""
    if certificate.left is not None:
        is_confirmed = is_compensation_confirmed(certificate.left.content)
        note = language.text("left_confirmed" if is_confirmed else "left_stated")
    return {
        "rows": [
            (
                language.text(one.state),
                *(
                    language.expanded(size.value_um, 0.5 * size.expanded_uncertainty_um)
                    for size in (one.mean, one.p95, one.largest)
                ),
            )
            for one in list_volumetric_errors(certificate)
        ],
        "is_measured": certificate.left is not None,
        "left_note": note,
        "scale_note": _describe_scale(certificate, language),
    }


def _describe_scale(certificate: Certificate, language: Language) -> str:
    sources = (certificate.found, certificate.left)
    ppm = max(one.result.length_scale_ppm for one in sources if one is not None)
    if not ppm:
        return ""
    said = language.text("length_scale", ppm=language.number(_K * ppm, 2))
    known = certificate.found.result.known_lengths
    if known is None:
        return said
    settled = language.text(
        "known_lengths",
        count=language.count(known.count),
        off=language.number(known.off_ppm, 2),
        u=language.number(2.0 * known.uncertainty_ppm, 2),
    )
    return f"{said} {settled}"


def _describe_volume(certificate: Certificate, language: Language) -> View:
    found, left = certificate.found, certificate.left
    before = compute_volumetric_error(found.result)
    after = language.text("after_expected"), before.after_lengths_um
    if left is not None:
        error_um = compute_volumetric_error(left.result).error_um
        after = language.text("after_left"), np.linalg.norm(error_um, axis=1)
    lengths = np.linalg.norm(before.error_um, axis=1)
    histograms = [(language.text("before"), lengths), after]
    view: View = {"histograms": draw_histograms(histograms, language), "slices": []}
    names = [axis.name for axis in found.result.machine.linear_axes]
    if len(names) == 3:
        as_found, unknown = compute_slices(found.result)
        second, title = unknown, "slices_expected"
        if left is not None:
            second, title = compute_slices(left.result)[0], "slices_left"
        view["slices"] = [
            draw_slices(slices, names, language.text(text), language)
            for slices, text in ((as_found, "slices_before"), (second, title))
        ]
    return view


def _describe_budget(certificate: Certificate, language: Language) -> View:
    content = certificate.found.content
    budget = content.get("uncertainty_budget")
    if not budget:
        return {"rows": []}
    total = budget["total_um"]
    volume = max(total["volume"], 1e-12)
    directions = ("x", "y", "z", "volume")
    rows = [
        (
            language.text(f"budget_{source}"),
            *(language.number(_K * part[name], 3) for name in directions),
            f"{language.number(100.0 * (part['volume'] / volume) ** 2, 1)} %",
        )
        for source, part in budget["sources_um"].items()
    ]
    doubled = [language.number(_K * total[name], 3) for name in directions]
    has_thermal = budget["sources_um"].get("thermal", {}).get("volume", 0.0) > 0.0
    return {
        "rows": rows,
        "expanded": (language.text("budget_expanded"), *doubled, "100 %"),
        "thermal": "" if has_thermal else _describe_no_thermal(content, language),
    }


def _describe_tables(certificate: Certificate, language: Language) -> View:
    machine = certificate.found.result.machine
    holds = certificate.found.content.get("holds_for", {})
    target = machine.target()
    offset = ", ".join(language.number(value) for value in target.offset_mm)
    return {
        "holds": language.text("any_tool")
        if holds.get("any_tool")
        else language.text("this_tool", offset=offset),
        "states": [
            {
                "of": of,
                "axes": [
                    _describe_axis(axis, one.content, language) for axis in machine.axes
                ],
                "halves": list(_list_halves(one.content, language)),
            }
            for of, one in _list_states(certificate, language)
        ],
    }


def _describe_curves(certificate: Certificate, language: Language) -> View:
    states = [one.result for _, one in _list_states(certificate, language)]
    words = MotionTexts(
        language.own["curves_title"],
        language.text("curves_unknown"),
        language.name_symbol,
        language.decimal_mark,
    )
    return {
        "figures": [
            inline_colours(draw_error_motions(states, axis, words))
            for axis in certificate.found.result.machine.axes
        ],
        "has_left": len(states) > 1,
    }


def _list_states(
    certificate: Certificate, language: Language
) -> list[tuple[str, ResultSource]]:
    """As found, without a name where it is the only one; and as left."""
    if certificate.left is None:
        return [("", certificate.found)]
    return [
        (language.text("before"), certificate.found),
        (language.text("after_left"), certificate.left),
    ]


def _describe_single(certificate: Certificate, language: Language) -> View:
    states = _list_states(certificate, language)
    columns = [_read_singles(one.content, language) for _, one in states]
    head = [of or language.text("value_u") for of, _ in states]
    return {
        "head": (language.text("symbol"), language.text("error"), *head),
        "rows": [
            (
                symbol,
                language.name_symbol(symbol),
                *(column.get(symbol, "–") for column in columns),
            )
            for symbol in columns[0]
        ],
    }


def _read_singles(content: Content, language: Language) -> dict[str, str]:
    square = {
        symbol: (entry["value"], entry["uncertainty"], "urad")
        for symbol, entry in content["squareness_urad"].items()
    }
    places = {
        symbol: (entry[f"value_{unit}"], entry[f"uncertainty_{unit}"], unit)
        for symbol, entry in content.get("axis_location", {}).items()
        for unit in (_unit_of(entry),)
    }
    return {
        symbol: f"{language.expanded(value, sigma)} {SIGN[unit]}"
        for symbol, (value, sigma, unit) in {**square, **places}.items()
    }


def _describe_positioning(certificate: Certificate, language: Language) -> View:
    return {
        "states": [
            {
                "of": of,
                "rows": [
                    _format_positioning(figures, language)
                    for figures in compute_positioning_figures(
                        one.result, _read_halves(one.content), one.result.measured
                    )
                ],
                "lengths": describe_measured_lengths(one.result.provenance, language),
            }
            for of, one in _list_states(certificate, language)
        ]
    }


def _describe_no_thermal(content: Content, language: Language) -> str:
    changes = [
        abs(one["change"])
        for run in content.get("runs", [])
        for one in run.get("environment", {}).get("sensors", [])
        if one["change"] is not None and one["name"][:2] in ("X_", "Y_", "Z_")
    ]
    change = language.text("budget_thermal_unknown")
    if changes:
        kelvin = language.number(max(changes), 2)
        change = language.text("budget_thermal_change", kelvin=kelvin)
    return language.text("budget_thermal_none", change=change)


def _describe_axis(axis: Axis, content: Content, language: Language) -> View:
    tables = {
        symbol: content["error_tables"][symbol]
        for symbol in list_error_motions(axis.name)
        if symbol in content["error_tables"]
    }
    symbols = list(tables)
    groups = [symbols[i : i + _AT_ONCE] for i in range(0, len(symbols), _AT_ONCE)]
    beyond = any(any(table["extrapolated"]) for table in tables.values())
    return {
        "title": language.text("axis", axis=axis.name),
        "measured": _describe_measured(axis, content, language, beyond=beyond),
        "tables": [
            _list_values(axis, {s: tables[s] for s in group}, language)
            for group in groups
        ],
    }


def _describe_measured(
    axis: Axis, content: Content, language: Language, *, beyond: bool
) -> str:
    ends = content.get("measured_range", {}).get(axis.name)
    if not ends:
        return ""
    low, high = (language.number(value, 1) for value in ends.values())
    span = language.text("from_to", low=low, high=high)
    key = "measured_range" if beyond else "no_extrapolation"
    return language.text(key, range=f"{span} {_POSITION_SIGN[position_unit(axis)]}")


def _list_values(
    axis: Axis, tables: Mapping[str, Mapping[str, Any]], language: Language
) -> View:
    unit = position_unit(axis)
    first = next(iter(tables.values()))
    head = [f"{axis.name}, {_POSITION_SIGN[unit]}"]
    columns: list[list[str]] = []
    for symbol, table in tables.items():
        own = _unit_of(table)
        head.append(f"{symbol}, {SIGN[own]}")
        pairs = zip(table[f"value_{own}"], table[f"uncertainty_{own}"], strict=True)
        columns.append([language.expanded(value, sigma) for value, sigma in pairs])
    places = [
        language.number(position, 1) + ("*" if is_beyond else "")
        for position, is_beyond in zip(
            first[f"position_{unit}"], first["extrapolated"], strict=True
        )
    ]
    names = [f"{symbol}: {language.name_symbol(symbol)}" for symbol in tables]
    return {
        "head": head,
        "names": names,
        "rows": list(zip(places, *columns, strict=True)),
    }


def _read_halves(content: Content) -> dict[str, HalfDifference]:
    halves: Mapping[str, Any] = content.get("direction", {}).get("half_difference", {})
    return {
        symbol: HalfDifference(
            np.array(table.get("position_mm", table.get("position_deg")), float),
            np.array(table[f"value_{unit}"], float),
            np.array(table[f"uncertainty_{unit}"], float),
        )
        for symbol, table in halves.items()
        for unit in (_unit_of(table),)
    }


def _list_halves(content: Content, language: Language) -> Iterator[tuple[str, ...]]:
    for symbol, table in (
        content.get("direction", {}).get("half_difference", {}).items()
    ):
        unit = _unit_of(table)
        value, sigma = table[f"value_{unit}"], table[f"uncertainty_{unit}"]
        largest = int(np.argmax(np.abs(value)))
        place = "deg" if "position_deg" in table else "mm"
        at = language.number(table[f"position_{place}"][largest], 0)
        yield (
            symbol,
            language.name_symbol(symbol),
            f"{language.expanded(value[largest], sigma[largest])} {SIGN[unit]}",
            f"{at} {_POSITION_SIGN[place]}",
        )


def _unit_of(entry: Mapping[str, Any]) -> str:
    return next(unit for unit in ("um", "urad") if f"value_{unit}" in entry)


def _format_positioning(one: PositioningFigures, language: Language) -> tuple[str, ...]:
    def format_stated(stated: Stated | None) -> str:
        if stated is None:
            return "–"
        return language.expanded(stated.value, stated.uncertainty)

    low, high = (language.number(end, 0) for end in one.range)
    over = f"{low}\u00a0… {high}\u00a0{_POSITION_SIGN[one.position_unit]}"
    return (
        f"{one.symbol[2]},\u00a0{SIGN[one.unit]}",
        over,
        format_stated(one.mean_range),
        format_stated(one.reversal),
        format_stated(one.systematic_range),
        language.text("iso_not_told"),
    )


VIEWS = {
    "brief": describe_brief,
    "volume": _describe_volume,
    "budget": _describe_budget,
    "single": _describe_single,
    "iso": _describe_positioning,
    "curves": _describe_curves,
    "tables": _describe_tables,
}
