"""The six error motions of an axis in one figure, a panel each."""

from __future__ import annotations

from collections.abc import Callable

from app.kinematics.machine import Axis, position_unit
from app.kinematics.symbols import error_motions, meaning
from app.reporting.chart import Frame
from app.reporting.svg import WIDTH, image

TOP, LEFT, EDGE = 16.0, 36.0, 7.0  # free above, left and right of the panels
SIGN = {"um": "µm", "urad": "µrad"}
_GAP = 40.0
_PANEL_HEIGHT, _ROW_HEIGHT = 116.0, 146.0
_BELOW = 28.0  # for the numbers and the name of the axis

Drawn = Callable[[Frame, str, str], str]
"""Draws an error motion, by its symbol, into a frame; last what to write below it."""


def axis_panels(axis: Axis, title: str, drawn: Drawn) -> str:
    """Return the figure; the name of the axis stands below the lower panels."""
    name = f"{axis.name}, {position_unit(axis)}"
    parts: list[str] = []
    for i, symbol in enumerate(error_motions(axis.name)):
        frame = _panel(*divmod(i, 3))
        parts.append(frame.title(f"{symbol}  {meaning(symbol)}"))
        parts.append(drawn(frame, symbol, name if i >= 3 else ""))
    return image(TOP + _ROW_HEIGHT + _PANEL_HEIGHT + _BELOW, title, parts)


def _panel(row: int, column: int) -> Frame:
    width = (WIDTH - LEFT - 2 * _GAP - EDGE) / 3
    left, top = LEFT + column * (width + _GAP), TOP + row * _ROW_HEIGHT
    return Frame(left, top, left + width, top + _PANEL_HEIGHT)
