"""The six error motions of an axis in one figure, a panel each."""

from __future__ import annotations

from collections.abc import Callable

from markupsafe import Markup

from app.kinematics.machine import Axis, position_unit
from app.kinematics.symbols import describe_symbol, list_error_motions
from app.reporting.chart import Frame
from app.reporting.svg import WIDTH, draw_image

TOP, LEFT, EDGE = 16.0, 36.0, 7.0  # free above, left and right of the panels
SIGN = {"um": "µm", "urad": "µrad"}
_GAP = 40.0
_PANEL_HEIGHT, _ROW_HEIGHT = 116.0, 146.0
_BELOW = 28.0  # for the numbers and the name of the axis


def draw_panels(
    axis: Axis, title: str, draw_motion: Callable[[Frame, str, str], Markup]
) -> Markup:
    """Return the figure; the name of the axis stands below the lower panels.

    draw_motion : draws an error motion, by its symbol, into a frame; its last argument
        is the text below the frame
    """
    name = f"{axis.name}, {position_unit(axis)}"
    parts: list[Markup] = []
    for i, symbol in enumerate(list_error_motions(axis.name)):
        frame = make_panel(*divmod(i, 3), _PANEL_HEIGHT, _ROW_HEIGHT)
        parts.append(frame.write_title(f"{symbol}  {describe_symbol(symbol)}"))
        parts.append(draw_motion(frame, symbol, name if i >= 3 else ""))
    return draw_image(TOP + _ROW_HEIGHT + _PANEL_HEIGHT + _BELOW, title, parts)


def make_panel(row: int, column: int, height: float, row_height: float) -> Frame:
    """Return the frame of a panel; three stand side by side."""
    width = (WIDTH - LEFT - 2 * _GAP - EDGE) / 3
    left, top = LEFT + column * (width + _GAP), TOP + row * row_height
    return Frame(left, top, left + width, top + height)
