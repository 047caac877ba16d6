"""Matplotlib figures as inline SVG that takes its colours and type from the page.

Figures are drawn in stand-in colours, which become CSS variables: one figure is right
on light and dark pages and on paper. Text stays text.
"""

# Matplotlib leaves its keyword arguments untyped.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import html
import io
import re
from collections.abc import Generator
from contextlib import contextmanager
from enum import StrEnum

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import RcKeyType


class Colour(StrEnum):
    """Stand-ins for the variables of the page's style sheet."""

    INK = "#010101"
    MUTED = "#010102"
    RULE = "#010103"
    ACCENT = "#010104"
    SECOND = "#010105"
    THIRD = "#010106"


_STYLE: dict[RcKeyType, str | float | bool] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "truepath",  # the same figure has the same identifiers
    "font.size": 8,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 5,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.edgecolor": Colour.MUTED.value,
    "axes.labelcolor": Colour.MUTED.value,
    "axes.titlecolor": Colour.INK.value,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "grid.color": Colour.RULE.value,
    "grid.linewidth": 0.5,
    "xtick.color": Colour.MUTED.value,
    "ytick.color": Colour.MUTED.value,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.size": 2.5,
    "ytick.major.size": 0,
    "xtick.major.width": 0.6,
    "text.color": Colour.INK.value,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.4,
}
_WIDTH_IN = 9.2


@contextmanager
def figure(height_in: float) -> Generator[Figure]:
    """Give a figure as wide as the page, in its style; draw and export inside."""
    with mpl.rc_context(_STYLE):
        yield Figure(figsize=(_WIDTH_IN, height_in), dpi=72, layout="constrained")


def axes_of(drawn: Figure, rows: int, columns: int, **spec: object) -> list[Axes]:
    """Return the axes of a grid, row by row."""
    grid = drawn.subplots(rows, columns, squeeze=False, gridspec_kw=dict(spec))
    return [axes for row in grid for axes in row]


def inline_svg(drawn: Figure, description: str) -> str:
    """Return the figure as an SVG element, described for those who cannot see it."""
    sink = io.StringIO()
    none = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    drawn.savefig(sink, format="svg", metadata=none)
    text = sink.getvalue()
    width, height = 72.0 * drawn.get_size_inches()
    body = text[text.index(">", text.index("<svg")) + 1 :]
    body = re.sub(r"<style.*?</style>", "", body, count=1, flags=re.DOTALL)
    body = re.sub(r' id="(?![mp][0-9a-f]{6})[^"]*"', "", body)
    body = re.sub(r"font(-family)?: ?[^;\"]*sans-serif; ?", "", body)
    for colour in Colour:
        body = body.replace(colour.value, f"var(--{colour.name.lower()})")
    body = re.sub(r"\s*\n\s*", " ", body)
    label = html.escape(description, quote=True)
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{label}" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink">{body}'
    )
