"""Circles driven on the fly: their rows of the report."""

from __future__ import annotations

from truepath.app.results.circle_figures import FIGURES
from truepath.app.results.circles_in_motion import CircleInMotion
from truepath.app.results.number_format import format_expanded, format_number


def state_moving_circle(one: CircleInMotion) -> list[tuple[str, ...]]:
    """Return a row as measured, one of the noise alone, and one as predicted."""
    measured, commanded = one.measured, one.commanded
    own = [
        format_number(measured.own_um[name], 1) if name in measured.own_um else "—"
        for name in FIGURES
    ]
    stated = _list_figures(measured.value_um, measured.uncertainty_um)
    predicted = _list_figures(one.predicted_um, one.predicted_uncertainty_um)
    diameter, feed = f"{2.0 * commanded.radius_mm:g}", f"{commanded.feed_mm_min:g}"
    return [
        (commanded.plane, diameter, feed, *stated),
        ("", "noise alone", "", *own),
        ("", "predicted", "", *predicted),
    ]


def _list_figures(value: dict[str, float], sigma: dict[str, float]) -> list[str]:
    return [
        format_expanded(value[name], sigma[name]) if name in value else "—"
        for name in FIGURES
    ]
