"""Shapes of a figure as inline SVG that takes its colours and type from the page.

One figure is right on light and dark pages and on paper. Text stays text. A report has
few shapes; drawn straight they cost milliseconds, where a plotting library costs more
than the analysis of the measurement.
"""

from __future__ import annotations

import html
from collections.abc import Iterable
from enum import StrEnum

import numpy as np
from jaxtyping import Float64

WIDTH = 662.0  # of a figure as wide as the page, in its own units
TITLE, LABEL, NUMBER = 8.5, 7.5, 7.0  # sizes of type


class Colour(StrEnum):
    """Colours of the page's style sheet."""

    INK = "var(--ink)"
    MUTED = "var(--muted)"
    RULE = "var(--rule)"
    ACCENT = "var(--accent)"
    SECOND = "var(--second)"
    THIRD = "var(--third)"


def image(height: float, description: str, parts: Iterable[str]) -> str:
    """Return a figure as wide as the page, described for those who cannot see it."""
    label = html.escape(description, quote=True)
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{label}">'
        f"{''.join(parts)}</svg>"
    )


def curve(
    x: Float64[np.ndarray, " n"],
    y: Float64[np.ndarray, " n"],
    colour: str,
    *,
    width: float = 1.4,
    opacity: float = 1.0,
) -> str:
    """Return a line through points."""
    return strokes([f"M{_through(x, y)}"], colour, width=width, opacity=opacity)


def segments(
    begin: Float64[np.ndarray, "n 2"],
    end: Float64[np.ndarray, "n 2"],
    colour: str,
    *,
    width: float,
    opacity: float = 1.0,
    dash: str = "",
) -> str:
    """Return many straight lines of one colour as one shape."""
    pairs = np.hstack([begin, end]).tolist()
    moves = [f"M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}" for a, b, c, d in pairs]
    return strokes(moves, colour, width=width, opacity=opacity, dash=dash)


def strokes(
    moves: Iterable[str],
    colour: str,
    *,
    width: float,
    opacity: float = 1.0,
    dash: str = "",
) -> str:
    """Return drawn lines; `moves` are path data."""
    style = f"fill:none;stroke:{colour};stroke-width:{width:g}"
    if opacity < 1.0:
        style += f";stroke-opacity:{opacity:g}"
    if dash:
        style += f";stroke-dasharray:{dash}"
    return f'<path d="{"".join(moves)}" style="{style}"/>'


def band(
    x: Float64[np.ndarray, " n"],
    low: Float64[np.ndarray, " n"],
    high: Float64[np.ndarray, " n"],
    colour: str,
    *,
    opacity: float,
) -> str:
    """Return the area between two curves."""
    around = _through(np.r_[x, x[::-1]], np.r_[low, high[::-1]])
    style = f"fill:{colour};fill-opacity:{opacity:g}"
    return f'<path d="M{around}Z" style="{style}"/>'


def box(x: float, y: float, width: float, height: float, colour: str) -> str:
    """Return a filled rectangle."""
    return (
        f'<rect x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" '
        f'style="fill:{colour};shape-rendering:crispEdges"/>'
    )


def words(
    x: float,
    y: float,
    text: str,
    *,
    size: float = LABEL,
    colour: str = Colour.MUTED,
    anchor: str = "start",
    upright: bool = True,
) -> str:
    """Return a line of text whose base line begins, is centred or ends at a place."""
    turn = "" if upright else f' transform="rotate(-90 {x:.2f} {y:.2f})"'
    style = f"font-size:{size:g}px;fill:{colour};text-anchor:{anchor}"
    place = f'x="{x:.2f}" y="{y:.2f}"{turn}'
    return f'<text {place} style="{style}">{html.escape(text)}</text>'


def _through(x: Float64[np.ndarray, " n"], y: Float64[np.ndarray, " n"]) -> str:
    places = np.column_stack([x, y]).tolist()
    return "L".join(f"{a:.2f} {b:.2f}" for a, b in places)
