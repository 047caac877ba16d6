"""Circles driven on the fly: their rows of the report, and their radius by angle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.app.reporting.chart import EDGE, LEFT, TOP, Frame
from truepath.app.reporting.error_figures import draw_legend
from truepath.app.reporting.svg import (
    WIDTH,
    Colour,
    draw_curve,
    draw_image,
    join_shapes,
)
from truepath.app.results.circle_figures import FIGURES, list_sector_angles
from truepath.app.results.circles_in_motion import CircleInMotion
from truepath.app.results.number_format import format_expanded, format_number

_HEIGHT = 130.0


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


def draw_circle(one: CircleInMotion) -> Markup:
    """Draw the radius in both senses, and the mean of what is predicted, by angle."""
    frame = Frame(LEFT + 6.0, TOP, WIDTH - EDGE, TOP + _HEIGHT)
    angle = list_sector_angles()
    sets = [
        (_take_centre_off(value), colour, sense)
        for (sense, value), colour in zip(
            one.radial_um.items(), (Colour.SECOND, Colour.THIRD), strict=False
        )
    ]
    expected = np.mean(list(one.expected_um.values()), axis=0)
    sets.append((_take_centre_off(expected), Colour.ACCENT, "predicted"))
    values = np.concatenate([value for value, _, _ in sets])
    x = frame.make_x(0.0, 360.0)
    y = frame.make_y(min(0.0, float(values.min())), max(0.0, float(values.max())))
    curves = [
        draw_curve(x.place(angle), y.place(value), colour) for value, colour, _ in sets
    ]
    return draw_image(
        TOP + _HEIGHT + 28.0,
        f"Circle in {one.commanded.plane}: radius less the commanded one, by angle",
        [
            frame.draw_axes(x, y, f"{one.commanded.plane}: angle, deg", "µm"),
            join_shapes(curves),
            draw_legend(frame, tuple((colour, name) for _, colour, name in sets)),
        ],
    )


def _list_figures(value: dict[str, float], sigma: dict[str, float]) -> list[str]:
    return [
        format_expanded(value[name], sigma[name]) if name in value else "—"
        for name in FIGURES
    ]


def _take_centre_off(radial_um: Float64[np.ndarray, " s"]) -> Float64[np.ndarray, " s"]:
    angle = np.radians(list_sector_angles())
    columns = np.column_stack([np.cos(angle), np.sin(angle)])
    return radial_um - columns @ (2.0 / len(angle) * (columns.T @ radial_um))
