"""Pictures of the volumetric error: slices at three heights, and histograms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.certificate.language import Language
from truepath.answers.certificate.paper_colours import inline_colours
from truepath.answers.shown.chart import Frame, Scale, round_down
from truepath.answers.shown.svg import (
    NUMBER,
    TITLE,
    WIDTH,
    Colour,
    draw_image,
    draw_segments,
    draw_strokes,
    fill_box,
    join_shapes,
    write_label,
)
from truepath.answers.shown.volume_figure import SHADES, mix_colour
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.workspace import add_resting_axes

_COLUMNS, _ROWS, _LEVELS = 11, 9, 3
_HEIGHT, _TOP, _BOTTOM = 232.0, 34.0, 180.0
_BAR_TOP, _BAR_WIDTH = 208.0, 200.0
_ARROW = 1.4  # of a cell: the longest, before the factor is rounded down
_BINS = 30
_CHART_HEIGHT = 170.0


@dataclass(frozen=True, slots=True)
class Slices:
    """The volumetric error in planes of X and Y, at heights of Z, in µm.

    position_mm : (l, r, c, 3); error_um : the same, None where only its size is known
    length_um : (l, r, c)
    """

    position_mm: Float64[np.ndarray, "l r c 3"]
    error_um: Float64[np.ndarray, "l r c 3"] | None
    length_um: Float64[np.ndarray, "l r c"]


def compute_slices(estimated: EstimatedModel) -> tuple[Slices, Slices]:
    """The error as found, and the RMS of its uncertainty.

    Only for a machine with three linear axes; rotary axes rest.
    """
    machine = estimated.model.machine
    x, y, z = (
        np.linspace(axis.low, axis.high, count)
        for axis, count in zip(
            machine.linear_axes, (_COLUMNS, _ROWS, _LEVELS), strict=True
        )
    )
    level, row, column = np.meshgrid(z, y, x, indexing="ij")
    place = np.stack([column, row, level], axis=-1)
    at = make_standstill(machine, add_resting_axes(machine, place.reshape(-1, 3)))
    found = build_volumetric_map(estimated.model)
    error = UM_PER_MM * found.error_mm(at, estimated.theta).reshape(place.shape)
    sigma = UM_PER_MM * found.sigma_mm(at, estimated.covariance).reshape(place.shape)
    return (
        Slices(place, error, np.linalg.norm(error, axis=-1)),
        Slices(place, None, np.linalg.norm(sigma, axis=-1)),
    )


def draw_slices(
    slices: Slices, names: Sequence[str], title: str, language: Language
) -> Markup:
    """Three slices side by side, on one scale."""
    largest = max(float(slices.length_um.max()), 1e-6)
    parts: list[Markup] = [write_label(0.0, 10.0, title, size=TITLE, colour=Colour.INK)]
    factor = _choose_factor(slices)
    for level in range(_LEVELS):
        parts.append(_draw_slice(slices, level, names, largest, factor, language))
    parts.append(_draw_bar(largest, factor, language))
    return inline_colours(draw_image(_HEIGHT, title, parts))


def draw_histograms(
    lengths_um: Sequence[tuple[str, Float64[np.ndarray, " n"]]], language: Language
) -> Markup:
    """Distributions of the length of the volumetric error, one panel each.

    lengths_um : name and lengths; both panels share the scale of shares
    """
    gap = 58.0
    width = (WIDTH - 44.0 - gap * (len(lengths_um) - 1)) / len(lengths_um)
    parts: list[Markup] = []
    for number, (name, lengths) in enumerate(lengths_um):
        left = 38.0 + number * (width + gap)
        frame = Frame(left, 20.0, left + width, _CHART_HEIGHT - 32.0)
        colour = (Colour.ACCENT, Colour.SECOND)[number % 2]
        parts.append(_draw_histogram(frame, name, lengths, colour, language))
    return inline_colours(draw_image(_CHART_HEIGHT, language.say("histogram"), parts))


def _choose_factor(slices: Slices) -> float:
    """Exaggeration of arrows: a round number; 0 without vectors."""
    if slices.error_um is None:
        return 0.0
    place = slices.position_mm[0, :, :, :2]
    cell_mm = min(place[0, 1, 0] - place[0, 0, 0], place[1, 0, 1] - place[0, 0, 1])
    flat = np.linalg.norm(slices.error_um[..., :2], axis=-1)
    return round_down(_ARROW * cell_mm * UM_PER_MM / max(float(flat.max()), 1e-6))


def _draw_slice(
    slices: Slices,
    level: int,
    names: Sequence[str],
    largest: float,
    factor: float,
    language: Language,
) -> Markup:
    place, length = slices.position_mm[level], slices.length_um[level]
    panel = WIDTH / _LEVELS
    left, right = level * panel + 20.0, (level + 1) * panel - 12.0
    span = place[-1, -1, :2] - place[0, 0, :2]
    scale = min((right - left) / span[0], (_BOTTOM - _TOP) / span[1])
    width, height = scale * span
    middle = 0.5 * (left + right)
    (west, south), (east, north) = place[0, 0, :2].tolist(), place[-1, -1, :2].tolist()
    x = Scale(west, east, middle - width / 2, middle + width / 2)
    y = Scale(south, north, _BOTTOM, _BOTTOM - height)
    heading = f"{names[2]} = {language.number(float(place[0, 0, 2]), 0)} mm"
    top = _BOTTOM - height - 6.0
    parts = [
        write_label(middle, top - 4.0, heading, anchor="middle", colour=Colour.INK),
        *_draw_cells(length, x, y, largest),
    ]
    if slices.error_um is not None:
        parts.append(_draw_arrows(place, slices.error_um[level], x, y, factor))
    parts += [
        write_label(middle, _BOTTOM + 17.0, names[0], anchor="middle"),
        write_label(
            middle - width / 2 - 14.0, _BOTTOM - height / 2, names[1], anchor="middle"
        ),
    ]
    return join_shapes(parts)


def _draw_cells(
    length: Float64[np.ndarray, "r c"], x: Scale, y: Scale, largest: float
) -> list[Markup]:
    mean = 0.25 * (
        length[1:, 1:] + length[1:, :-1] + length[:-1, 1:] + length[:-1, :-1]
    )
    rows, columns = mean.shape
    width, height = (x.end - x.begin) / columns, (y.begin - y.end) / rows
    shades = np.minimum(SHADES * mean / largest, SHADES - 1).astype(int)
    return [
        fill_box(
            x.begin + column * width,
            y.begin - (row + 1) * height,
            width + 0.2,
            height + 0.2,
            mix_colour(int(shades[row, column]), pale=True),
        )
        for row in range(rows)
        for column in range(columns)
    ]


def _draw_arrows(
    place: Float64[np.ndarray, "r c 3"],
    error_um: Float64[np.ndarray, "r c 3"],
    x: Scale,
    y: Scale,
    factor: float,
) -> Markup:
    begin = place[..., :2].reshape(-1, 2)
    end = begin + factor / UM_PER_MM * error_um[..., :2].reshape(-1, 2)
    tail = np.column_stack([x.place(begin[:, 0]), y.place(begin[:, 1])])
    tip = np.column_stack([x.place(end[:, 0]), y.place(end[:, 1])])
    along = tip - tail
    size = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    back = np.minimum(2.6, 0.45 * size) * along / size
    side = 0.45 * np.column_stack([-back[:, 1], back[:, 0]])
    heads = [
        f"M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}L{e:.2f} {f:.2f}"
        for (a, b), (c, d), (e, f) in zip(
            (tip - back + side).tolist(),
            tip.tolist(),
            (tip - back - side).tolist(),
            strict=True,
        )
    ]
    return draw_segments(tail, tip, Colour.INK, width=0.7) + draw_strokes(
        heads, Colour.INK, width=0.7
    )


def _draw_bar(largest: float, factor: float, language: Language) -> Markup:
    scale = Scale(0.0, largest, 14.0, 14.0 + _BAR_WIDTH)
    width = _BAR_WIDTH / SHADES
    ticks = scale.find_ticks(30.0)
    parts = [
        fill_box(14.0 + i * width, _BAR_TOP, width + 0.2, 6.0, mix_colour(i, pale=True))
        for i in range(SHADES)
    ]
    names = map(language.localise_numbers, scale.name_ticks(ticks))
    for at, text in zip(scale.place(ticks).tolist(), names, strict=True):
        parts.append(
            write_label(at, _BAR_TOP + 14.5, text, size=NUMBER, anchor="middle")
        )
    label = language.say("length_um")
    if factor:
        scaled = language.say("arrow_scale", factor=language.count(int(factor)))
        label += f"; {scaled}"
    parts.append(write_label(26.0 + _BAR_WIDTH, _BAR_TOP + 6.0, label))
    return join_shapes(parts)


def _draw_histogram(
    frame: Frame,
    name: str,
    lengths: Float64[np.ndarray, " n"],
    colour: str,
    language: Language,
) -> Markup:
    edge = np.linspace(0.0, max(1.02 * float(lengths.max()), 1e-6), _BINS + 1)
    share = 100.0 * np.histogram(lengths, edge)[0] / len(lengths)
    mark = language.decimal_mark
    x = replace(frame.make_x(0.0, float(edge[-1])), decimal_mark=mark)
    highest = 1.08 * float(share.max())
    y = replace(frame.make_y(0.0, highest, margin=0.0), decimal_mark=mark)
    at, height = x.place(edge), y.place(share)
    bars = [
        fill_box(
            float(at[i]),
            float(height[i]),
            float(at[i + 1] - at[i]) - 0.6,
            frame.bottom - float(height[i]),
            colour,
        )
        for i in range(_BINS)
        if share[i] > 0.0
    ]
    axes = frame.draw_axes(
        x, y, language.say("length_um"), language.say("share_percent"), upright=False
    )
    return join_shapes([frame.write_title(name), axes, *bars])
