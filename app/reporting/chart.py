"""A chart: two scales, their ticks on round numbers, a grid and a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.reporting.svg import NUMBER, TITLE, Colour, segments, strokes, words

_MARGIN = 0.05  # of the span of the data, beyond either end
_DIGIT = 4.2  # width of a digit in the type of the numbers
_FEWEST_DECADES = 4  # below it 2 and 5 are named between the powers of ten


@dataclass(frozen=True, slots=True)
class Scale:
    """Numbers from `low` to `high` on places from `begin` to `end`, or their logs."""

    low: float
    high: float
    begin: float
    end: float
    logarithmic: bool = False

    def at(self, value: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Return the places of numbers."""
        low, high = self.low, self.high
        if self.logarithmic:
            low, high, value = math.log10(low), math.log10(high), np.log10(value)
        return self.begin + (value - low) / (high - low) * (self.end - self.begin)

    def ticks(self, spacing: float) -> Float64[np.ndarray, " t"]:
        """Return round numbers that stand at least `spacing` apart."""
        if self.logarithmic:
            return self._decades()
        room = max(1.0, abs(self.end - self.begin) / spacing)
        step = round_up((self.high - self.low) / room)
        first, last = math.ceil(self.low / step - 1e-9), self.high / step + 1e-9
        return step * np.arange(first, math.floor(last) + 1)

    def named(self, ticks: Float64[np.ndarray, " t"]) -> list[str]:
        """Return ticks as text with a true minus sign, to one place unless by logs."""
        digits = 0
        while digits < 6 and not np.allclose(ticks, np.round(ticks, digits), rtol=1e-6):
            digits += 1
        form = "g" if self.logarithmic else f"z,.{digits}f"
        return [format(tick, form).replace("-", "−") for tick in ticks.tolist()]

    def _decades(self) -> Float64[np.ndarray, " t"]:
        low, high = math.log10(self.low), math.log10(self.high)
        powers = 10.0 ** np.arange(math.floor(low), math.ceil(high) + 1)
        if high - low < _FEWEST_DECADES:
            powers = np.ravel(powers[:, None] * np.array([1.0, 2.0, 5.0]))
        inside = (powers >= self.low * 0.999) & (powers <= self.high * 1.001)
        return powers[inside]


@dataclass(frozen=True, slots=True)
class Frame:
    """Where a chart stands in its figure."""

    left: float
    top: float
    right: float
    bottom: float

    def across(
        self, low: float, high: float, *, margin: float = 0.0, logarithmic: bool = False
    ) -> Scale:
        """Return the scale of the horizontal axis."""
        low, high = _wider(low, high, margin)
        return Scale(low, high, self.left, self.right, logarithmic)

    def up(self, low: float, high: float, *, margin: float = _MARGIN) -> Scale:
        """Return the scale of the vertical axis."""
        low, high = _wider(low, high, margin)
        return Scale(low, high, self.bottom, self.top)

    def title(self, text: str) -> str:
        """Return the title above the frame."""
        return words(self.left, self.top - 5.0, text, size=TITLE, colour=Colour.INK)

    def drawn(
        self, x: Scale, y: Scale, x_label: str, y_label: str, *, upright: bool = True
    ) -> str:
        """Return grid, axes, numbers and labels.

        upright : draw the grid's vertical lines as well
        """
        x_ticks, y_ticks = x.ticks(34.0), y.ticks(18.0)
        x_at, y_at = x.at(x_ticks), y.at(y_ticks)
        numbers = y.named(y_ticks)
        widest = max(map(len, numbers), default=0)
        middle = 0.5 * (self.top + self.bottom)
        aside = self.left - 9.0 - _DIGIT * widest
        return "".join(
            [
                _ruled(x_at, self.bottom, self.top, rows=False) if upright else "",
                _ruled(y_at, self.left, self.right, rows=True),
                self._axes(x_at),
                *(
                    words(at, self.bottom + 10.5, text, size=NUMBER, anchor="middle")
                    for at, text in zip(x_at.tolist(), x.named(x_ticks), strict=True)
                ),
                *(
                    words(self.left - 4.0, at + 2.5, text, size=NUMBER, anchor="end")
                    for at, text in zip(y_at.tolist(), numbers, strict=True)
                ),
                self._below(x_label),
                words(aside, middle, y_label, anchor="middle", upright=False),
            ]
        )

    def empty(self, text: str) -> str:
        """Return a dashed frame that says why there is nothing in it."""
        edge = (
            f"M{self.left:g} {self.top:g}H{self.right:g}V{self.bottom:g}H{self.left:g}Z"
        )
        x, y = 0.5 * (self.left + self.right), 0.5 * (self.top + self.bottom)
        lines = text.split("\n")
        first = y + 2.5 - 5.5 * (len(lines) - 1)
        return strokes([edge], Colour.MUTED, width=0.6, dash="2 2") + "".join(
            words(x, first + 11.0 * i, line, anchor="middle")
            for i, line in enumerate(lines)
        )

    def _axes(self, x_at: Float64[np.ndarray, " t"]) -> str:
        corner = f"M{self.left:g} {self.top:g}V{self.bottom:g}H{self.right:g}"
        marks = [f"M{at:.2f} {self.bottom:g}v2.5" for at in x_at.tolist()]
        return strokes([corner, *marks], Colour.MUTED, width=0.6)

    def _below(self, label: str) -> str:
        if not label:
            return ""
        x = 0.5 * (self.left + self.right)
        return words(x, self.bottom + 22.0, label, anchor="middle")


def round_up(number: float) -> float:
    """Return the next number with a leading digit of 1, 2 or 5."""
    power = 10.0 ** math.floor(math.log10(number))
    return power * next(d for d in (1, 2, 5, 10) if d * power >= number * 0.999)


def round_down(number: float) -> float:
    """Return the last number before it with a leading digit of 1, 2 or 5."""
    power = 10.0 ** math.floor(math.log10(number))
    return power * max(d for d in (1, 2, 5) if d * power <= number * 1.001)


def _wider(low: float, high: float, margin: float) -> tuple[float, float]:
    span = high - low
    if span <= 0.0:  # all data at one number
        return low - 0.5, high + 0.5
    return low - margin * span, high + margin * span


def _ruled(
    at: Float64[np.ndarray, " t"], begin: float, end: float, *, rows: bool
) -> str:
    """Return the lines of a grid, one at each place, from `begin` to `end`."""
    first, last = (
        np.column_stack([np.full(len(at), edge), at][:: 1 if rows else -1])
        for edge in (begin, end)
    )
    return segments(first, last, Colour.RULE, width=0.5)
