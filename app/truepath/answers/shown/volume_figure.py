"""The figure of the volumetric error: the deformed volume, and what compensation does.

The volume is seen from the front, right and above, its errors exaggerated by a round
factor and shaded by their length.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64, Int64
from markupsafe import Markup

from truepath.answers.shown.chart import Frame, Scale, round_down
from truepath.answers.shown.error_figures import draw_legend
from truepath.answers.shown.svg import (
    NUMBER,
    TITLE,
    WIDTH,
    Colour,
    draw_curve,
    draw_image,
    draw_segments,
    fill_box,
    join_shapes,
    write_label,
)
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.workspace import add_resting_axes
from truepath.results.result_summary import Findings

# Readable on light and on dark paper: blue, violet, orange.
_STOPS, _RED, _GREEN, _BLUE = (
    [0.0, 0.5, 1.0],
    [61, 176, 240],
    [111, 79, 128],
    [214, 174, 60],
)
SHADES = 32
_WHITE, _PALE = 255.0, 0.55
_HEIGHT = 266.0
_SCENE = Frame(14.0, 22.0, 340.0, 212.0)
_BAR = Frame(70.0, 230.0, 270.0, 236.0)
_CHART = Frame(396.0, 16.0, WIDTH - 7.0, 236.0)


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
    mixed = [np.interp(share, _STOPS, channel) for channel in (_RED, _GREEN, _BLUE)]
    colour = np.concatenate(mixed)
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
    straight, bent = _scale_to_scene(project(nominal), project(moved))
    sizes = size.reshape(nominal.shape[:2])
    shade = 0.5 * (sizes[:, :-1] + sizes[:, 1:]) / largest
    title = f"Volume with its errors, exaggerated {factor:,.0f} times"
    return join_shapes(
        [
            write_label(_SCENE.left, 11.0, title, size=TITLE, colour=Colour.INK),
            draw_segments(
                straight[:, 0],
                straight[:, -1],
                Colour.MUTED,
                width=0.4,
                opacity=0.5,
            ),
            *_draw_shaded(
                bent, np.minimum(SHADES * shade, SHADES - 1).astype(np.int64)
            ),
            *_write_axis_names(straight, axes),
            *_draw_colour_bar(largest),
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


def _scale_to_scene(
    straight: Float64[np.ndarray, "l m 2"], bent: Float64[np.ndarray, "l m 2"]
) -> tuple[Float64[np.ndarray, "l m 2"], Float64[np.ndarray, "l m 2"]]:
    both = np.concatenate([straight, bent]).reshape(-1, 2)
    low, high = both.min(axis=0), both.max(axis=0)
    begin = np.array([_SCENE.left + 14.0, _SCENE.top])
    end = np.array([_SCENE.right, _SCENE.bottom - 10.0])
    scale = float(np.min((end - begin) / (high - low)))
    shift = 0.5 * (begin + end) - 0.5 * scale * (low + high)
    return scale * straight + shift, scale * bent + shift


def _draw_shaded(
    lines: Float64[np.ndarray, "l m 2"], shade: Int64[np.ndarray, "l k"]
) -> Iterator[Markup]:
    """The pieces of one shade are one shape."""
    begin, end = lines[:, :-1], lines[:, 1:]
    for number in np.unique(shade):
        mine = shade == number
        yield draw_segments(begin[mine], end[mine], mix_colour(int(number)), width=1.3)


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
        yield write_label(x + dx, y + dy, axis.name, anchor="middle")


def _draw_colour_bar(largest_um: float) -> Iterator[Markup]:
    scale = Scale(0.0, largest_um, _BAR.left, _BAR.right)
    width = (_BAR.right - _BAR.left) / SHADES
    for i in range(SHADES):
        # A little wider, so that no seam shows between two.
        yield fill_box(_BAR.left + i * width, _BAR.top, width + 0.2, 6.0, mix_colour(i))
    ticks = scale.find_ticks(28.0)
    for at, text in zip(
        scale.place(ticks).tolist(), scale.name_ticks(ticks), strict=True
    ):
        yield write_label(at, _BAR.bottom + 9.5, text, size=NUMBER, anchor="middle")
    middle = 0.5 * (_BAR.left + _BAR.right)
    label = "length of the volumetric error, µm"
    yield write_label(middle, _BAR.bottom + 21.0, label, anchor="middle")


def _draw_distribution(frame: Frame, findings: Findings) -> Markup:
    before = np.sort(np.linalg.norm(findings.volumetric.error_um, axis=1))
    after = findings.volumetric.after_lengths_um
    lowest = round_down(max(float(np.quantile(after, 0.02)), 1e-3))
    highest = max(1.25 * float(max(before[-1], after[-1])), 10.0 * lowest)
    x = frame.make_x(lowest, highest, logarithmic=True)
    y = frame.make_y(0.0, 100.0)
    entries = ((Colour.ACCENT, "before"), (Colour.SECOND, "after, expected"))
    curves = [
        draw_curve(x.place(shown), y.place(share), colour)
        for lengths, (colour, _) in zip((before, after), entries, strict=True)
        for shown, share in [_start_at(lengths, lowest)]
    ]
    return join_shapes(
        [
            frame.write_title("Volumetric error before and after compensation"),
            frame.draw_axes(
                x, y, "length of the volumetric error, µm", "share of the volume, %"
            ),
            *curves,
            draw_legend(frame, entries),
        ]
    )


def _start_at(
    lengths: Float64[np.ndarray, " n"], lowest: float
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    share = np.linspace(0.0, 100.0, len(lengths))
    return np.maximum(lengths, lowest), share
