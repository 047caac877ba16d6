"""The figures of the report about error motions and residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup

from truepath.answers.shown.chart import EDGE, LEFT, TOP, Frame, draw_panels
from truepath.answers.shown.number_format import SIGN
from truepath.answers.shown.svg import (
    WIDTH,
    Colour,
    draw_curve,
    draw_image,
    draw_segments,
    fill_band,
    join_shapes,
    write_label,
)
from truepath.files.units import UM_PER_MM
from truepath.kinematics.machine.machine import Axis
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.kinematics.model import EstimatedModel
from truepath.results.error_tables import ErrorTable, build_error_table
from truepath.results.result_summary import RunFindings

_COVERAGE = 2.0  # k of expanded uncertainties
_BAND = 0.22
_STATES = (Colour.ACCENT, Colour.SECOND)  # as found, as left
_DRAWN = 121  # positions of a curve
_BINS = 41


@dataclass(frozen=True, slots=True)
class MotionWords:
    """Texts of a figure of error motions.

    title : with `axis`; unknown : of a motion that was not determined
    """

    title: str = "Error motions of axis {axis} over its travel"
    unknown: str = "not observable\nwith the measured target"
    name_motion: Callable[[str], str] = describe_symbol
    decimal_mark: str = "."


def draw_error_motions(
    states: Sequence[EstimatedModel], axis: Axis, words: MotionWords | None = None
) -> Markup:
    """The six error motions of an axis, each with its band of ±U (k = 2).

    states : of one machine, as found and as left
    """
    words = words or MotionWords()

    def draw(frame: Frame, symbol: str, name: str) -> Markup:
        tables = [_make_fine_table(one, symbol) for one in states]
        known = [
            (table, colour)
            for table, colour in zip(tables, _STATES, strict=False)
            if table is not None
        ]
        if not known:
            return frame.draw_empty(words.unknown)
        return _draw_motion(frame, known, name, words.decimal_mark)

    title = words.title.format(axis=axis.name)
    return draw_panels(axis, title, draw, words.name_motion)


def draw_residuals(run: RunFindings) -> Markup:
    """RMS of each line with the noise level, and the distribution of residuals."""
    left = Frame(LEFT, TOP, 436.0, 152.0)
    right = Frame(486.0, TOP, WIDTH - EDGE, 152.0)
    return draw_image(
        180.0,
        "Residuals by line, and the distribution of their components",
        [_draw_by_line(left, run), _draw_histogram(right, run)],
    )


def draw_legend(
    frame: Frame, entries: tuple[tuple[str, str], ...], *, from_right: float = 0.0
) -> Markup:
    """Names of curves, at the upper left or at a distance from the right."""
    x = frame.right - from_right if from_right else frame.left + 6.0
    rows = [(frame.top + 7.0 + 11.0 * i, *entry) for i, entry in enumerate(entries)]
    return join_shapes(
        draw_segments((x, y), (x + 14.0, y), colour, width=1.4)
        + write_label(x + 19.0, y + 2.7, label, colour=Colour.INK)
        for y, colour, label in rows
    )


def _make_fine_table(estimated: EstimatedModel, symbol: str) -> ErrorTable | None:
    motions = {m.symbol: m for m in estimated.model.identifiable_motions}
    if symbol not in motions:
        return None
    axis = motions[symbol].axis
    at_mm = np.linspace(axis.low, axis.high, _DRAWN)
    return build_error_table(estimated, motions[symbol], at_mm)


def _draw_motion(
    frame: Frame, states: Sequence[tuple[ErrorTable, str]], name: str, mark: str
) -> Markup:
    first = states[0][0]
    travel = first.position_mm
    bands = [
        (table.value - half, table.value + half)
        for table, _ in states
        for half in (_COVERAGE * table.uncertainty,)
    ]
    low = min(float(below.min()) for below, _ in bands)
    high = max(float(above.max()) for _, above in bands)
    x = frame.make_x(float(travel[0]), float(travel[-1]), margin=0.01)
    y = replace(frame.make_y(min(0.0, low), max(0.0, high)), decimal_mark=mark)
    at = x.place(travel)
    shapes = [
        frame.draw_axes(x, y, name, SIGN[first.unit]),
        frame.draw_level(y, 0.0, Colour.MUTED, width=0.6),
    ]
    for (table, colour), (below, above) in zip(states, bands, strict=True):
        shapes += [
            fill_band(at, y.place(below), y.place(above), colour, opacity=_BAND),
            draw_curve(at, y.place(table.value), colour),
        ]
    return join_shapes(shapes)


def _draw_by_line(frame: Frame, run: RunFindings) -> Markup:
    lines, floor = run.by_line, UM_PER_MM * run.estimate.residuals.floor_mm
    otf = run.summary.mode == "otf"
    row = lines.row.astype(np.float64) + 1.0
    x = frame.make_x(float(row.min()), float(row.max()), margin=0.03)
    y = frame.make_y(0.0, 1.05 * max(float(lines.rms_um.max()), floor), margin=0.0)
    at = x.place(row)
    foot = np.column_stack([at, np.full(len(row), frame.bottom)])
    top = np.column_stack([at, y.place(lines.rms_um)])
    width = float(np.clip(250.0 / len(row), 0.3, 2.0))
    name, rows = ("line", "path") if otf else ("point", "points")
    return join_shapes(
        [
            frame.write_title(f"Residual by {name} (dashed: what noise alone leaves)"),
            frame.draw_axes(x, y, f"row of the {rows}", "rms, µm", upright=False),
            draw_segments(foot, top, Colour.ACCENT, width=width),
            frame.draw_level(y, floor, Colour.SECOND, width=1.0, dash="4 2"),
        ]
    )


def _draw_histogram(frame: Frame, run: RunFindings) -> Markup:
    residual = UM_PER_MM * run.estimate.residuals.residual_mm
    reach = max(3.0 * float(np.std(residual)), 1e-3)
    edge = np.linspace(-reach, reach, _BINS + 1)
    share = [np.histogram(component, edge)[0] for component in residual.T]
    x = frame.make_x(-reach, reach, margin=0.02)
    y = frame.make_y(
        0.0, 105.0 * max(s.max() for s in share) / len(residual), margin=0.0
    )
    entries = (
        (Colour.ACCENT, "beam"),
        (Colour.SECOND, "azimuth"),
        (Colour.THIRD, "elevation"),
    )
    across = np.repeat(x.place(edge), 2)
    steps = [
        draw_curve(
            across,
            y.place(np.pad(np.repeat(part, 2), 1) * 100.0 / len(residual)),
            colour,
            width=1.0,
        )
        for part, (colour, _) in zip(share, entries, strict=True)
    ]
    return join_shapes(
        [
            frame.write_title("Distribution of cells"),
            frame.draw_axes(x, y, "residual, µm", "share, %"),
            *steps,
            draw_legend(frame, entries, from_right=56.0),
        ]
    )
