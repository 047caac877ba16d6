"""Charts as inline SVG: shapes, scales with round ticks, frames, panels.

A figure takes its colours and type from the page: one is right on light and dark pages
and on paper. Text stays text. A report has few shapes; drawn straight they cost
milliseconds, where a plotting library costs more than the analysis of the measurement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup
from numpy.typing import ArrayLike

from truepath.answers.shown.page import ENVIRONMENT
from truepath.kinematics.machine.machine import Axis, position_unit
from truepath.kinematics.machine.symbols import describe_symbol, list_error_motions

WIDTH = 662.0  # of a figure as wide as the page, in its own units
_SHAPES = ENVIRONMENT.get_template("shapes.svg").module
TITLE, LABEL, NUMBER = 8.5, 7.5, 7.0  # sizes of type
TOP, LEFT, EDGE = 16.0, 36.0, 7.0  # free above, left and right of the panels
_GAP = 40.0
_PANEL_HEIGHT, _ROW_HEIGHT = 116.0, 146.0
_BELOW = 28.0  # for the numbers and the name of the axis
_MARGIN = 0.05  # of the span of the data, beyond either end
_DIGIT = 4.2  # width of a digit in the type of the numbers
_FEWEST_DECADES = 4  # below it ticks at 2 and 5 as well


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
) -> Markup:
    """Open polyline, in units of the figure."""
    return draw_strokes([f"M{_through(x, y)}"], colour, width=width)


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


def draw_label(
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


@dataclass(frozen=True, slots=True)
class Scale:
    """A linear or logarithmic map of `low` … `high` to `begin` … `end` of a figure.

    names : of the only numbers it has, where they stand for classes
    decimal_mark : of the numbers at its ticks
    """

    low: float
    high: float
    begin: float
    end: float
    logarithmic: bool = False
    names: Mapping[float, str] | None = None
    decimal_mark: str = "."

    def place(self, value: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Numbers to coordinates of the figure."""
        low, high = self.low, self.high
        if self.logarithmic:
            low, high, value = math.log10(low), math.log10(high), np.log10(value)
        return self.begin + (value - low) / (high - low) * (self.end - self.begin)

    def compute_ticks(self, spacing: float) -> Float64[np.ndarray, " t"]:
        """Round numbers, at least `spacing` apart in the figure, or the classes."""
        if self.names:
            return np.array(sorted(self.names))
        if self.logarithmic:
            return self._list_decades()
        room = max(1.0, abs(self.end - self.begin) / spacing)
        step = round_up((self.high - self.low) / room)
        first, last = math.ceil(self.low / step - 1e-9), self.high / step + 1e-9
        return step * np.arange(first, math.floor(last) + 1)

    def format_ticks(self, ticks: Float64[np.ndarray, " t"]) -> list[str]:
        """Texts with a true minus sign, with equal decimals if linear."""
        if self.names:
            return [self.names[tick] for tick in ticks.tolist()]
        digits = 0
        while digits < 6 and not np.allclose(ticks, np.round(ticks, digits), rtol=1e-6):
            digits += 1
        form = "g" if self.logarithmic else f"z,.{digits}f"
        signs = str.maketrans({"-": "−", ".": self.decimal_mark})
        return [format(tick, form).translate(signs) for tick in ticks.tolist()]

    def _list_decades(self) -> Float64[np.ndarray, " t"]:
        low, high = math.log10(self.low), math.log10(self.high)
        powers = 10.0 ** np.arange(math.floor(low), math.ceil(high) + 1)
        if high - low < _FEWEST_DECADES:
            powers = np.ravel(powers[:, None] * np.array([1.0, 2.0, 5.0]))
        inside = (powers >= self.low * 0.999) & (powers <= self.high * 1.001)
        return powers[inside]


@dataclass(frozen=True, slots=True)
class Frame:
    """Rectangle of a chart in its figure."""

    left: float
    top: float
    right: float
    bottom: float

    def make_x(
        self, low: float, high: float, *, margin: float = 0.0, logarithmic: bool = False
    ) -> Scale:
        """Left to right; margin : of the span, beyond either end"""
        low, high = _widen(low, high, margin)
        return Scale(low, high, self.left, self.right, logarithmic)

    def make_y(self, low: float, high: float, *, margin: float = _MARGIN) -> Scale:
        """Bottom to top; margin : of the span, beyond either end"""
        low, high = _widen(low, high, margin)
        return Scale(low, high, self.bottom, self.top)

    def draw_title(self, text: str) -> Markup:
        """Above the frame, at its left."""
        return draw_label(
            self.left, self.top - 5.0, text, size=TITLE, colour=Colour.INK
        )

    def draw_axes(
        self, x: Scale, y: Scale, x_label: str, y_label: str, *, upright: bool = True
    ) -> Markup:
        """Grid, axes, numbers and labels.

        upright : draw the grid's vertical lines as well
        """
        x_ticks, y_ticks = x.compute_ticks(34.0), y.compute_ticks(18.0)
        x_at, y_at = x.place(x_ticks), y.place(y_ticks)
        x_texts, y_texts = x.format_ticks(x_ticks), y.format_ticks(y_ticks)
        corner = f"M{self.left:g} {self.top:g}V{self.bottom:g}H{self.right:g}"
        marks = [f"M{at:.2f} {self.bottom:g}v2.5" for at in x_at.tolist()]
        parts = [_draw_grid(x_at, self.bottom, self.top, rows=False)] * upright
        parts += [
            _draw_grid(y_at, self.left, self.right, rows=True),
            draw_strokes([corner, *marks], Colour.MUTED, width=0.6),
        ]
        for at, text in zip(x_at.tolist(), x_texts, strict=True):
            below = self.bottom + 10.5
            parts.append(draw_label(at, below, text, size=NUMBER, anchor="middle"))
        for at, text in zip(y_at.tolist(), y_texts, strict=True):
            aside = self.left - 4.0
            parts.append(draw_label(aside, at + 2.5, text, size=NUMBER, anchor="end"))
        if x_label:
            x_mid = 0.5 * (self.left + self.right)
            below = self.bottom + 22.0
            parts.append(draw_label(x_mid, below, x_label, anchor="middle"))
        aside = self.left - 9.0 - _DIGIT * max(map(len, y_texts), default=0)
        y_mid = 0.5 * (self.top + self.bottom)
        label = draw_label(aside, y_mid, y_label, anchor="middle", upright=False)
        return join_shapes([*parts, label])

    def draw_level(
        self, y: Scale, value: float, colour: str, *, width: float, dash: str = ""
    ) -> Markup:
        """A horizontal line over the whole width."""
        at = float(y.place(np.array([value]))[0])
        ends = (self.left, at), (self.right, at)
        return draw_segments(*ends, colour, width=width, dash=dash)

    def draw_empty(self, text: str) -> Markup:
        """A dashed frame with a text that says why it is empty."""
        edge = (
            f"M{self.left:g} {self.top:g}H{self.right:g}V{self.bottom:g}H{self.left:g}Z"
        )
        x, y = 0.5 * (self.left + self.right), 0.5 * (self.top + self.bottom)
        lines = text.split("\n")
        first = y + 2.5 - 5.5 * (len(lines) - 1)
        return draw_strokes([edge], Colour.MUTED, width=0.6, dash="2 2") + join_shapes(
            draw_label(x, first + 11.0 * i, line, anchor="middle")
            for i, line in enumerate(lines)
        )


def round_up(number: float) -> float:
    """The next number with a leading digit of 1, 2 or 5."""
    power = 10.0 ** math.floor(math.log10(number))
    return power * next(d for d in (1, 2, 5, 10) if d * power >= number * 0.999)


def round_down(number: float) -> float:
    """The last number not above it with a leading digit of 1, 2 or 5."""
    power = 10.0 ** math.floor(math.log10(number))
    return power * max(d for d in (1, 2, 5) if d * power <= number * 1.001)


def _widen(low: float, high: float, margin: float) -> tuple[float, float]:
    span = high - low
    if span <= 0.0:  # all data at one number
        return low - 0.5, high + 0.5
    return low - margin * span, high + margin * span


def _draw_grid(
    at: Float64[np.ndarray, " t"], begin: float, end: float, *, rows: bool
) -> Markup:
    first, last = (
        np.column_stack([np.full(len(at), edge), at][:: 1 if rows else -1])
        for edge in (begin, end)
    )
    return draw_segments(first, last, Colour.RULE, width=0.5)


def draw_panels(
    axis: Axis,
    title: str,
    draw_motion: Callable[[Frame, str, str], Markup],
    name_motion: Callable[[str], str] = describe_symbol,
) -> Markup:
    """Six panels, one per error motion; the name of the axis is below the lower ones.

    draw_motion : draws an error motion, by its symbol, into a frame; its last argument
        is the text below the frame
    name_motion : words of a symbol, in the language of the title
    """
    name = f"{axis.name}, {position_unit(axis)}"
    parts: list[Markup] = []
    for i, symbol in enumerate(list_error_motions(axis.name)):
        frame = make_panel(*divmod(i, 3), _PANEL_HEIGHT, _ROW_HEIGHT)
        parts.append(frame.draw_title(f"{symbol}  {name_motion(symbol)}"))
        parts.append(draw_motion(frame, symbol, name if i >= 3 else ""))
    return draw_image(TOP + _ROW_HEIGHT + _PANEL_HEIGHT + _BELOW, title, parts)


def make_panel(row: int, column: int, height: float, row_height: float) -> Frame:
    """One of three panels side by side."""
    width = (WIDTH - LEFT - 2 * _GAP - EDGE) / 3
    left, top = LEFT + column * (width + _GAP), TOP + row * row_height
    return Frame(left, top, left + width, top + height)
