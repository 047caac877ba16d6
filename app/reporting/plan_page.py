"""A plan for people: what it will tell, how soon, and what stays unseen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from app.reporting.html_parts import drawing, escape, facts, table
from app.reporting.report_style import STYLE
from app.reporting.svg import NUMBER, WIDTH, Colour, curve, image, segments, words
from app.results.effect_titles import effect_title
from app.results.model_difference import in_words

_HEIGHT, _LEFT, _TOP, _RIGHT, _BOTTOM = 240.0, 58.0, 14.0, 12.0, 34.0
_TICKS = 5
_AT = ("known_before", "parameters")
_MODES = {"otf": "On the fly", "standstill": "At standstills"}


def plan_page(document: Mapping[str, Any]) -> str:
    """Return the page of a plan's JSON."""
    name = escape(document["machine"]["name"])
    predicted = document["predicted"]
    pairs = [
        ("Measured", escape(_MODES[document["mode"]])),
        ("Rows", escape(document["rows"])),
        ("Time", f"{document['duration_s'] / 60.0:.1f} min"),
        (
            "Volumetric uncertainty (k = 2)",
            f"{predicted['expanded_volumetric_uncertainty_um']:.2f} µm",
        ),
    ]
    if document["target"] is not None:
        reached = "reached" if document["target"]["reached"] else "not reached"
        wanted = f"{document['target']['expanded_volumetric_uncertainty_um']:g} µm"
        pairs.append(("Target (k = 2)", f"{wanted}: {reached}"))
    unseen = "".join(f"<li>{escape(one)}</li>" for one in document["unobservable"])
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: plan</title>\n<style>{STYLE}</style>\n</head>\n<body><main>\n"
        f"<header><p class=kind>Measurement plan</p><h1>{name}</h1></header>\n"
        f"{facts(pairs)}{_curve(document['curve'])}{_motions(predicted)}"
        f"{_effects(predicted['effects'])}"
        f"<h2>What stays unseen</h2><ul>{unseen or '<li>nothing</li>'}</ul>"
        "</main></body>\n</html>\n"
    )


def _motions(predicted: Mapping[str, Any]) -> str:
    rows = [
        (escape(symbol), f"{2.0 * at[f'uncertainty_{unit}']:.2f}", shown)
        for symbol, at in predicted["errors"].items()
        for unit, shown in (("um", "µm"), ("urad", "µrad"))
        if f"uncertainty_{unit}" in at
    ]
    return "<h2>Error motions</h2>" + table(
        ("error", "predicted uncertainty (k = 2)", ""), rows, numbers=1
    )


def _effects(effects: Sequence[Mapping[str, Any]]) -> str:
    """Return what will be known of a model's effects; nothing without any."""
    if not effects:
        return ""
    rows = [
        (escape(_title(effect)), *(_numbers(effect[at]) for at in _AT))
        for effect in effects
    ]
    return "<h2>Effects of the model (k = 2)</h2>" + table(
        ("effect", "known before", "with this plan"), rows, numbers=3
    )


def _title(effect: Mapping[str, Any]) -> str:
    keys = {k: v for k, v in effect.items() if isinstance(v, str) and k != "name"}
    return effect_title(effect["name"], keys)


def _numbers(parameters: Mapping[str, Any]) -> str:
    pairs = parameters.items()
    said = [in_words(n, m["value"], m["uncertainty"]) for n, m in pairs]
    return escape("; ".join(said))


def _curve(points: Sequence[Mapping[str, float]]) -> str:
    """Return the drawing of uncertainty against time, on a logarithmic scale."""
    time_s = np.array([p["time_s"] for p in points])
    expanded_um = np.array([p["expanded_volumetric_uncertainty_um"] for p in points])
    low = float(np.floor(np.log10(expanded_um.min())))
    high = max(float(np.ceil(np.log10(expanded_um.max()))), low + 1.0)
    right, bottom = WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    x = _LEFT + time_s / time_s.max() * (right - _LEFT)
    y = bottom - (np.log10(expanded_um) - low) / (high - low) * (bottom - _TOP)
    parts: list[str] = []
    for decade in range(int(low), int(high) + 1):
        level = bottom - (decade - low) / (high - low) * (bottom - _TOP)
        ends = np.array([[_LEFT, level]]), np.array([[right, level]])
        parts.append(segments(*ends, Colour.RULE, width=0.6))
        text = f"{10.0**decade:g}"
        parts.append(words(_LEFT - 6.0, level + 3.0, text, size=NUMBER, anchor="end"))
    for share in np.linspace(0.0, 1.0, _TICKS).tolist():
        place = _LEFT + share * (right - _LEFT)
        text = f"{share * time_s.max() / 60.0:.1f}"
        parts.append(words(place, bottom + 13.0, text, size=NUMBER, anchor="middle"))
    parts.append(curve(x, y, Colour.ACCENT, width=1.8))
    parts.append(words((_LEFT + right) / 2.0, _HEIGHT - 6.0, "min", anchor="middle"))
    parts.append(
        words(12.0, _HEIGHT / 2.0, "µm (k = 2)", anchor="middle", upright=False)
    )
    title = "Predicted volumetric uncertainty as the measurement goes on"
    return drawing(image(_HEIGHT, title, parts), title + ".")
