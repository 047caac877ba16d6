"""Circles of ISO 230-4 as polar charts: the radial deviation, far exaggerated.

Out of the document of a verification, `circles_in_motion`, so that report and
certificate show the same numbers. What is drawn is about the centre of least squares,
as the figures are; run-in and run-out are no part of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.shown.chart import (
    NUMBER,
    TITLE,
    WIDTH,
    Colour,
    Scale,
    draw_image,
    draw_label,
    draw_segments,
    draw_strokes,
    round_up,
)
from truepath.answers.shown.page import format_expanded
from truepath.answers.verification.circle_figures import FIGURES, subtract_centre

_IN_A_ROW = 3
_OUTER, _NOMINAL = 82.0, 51.0  # radii: of the outermost ring, of the nominal circle
_HEAD, _TITLE_ROOM, _AROUND, _LINE = 16.0, 14.0, 14.0, 10.5
_MOST_RINGS = 2.5  # on either side of the nominal circle
_LEAST_UM = 1e-3  # of a largest deviation, so that there is a scale
_SENSES = (("counterclockwise", Colour.SECOND), ("clockwise", Colour.THIRD))

Sectors = Float64[np.ndarray, " s"]


# Of a circle: `heading`; `ring` of the scale; `description` of the whole figure.
ENGLISH = {
    "description": "Circles in motion: radial deviation about the nominal circle, "
    "exaggerated",
    "heading": "{plane}, diameter {diameter} mm, {feed} mm/min",
    "counterclockwise": "counterclockwise",
    "clockwise": "clockwise",
    "predicted": "predicted",
    "ring": "ring to ring {step} µm",
}


def name_figure(figure: str, words: Mapping[str, str]) -> str:
    """G of one sense with its sense."""
    letter, _, of = figure.partition("_")
    is_sense = of in ("counterclockwise", "clockwise")
    return f"{letter} {words[of] if is_sense else of}".strip()


def draw_polar_circles(
    circles: Sequence[Mapping[str, Any]],
    words: Mapping[str, str],
    mark: Callable[[str], str] = str,
) -> Markup:
    """One figure of all circles that have a fitted centre.

    circles : `circles_in_motion` of `verification.json`; empty where none has one
    words : as `ENGLISH`; mark : writes the numbers of a text in their language
    """
    drawable = [one for one in circles if one.get("centre_um")]
    if not drawable:
        return Markup()
    lines = max(len(one["figures_um"]) for one in drawable)
    cell = _TITLE_ROOM + 2.0 * (_OUTER + _AROUND) + _LINE * (lines + 1) + 12.0
    columns = min(len(drawable), _IN_A_ROW)
    keys = (
        (Colour.SECOND, "counterclockwise", 1.3, ""),
        (Colour.THIRD, "clockwise", 1.3, ""),
        (Colour.ACCENT, "predicted", 0.7, "2 1.6"),
    )
    parts: list[Markup] = []
    for k, (colour, name, width, dash) in enumerate(keys):
        ends = (6.0 + 150.0 * k, 6.0), (24.0 + 150.0 * k, 6.0)
        parts.append(draw_segments(*ends, colour, width=width, dash=dash))
        text = words[name]
        parts.append(draw_label(29.0 + 150.0 * k, 8.7, text, colour=Colour.INK))
    for number, one in enumerate(drawable):
        row, column = divmod(number, columns)
        middle = WIDTH * (column + 0.5) / columns
        parts += _draw_circle(one, middle, _HEAD + row * cell, words, mark)
    rows = math.ceil(len(drawable) / columns)
    return draw_image(_HEAD + rows * cell, words["description"], parts)


def _draw_circle(
    one: Mapping[str, Any],
    x: float,
    top: float,
    words: Mapping[str, str],
    mark: Callable[[str], str],
) -> Iterator[Markup]:
    measured = _centre(one["radial_um"], one["centre_um"]["measured"])
    predicted = _centre(one["predicted_radial_um"], one["centre_um"]["predicted"])
    curves = [*measured.values(), *predicted.values()]
    largest = max(_LEAST_UM, *(float(np.abs(curve).max()) for curve in curves))
    step_um = round_up(largest / _MOST_RINGS)
    rings = math.ceil(largest / step_um - 1e-9)
    y = top + _TITLE_ROOM + _AROUND + _OUTER
    heading = words["heading"].format(
        plane=one["plane"],
        diameter=f"{one['diameter_mm']:g}",
        feed=f"{one['feed_mm_min']:g}",
    )
    ink = Colour.INK
    at = x, top + 9.0
    yield draw_label(*at, mark(heading), size=TITLE, colour=ink, anchor="middle")

    def get_radius(deviation_um: Sectors) -> Sectors:
        share = deviation_um / (step_um * rings)
        return _NOMINAL + (_OUTER - _NOMINAL) * share

    at_um = step_um * np.arange(-rings, rings + 1)
    radii = get_radius(at_um).tolist()
    numbers = Scale(at_um[0], at_um[-1], 0.0, 1.0).format_ticks(at_um)
    reach = _OUTER + 4.0
    cross = [(x - reach, y), (x, y + reach)], [(x + reach, y), (x, y - reach)]
    outer = [_make_ring(x, y, radius) for radius in radii if radius != _NOMINAL]
    yield draw_segments(*cross, Colour.RULE, width=0.5)
    yield draw_strokes(outer, Colour.RULE, width=0.5)
    yield draw_strokes([_make_ring(x, y, _NOMINAL)], Colour.MUTED, width=0.8)
    for radius, text in zip(radii, numbers, strict=True):
        yield draw_label(x + 1.5, y - radius - 1.0, mark(text), size=6.0)
    first, second = (f"+{axis}" for axis in one["plane"][:2])
    yield draw_label(x + reach + 2.0, y + 2.5, first, size=NUMBER)
    yield draw_label(x, y - reach - 3.0, second, size=NUMBER, anchor="end")

    angle = np.radians(np.array(one["angle_deg"]))
    shapes = [(curve, Colour.ACCENT, 0.7, "2 1.6") for curve in predicted.values()]
    shapes += [
        (measured[sense], colour, 1.3, "")
        for sense, colour in _SENSES
        if sense in measured
    ]
    for curve, colour, width, dash in shapes:
        out = get_radius(curve)
        along = zip(x + out * np.cos(angle), y - out * np.sin(angle), strict=True)
        points = "L".join(f"{a:.2f} {b:.2f}" for a, b in along)
        yield draw_strokes([f"M{points}Z"], colour, width=width, dash=dash)

    value, sigma = one["figures_um"], one["uncertainty_um"]
    texts = [words["ring"].format(step=f"{step_um:g}")]
    for figure in FIGURES:
        if figure in value:
            number = format_expanded(value[figure], sigma[figure])
            texts.append(f"{name_figure(figure, words)} {number} µm")
    below = y + _OUTER + _AROUND + 2.0
    for number, text in enumerate(texts):
        colour = Colour.INK if number else Colour.MUTED
        at = x, below + number * _LINE
        yield draw_label(*at, mark(text), colour=colour, anchor="middle")


def _centre(
    radial_um: Mapping[str, Sequence[float]], centre_um: Sequence[float]
) -> dict[str, Sectors]:
    centre = np.array(centre_um)[:, None]
    return {
        sense: subtract_centre(np.array(values)[:, None], centre)[:, 0]
        for sense, values in radial_um.items()
    }


def _make_ring(x: float, y: float, radius: float) -> str:
    arc = f"a{radius:.2f} {radius:.2f} 0 1 1"
    return f"M{x - radius:.2f} {y:.2f}{arc} {2 * radius:.2f} 0{arc} {-2 * radius:.2f} 0"
