"""Shapes of a figure as inline SVG that takes its colours and type from the page.

One figure is right on light and dark pages and on paper. Text stays text. A report has
few shapes; drawn straight they cost milliseconds, where a plotting library costs more
than the analysis of the measurement.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup
from numpy.typing import ArrayLike

from truepath.answers.shown.templating import ENVIRONMENT

WIDTH = 662.0  # of a figure as wide as the page, in its own units
_SHAPES = ENVIRONMENT.get_template("shapes.svg").module
TITLE, LABEL, NUMBER = 8.5, 7.5, 7.0  # sizes of type


class Colour(StrEnum):
    """Colours of the page's style sheet."""

    INK = "var(--ink)"
    MUTED = "var(--muted)"
    RULE = "var(--rule)"
    ACCENT = "var(--accent)"
    SECOND = "var(--second)"
    THIRD = "var(--third)"


def draw_image(height: float, description: str, parts: Iterable[Markup]) -> Markup:
    """As wide as the page; `description` is its accessible name."""
    size = {"width": f"{WIDTH:g}", "height": f"{height:g}"}
    return _shape("image", **size, label=description, shapes=join_shapes(parts))


def join_shapes(parts: Iterable[Markup]) -> Markup:
    """Without separators."""
    return Markup("").join(parts)


def draw_curve(
    x: Float64[np.ndarray, " n"],
    y: Float64[np.ndarray, " n"],
    colour: str,
    *,
    width: float = 1.4,
    opacity: float = 1.0,
) -> Markup:
    """Open polyline, in units of the figure."""
    return draw_strokes([f"M{_through(x, y)}"], colour, width=width, opacity=opacity)


def draw_segments(
    begin: ArrayLike,
    end: ArrayLike,
    colour: str,
    *,
    width: float,
    opacity: float = 1.0,
    dash: str = "",
) -> Markup:
    """Straight lines of one colour as one path.

    begin, end : (n, 2), or (2,) of one line
    """
    pairs = np.hstack([np.atleast_2d(begin), np.atleast_2d(end)]).tolist()
    moves = [f"M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}" for a, b, c, d in pairs]
    return draw_strokes(moves, colour, width=width, opacity=opacity, dash=dash)


def draw_strokes(
    moves: Iterable[str],
    colour: str,
    *,
    width: float,
    opacity: float = 1.0,
    dash: str = "",
) -> Markup:
    """Unfilled path; `moves` are path data."""
    style = f"fill:none;stroke:{colour};stroke-width:{width:g}"
    if opacity < 1.0:
        style += f";stroke-opacity:{opacity:g}"
    if dash:
        style += f";stroke-dasharray:{dash}"
    return _shape("path", data="".join(moves), style=style)


def fill_band(
    x: Float64[np.ndarray, " n"],
    low: Float64[np.ndarray, " n"],
    high: Float64[np.ndarray, " n"],
    colour: str,
    *,
    opacity: float,
) -> Markup:
    """Filled area between two curves over x."""
    around = _through(np.r_[x, x[::-1]], np.r_[low, high[::-1]])
    style = f"fill:{colour};fill-opacity:{opacity:g}"
    return _shape("path", data=f"M{around}Z", style=style)


def fill_box(x: float, y: float, width: float, height: float, colour: str) -> Markup:
    """Without anti-aliased edges, so that adjacent boxes show no seam."""
    at = {"x": f"{x:.2f}", "y": f"{y:.2f}"}
    size = {"width": f"{width:.2f}", "height": f"{height:.2f}"}
    style = f"fill:{colour};shape-rendering:crispEdges"
    return _shape("box", **at, **size, style=style)


def write_label(
    x: float,
    y: float,
    text: str,
    *,
    size: float = LABEL,
    colour: str = Colour.MUTED,
    anchor: str = "start",
    upright: bool = True,
) -> Markup:
    """One line of text; (x, y) is the start, middle or end of its base line."""
    at = {"x": f"{x:.2f}", "y": f"{y:.2f}"}
    style = f"font-size:{size:g}px;fill:{colour};text-anchor:{anchor}"
    return _shape("label", **at, text=text, style=style, upright=upright)


def _shape(macro: str, **values: object) -> Markup:
    return getattr(_SHAPES, macro)(**values)


def _through(x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"]) -> str:
    points = np.column_stack([x, y]).tolist()
    return "L".join(f"{a:.2f} {b:.2f}" for a, b in points)
