"""Figures of error motions, of residuals and of the volumetric error.

The volume is seen from the front, right and above, its errors exaggerated by a round
factor and shaded by their length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.shown.chart import (
    EDGE,
    LEFT,
    NUMBER,
    TITLE,
    TOP,
    WIDTH,
    Colour,
    Frame,
    Scale,
    draw_curve,
    draw_image,
    draw_label,
    draw_panels,
    draw_segments,
    fill_band,
    fill_box,
    join_shapes,
    round_down,
)
from truepath.answers.shown.page import SIGN
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Axis, LinearAxis
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.workspace import add_resting_axes
from truepath.results.error_tables import ErrorTable, build_error_table
from truepath.results.result_summary import Findings, RunFindings

_COVERAGE = 2.0  # k of expanded uncertainties
_BAND = 0.22
_STATES = (Colour.ACCENT, Colour.SECOND)  # as found, as left
_DRAWN = 121  # positions of a curve
_BINS = 41
# Readable on light and on dark paper: blue, violet, orange.
_STOPS, _CHANNELS = [0.0, 0.5, 1.0], ([61, 176, 240], [111, 79, 128], [214, 174, 60])
SHADES = 32
_WHITE, _PALE = 255.0, 0.55
_HEIGHT = 266.0
_SCENE = Frame(14.0, 22.0, 340.0, 212.0)
_CHART = Frame(396.0, 16.0, WIDTH - 7.0, 236.0)


@dataclass(frozen=True, slots=True)
class MotionTexts:
    """Texts of a figure of error motions.

    title : with `axis`; unknown : of a motion that was not determined
    """

    title: str = "Error motions of axis {axis} over its travel"
    unknown: str = "not observable\nwith the measured target"
    name_motion: Callable[[str], str] = describe_symbol
    decimal_mark: str = "."


def draw_error_motions(
    states: Sequence[EstimatedModel], axis: Axis, words: MotionTexts | None = None
) -> Markup:
    """The six error motions of an axis, each with its band of ±U (k = 2).

    states : of one machine, as found and as left
    """
    words = words or MotionTexts()

    def draw(frame: Frame, symbol: str, name: str) -> Markup:
        known: list[tuple[ErrorTable, str]] = []
        for state, colour in zip(states, _STATES, strict=False):
            for motion in state.model.identifiable_motions:
                if motion.symbol == symbol:
                    at_mm = np.linspace(motion.axis.low, motion.axis.high, _DRAWN)
                    known.append((build_error_table(state, motion, at_mm), colour))
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
        + draw_label(x + 19.0, y + 2.7, label, colour=Colour.INK)
        for y, colour, label in rows
    )


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
            frame.draw_title(f"Residual by {name} (dashed: what noise alone leaves)"),
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
            frame.draw_title("Distribution of cells"),
            frame.draw_axes(x, y, "residual, µm", "share, %"),
            *steps,
            draw_legend(frame, entries, from_right=56.0),
        ]
    )


def draw_volume(findings: Findings) -> Markup:
    """The deformed volume, and the distribution of the error before and after."""
    return draw_image(
        _HEIGHT,
        "Left: the working volume with its errors exaggerated. Right: share of the "
        "volume within a given error, before and after compensation",
        [_draw_volume(findings), _draw_distribution(_CHART, findings)],
    )


def project(points_mm: Float64[np.ndarray, "l m 3"]) -> Float64[np.ndarray, "l m 2"]:
    """View from front, right and above; down is positive."""
    x, y, z = np.moveaxis(points_mm, -1, 0)
    return np.stack([0.88 * x + 0.47 * y, 0.22 * x - 0.34 * y - 0.93 * z], axis=-1)


def mix_colour(shade: int, *, pale: bool = False) -> str:
    """One of 32 shades, from small to large errors, as `#rrggbb`.

    pale : mixed with white, for fields on which lines are drawn
    """
    share = np.array([(shade + 0.5) / SHADES])
    colour = np.concatenate([np.interp(share, _STOPS, one) for one in _CHANNELS])
    if pale:
        colour = _WHITE - _PALE * (_WHITE - colour)
    return "#" + colour.round().astype(np.uint8).tobytes().hex()


def _draw_volume(findings: Findings) -> Markup:
    model = findings.estimate.model
    axes = model.machine.linear_axes
    nominal = np.array(list(_make_lattice(axes)))
    flat = nominal.reshape(-1, 3)
    error = UM_PER_MM * build_volumetric_map(model).error_mm(
        make_standstill(model.machine, add_resting_axes(model.machine, flat)),
        findings.estimate.theta,
    )
    size = np.linalg.norm(error, axis=1)
    largest = max(float(size.max()), 1e-6)
    reach = float(np.ptp(flat, axis=0).max())
    factor = round_down(0.09 * reach / largest * UM_PER_MM)
    moved = (flat + factor / UM_PER_MM * error).reshape(nominal.shape)
    straight, bent = project(nominal), project(moved)
    both = np.concatenate([straight, bent]).reshape(-1, 2)
    low, high = both.min(axis=0), both.max(axis=0)
    begin = np.array([_SCENE.left + 14.0, _SCENE.top])
    end = np.array([_SCENE.right, _SCENE.bottom - 10.0])
    scale = float(np.min((end - begin) / (high - low)))
    shift = 0.5 * (begin + end) - 0.5 * scale * (low + high)
    straight, bent = scale * straight + shift, scale * bent + shift
    sizes = size.reshape(nominal.shape[:2])
    shade = 0.5 * (sizes[:, :-1] + sizes[:, 1:]) / largest
    shades = np.minimum(SHADES * shade, SHADES - 1).astype(np.int64)
    ends = straight[:, 0], straight[:, -1]
    title = f"Volume with its errors, exaggerated {factor:,.0f} times"
    return join_shapes(
        [
            draw_label(_SCENE.left, 11.0, title, size=TITLE, colour=Colour.INK),
            draw_segments(*ends, Colour.MUTED, width=0.4, opacity=0.5),
            *(  # the pieces of one shade are one shape
                draw_segments(
                    bent[:, :-1][shades == number],
                    bent[:, 1:][shades == number],
                    mix_colour(int(number)),
                    width=1.3,
                )
                for number in np.unique(shades)
            ),
            *_write_axis_names(straight, axes),
            *draw_colour_bar(70.0, 230.0, largest, spacing=28.0, numbers_at=245.5),
            draw_label(
                170.0, 257.0, "length of the volumetric error, µm", anchor="middle"
            ),
        ]
    )


def _make_lattice(axes: tuple[LinearAxis, ...]) -> Iterator[Float64[np.ndarray, "m 3"]]:
    low = np.array([axis.low for axis in axes])
    high = np.array([axis.high for axis in axes])
    run, stations = np.linspace(0.0, 1.0, 21), np.linspace(0.0, 1.0, 4)
    for along in range(3):
        u, v = (i for i in range(3) if i != along)
        for a in stations:
            for b in stations:
                if {a, b} & {0.0, 1.0}:
                    line = np.empty((len(run), 3))
                    line[:, along], line[:, u], line[:, v] = run, a, b
                    yield low + line * (high - low)


def _write_axis_names(
    straight: Float64[np.ndarray, "l m 2"], axes: tuple[LinearAxis, ...]
) -> Iterator[Markup]:
    """Next to edges in front; `straight` has the lines of one axis after another."""
    per_axis = len(straight) // 3
    # X low and in front, Y low and on the right, Z in front and on the left.
    edges = (0, per_axis + per_axis - 4, 2 * per_axis)
    for axis, edge, (dx, dy) in zip(
        axes, edges, ((-4.0, 13.0), (12.0, 9.0), (-11.0, 2.5)), strict=True
    ):
        x, y = straight[edge].mean(axis=0).tolist()
        yield draw_label(x + dx, y + dy, axis.name, anchor="middle")


def draw_colour_bar(
    left: float,
    top: float,
    largest_um: float,
    *,
    spacing: float,
    numbers_at: float,
    pale: bool = False,
    localise: Callable[[str], str] = str,
) -> Iterator[Markup]:
    """Shades from 0 to the largest error, with numbers.

    spacing : of the numbers; numbers_at : height of their base line
    """
    scale = Scale(0.0, largest_um, left, left + 200.0)
    width = 200.0 / SHADES
    for i in range(SHADES):
        # A little wider, so that no seam shows between two.
        colour = mix_colour(i, pale=pale)
        yield fill_box(left + i * width, top, width + 0.2, 6.0, colour)
    ticks = scale.compute_ticks(spacing)
    for at, text in zip(
        scale.place(ticks).tolist(), scale.format_ticks(ticks), strict=True
    ):
        yield draw_label(at, numbers_at, localise(text), size=NUMBER, anchor="middle")


def _draw_distribution(frame: Frame, findings: Findings) -> Markup:
    before = np.sort(np.linalg.norm(findings.volumetric.error_um, axis=1))
    after = findings.volumetric.after_lengths_um
    lowest = round_down(max(float(np.quantile(after, 0.02)), 1e-3))
    highest = max(1.25 * float(max(before[-1], after[-1])), 10.0 * lowest)
    x = frame.make_x(lowest, highest, logarithmic=True)
    y = frame.make_y(0.0, 100.0)
    entries = ((Colour.ACCENT, "before"), (Colour.SECOND, "after, expected"))
    curves = [
        draw_curve(
            x.place(np.maximum(lengths, lowest)),
            y.place(np.linspace(0.0, 100.0, len(lengths))),
            colour,
        )
        for lengths, (colour, _) in zip((before, after), entries, strict=True)
    ]
    return join_shapes(
        [
            frame.draw_title("Volumetric error before and after compensation"),
            frame.draw_axes(
                x, y, "length of the volumetric error, µm", "share of the volume, %"
            ),
            *curves,
            draw_legend(frame, entries),
        ]
    )
