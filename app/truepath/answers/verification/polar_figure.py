"""Circles of ISO 230-4 as polar charts: the radial deviation, far exaggerated.

Out of the document of a verification, `circles_in_motion`, so that report and
certificate show the same numbers. What is drawn is about the centre of least squares,
as the figures are; run-in and run-out are no part of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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
    join_shapes,
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


@dataclass(frozen=True, slots=True)
class PolarWords:
    """Texts of the figure.

    heading : of a circle, with `plane`, `diameter` and `feed`; ring : with `step`
    mark : writes the numbers of a text in its language
    """

    description: str
    heading: str
    counterclockwise: str
    clockwise: str
    predicted: str
    ring: str
    mark: Callable[[str], str] = str

    def name(self, figure: str) -> str:
        """G of one sense with its sense."""
        letter, _, of = figure.partition("_")
        senses = {
            "counterclockwise": self.counterclockwise,
            "clockwise": self.clockwise,
        }
        return f"{letter} {senses.get(of, of)}".strip()


ENGLISH = PolarWords(
    "Circles in motion: radial deviation about the nominal circle, exaggerated",
    "{plane}, diameter {diameter} mm, {feed} mm/min",
    "counterclockwise",
    "clockwise",
    "predicted",
    "ring to ring {step} µm",
)


def draw_polar_circles(
    circles: Sequence[Mapping[str, Any]], words: PolarWords
) -> Markup:
    """One figure of all circles that have a fitted centre.

    circles : `circles_in_motion` of `verification.json`; empty where none has one
    """
    drawable = [one for one in circles if one.get("centre_um")]
    if not drawable:
        return Markup()
    lines = max(len(one["figures_um"]) for one in drawable)
    cell = _TITLE_ROOM + 2.0 * (_OUTER + _AROUND) + _LINE * (lines + 1) + 12.0
    columns = min(len(drawable), _IN_A_ROW)
    parts = [_draw_key(words)]
    for number, one in enumerate(drawable):
        row, column = divmod(number, columns)
        middle = WIDTH * (column + 0.5) / columns
        parts.append(_draw_circle(one, middle, _HEAD + row * cell, words))
    rows = math.ceil(len(drawable) / columns)
    return draw_image(_HEAD + rows * cell, words.description, parts)


def _draw_circle(
    one: Mapping[str, Any], middle: float, top: float, words: PolarWords
) -> Markup:
    angle = np.radians(np.array(one["angle_deg"]))
    measured = _centre(one["radial_um"], one["centre_um"]["measured"])
    predicted = _centre(one["predicted_radial_um"], one["centre_um"]["predicted"])
    polar = _Polar.fit([*measured.values(), *predicted.values()])
    centre = np.array([middle, top + _TITLE_ROOM + _AROUND + _OUTER])
    curves = [
        polar.draw_curve(centre, angle, values, Colour.ACCENT, width=0.7, dash="2 1.6")
        for values in predicted.values()
    ]
    curves += [
        polar.draw_curve(centre, angle, measured[sense], colour, width=1.3)
        for sense, colour in _SENSES
        if sense in measured
    ]
    heading = words.heading.format(
        plane=one["plane"],
        diameter=f"{one['diameter_mm']:g}",
        feed=f"{one['feed_mm_min']:g}",
    )
    return join_shapes(
        [
            draw_label(
                middle,
                top + 9.0,
                words.mark(heading),
                size=TITLE,
                colour=Colour.INK,
                anchor="middle",
            ),
            polar.draw_rings(centre, one["plane"], words),
            *curves,
            *_write_figures(one, polar.step_um, centre, words),
        ]
    )


@dataclass(frozen=True, slots=True)
class _Polar:
    step_um: float
    rings: int

    @classmethod
    def fit(cls, curves_um: Sequence[Sectors]) -> _Polar:
        largest = max(_LEAST_UM, *(float(np.abs(one).max()) for one in curves_um))
        step = round_up(largest / _MOST_RINGS)
        return cls(step, math.ceil(largest / step - 1e-9))

    def place(self, deviation_um: Sectors) -> Sectors:
        share = deviation_um / (self.step_um * self.rings)
        return _NOMINAL + (_OUTER - _NOMINAL) * share

    def draw_curve(
        self,
        centre: Sectors,
        angle: Sectors,
        values_um: Sectors,
        colour: str,
        *,
        width: float,
        dash: str = "",
    ) -> Markup:
        out = self.place(values_um)
        x, y = centre[0] + out * np.cos(angle), centre[1] - out * np.sin(angle)
        points = "L".join(f"{a:.2f} {b:.2f}" for a, b in zip(x, y, strict=True))
        return draw_strokes([f"M{points}Z"], colour, width=width, dash=dash)

    def draw_rings(self, centre: Sectors, plane: str, words: PolarWords) -> Markup:
        at_um = self.step_um * np.arange(-self.rings, self.rings + 1)
        radii = self.place(at_um).tolist()
        x, y = centre.tolist()
        numbers = Scale(at_um[0], at_um[-1], 0.0, 1.0).format_ticks(at_um)
        reach = _OUTER + 4.0
        cross = [(x - reach, y), (x, y + reach)], [(x + reach, y), (x, y - reach)]
        outer = [_make_ring(x, y, radius) for radius in radii if radius != _NOMINAL]
        return join_shapes(
            [
                draw_segments(*cross, Colour.RULE, width=0.5),
                draw_strokes(outer, Colour.RULE, width=0.5),
                draw_strokes([_make_ring(x, y, _NOMINAL)], Colour.MUTED, width=0.8),
                *(
                    draw_label(x + 1.5, y - radius - 1.0, words.mark(text), size=6.0)
                    for radius, text in zip(radii, numbers, strict=True)
                ),
                draw_label(x + reach + 2.0, y + 2.5, f"+{plane[0]}", size=NUMBER),
                draw_label(
                    x, y - reach - 3.0, f"+{plane[1]}", size=NUMBER, anchor="end"
                ),
            ]
        )


def _centre(
    radial_um: Mapping[str, Sequence[float]], centre_um: Sequence[float]
) -> dict[str, Sectors]:
    centre = np.array(centre_um)[:, None]
    return {
        sense: subtract_centre(np.array(values)[:, None], centre)[:, 0]
        for sense, values in radial_um.items()
    }


def _write_figures(
    one: Mapping[str, Any], step_um: float, centre: Sectors, words: PolarWords
) -> Iterator[Markup]:
    value, sigma = one["figures_um"], one["uncertainty_um"]
    stated = [
        f"{words.name(figure)} {format_expanded(value[figure], sigma[figure])} µm"
        for figure in FIGURES
        if figure in value
    ]
    x, y = centre.tolist()
    y += _OUTER + _AROUND + 2.0
    for number, text in enumerate([words.ring.format(step=f"{step_um:g}"), *stated]):
        colour = Colour.INK if number else Colour.MUTED
        at = y + number * _LINE
        yield draw_label(x, at, words.mark(text), colour=colour, anchor="middle")


def _draw_key(words: PolarWords) -> Markup:
    entries = [
        (Colour.SECOND, words.counterclockwise, 1.3, ""),
        (Colour.THIRD, words.clockwise, 1.3, ""),
        (Colour.ACCENT, words.predicted, 0.7, "2 1.6"),
    ]
    return join_shapes(
        draw_segments(
            (6.0 + 150.0 * i, 6.0), (24.0 + 150.0 * i, 6.0), c, width=w, dash=d
        )
        + draw_label(29.0 + 150.0 * i, 8.7, text, colour=Colour.INK)
        for i, (c, text, w, d) in enumerate(entries)
    )


def _make_ring(x: float, y: float, radius: float) -> str:
    arc = f"a{radius:.2f} {radius:.2f} 0 1 1"
    return f"M{x - radius:.2f} {y:.2f}{arc} {2 * radius:.2f} 0{arc} {-2 * radius:.2f} 0"
