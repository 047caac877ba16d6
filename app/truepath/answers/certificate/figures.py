"""Pictures of the certificate: error in slices and histograms, path and set-up."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.certificate.language import Language
from truepath.answers.shown.chart import (
    TITLE,
    WIDTH,
    Colour,
    Frame,
    Scale,
    draw_image,
    draw_label,
    draw_segments,
    draw_strokes,
    fill_box,
    join_shapes,
    round_down,
)
from truepath.answers.shown.error_figures import (
    SHADES,
    draw_colour_bar,
    mix_colour,
    project,
)
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.workspace import add_resting_axes

_FONT = "DejaVu Sans, Verdana, Arial, sans-serif"
_PAPER = {
    "ink": "#16202b",
    "muted": "#4a5663",
    "rule": "#d5dbe2",
    "accent": "#1f63c6",
    "second": "#b45309",
    "third": "#0f7b6c",
}
_VARIABLE = re.compile(r"var\(--([a-z]+)\)")
_COLUMNS, _ROWS, _LEVELS = 11, 9, 3
_HEIGHT, _TOP, _BOTTOM = 232.0, 34.0, 180.0
_BAR_TOP = 208.0
_ARROW = 1.4  # of a cell: the longest, before the factor is rounded down
_BINS = 30
_CHART_HEIGHT = 170.0
_SCENE_HEIGHT, _EDGE = 300.0, 26.0
_TRACKER = 7.0  # size of the tracker's sign
# Told apart by form as well as by colour: a dot, a cross, a ring.
_SIGNS = {
    "within": ("m-1.5 0h3", Colour.THIRD, 3.0),
    "outside": ("m-3 -3l6 6m0 -6l-6 6", Colour.SECOND, 1.6),
    "undecided": ("m-3 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0", Colour.INK, 0.9),
}


def inline_colours(figure: Markup) -> Markup:
    """The figure with literal colours and font."""
    text = _VARIABLE.sub(lambda found: _PAPER[found.group(1)], figure)
    # Colours and a font of this module: nothing from outside is in them.
    return Markup(text.replace("<svg ", f'<svg font-family="{_FONT}" ', 1))  # noqa: S704


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
    factor = 0.0
    if slices.error_um is not None:  # exaggeration of arrows: a round number
        place = slices.position_mm[0, :, :, :2]
        cell_mm = min(place[0, 1, 0] - place[0, 0, 0], place[1, 0, 1] - place[0, 0, 1])
        flat = np.linalg.norm(slices.error_um[..., :2], axis=-1)
        reach = _ARROW * cell_mm * UM_PER_MM / max(float(flat.max()), 1e-6)
        factor = round_down(reach)
    parts = [draw_label(0.0, 10.0, title, size=TITLE, colour=Colour.INK)]
    for level in range(_LEVELS):
        parts += _draw_slice(slices, level, names, largest, factor, language)
    parts += draw_colour_bar(
        14.0,
        _BAR_TOP,
        largest,
        spacing=30.0,
        numbers_at=_BAR_TOP + 14.5,
        pale=True,
        localise=language.localise_numbers,
    )
    label = language.text("length_um")
    if factor:
        scaled = language.text("arrow_scale", factor=language.count(int(factor)))
        label += f"; {scaled}"
    parts.append(draw_label(226.0, _BAR_TOP + 6.0, label))
    return inline_colours(draw_image(_HEIGHT, title, parts))


def draw_histograms(
    lengths_um: Sequence[tuple[str, Float64[np.ndarray, " n"]]], language: Language
) -> Markup:
    """Distributions of the length of the volumetric error, one panel each.

    lengths_um : name and lengths; all panels share the scale of lengths
    """
    gap = 58.0
    largest = max(float(lengths.max()) for _, lengths in lengths_um)
    edge = np.linspace(0.0, max(1.02 * largest, 1e-6), _BINS + 1)
    width = (WIDTH - 44.0 - gap * (len(lengths_um) - 1)) / len(lengths_um)
    parts: list[Markup] = []
    for number, (name, lengths) in enumerate(lengths_um):
        left = 38.0 + number * (width + gap)
        frame = Frame(left, 20.0, left + width, _CHART_HEIGHT - 32.0)
        colour = (Colour.ACCENT, Colour.SECOND)[number % 2]
        parts.append(_draw_histogram(frame, name, lengths, edge, colour, language))
    return inline_colours(draw_image(_CHART_HEIGHT, language.text("histogram"), parts))


def _draw_slice(
    slices: Slices,
    level: int,
    names: Sequence[str],
    largest: float,
    factor: float,
    language: Language,
) -> Iterator[Markup]:
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
    yield draw_label(middle, top - 4.0, heading, anchor="middle", colour=Colour.INK)
    mean = 0.25 * (
        length[1:, 1:] + length[1:, :-1] + length[:-1, 1:] + length[:-1, :-1]
    )
    cell_x = (x.end - x.begin) / mean.shape[1]
    cell_y = (y.begin - y.end) / mean.shape[0]
    shades = np.minimum(SHADES * mean / largest, SHADES - 1).astype(int)
    for (row, column), shade in np.ndenumerate(shades):
        at = x.begin + column * cell_x, y.begin - (row + 1) * cell_y
        colour = mix_colour(int(shade), pale=True)
        yield fill_box(*at, cell_x + 0.2, cell_y + 0.2, colour)
    if slices.error_um is not None:
        yield _draw_arrows(place, slices.error_um[level], x, y, factor)
    yield draw_label(middle, _BOTTOM + 17.0, names[0], anchor="middle")
    at = middle - width / 2 - 14.0, _BOTTOM - height / 2
    yield draw_label(*at, names[1], anchor="middle")


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
    barbs = np.hstack([tip - back + side, tip, tip - back - side]).tolist()
    heads = [
        f"M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}L{e:.2f} {f:.2f}"
        for a, b, c, d, e, f in barbs
    ]
    shafts = draw_segments(tail, tip, Colour.INK, width=0.7)
    return shafts + draw_strokes(heads, Colour.INK, width=0.7)


def _draw_histogram(
    frame: Frame,
    name: str,
    lengths: Float64[np.ndarray, " n"],
    edge: Float64[np.ndarray, " e"],
    colour: str,
    language: Language,
) -> Markup:
    share = 100.0 * np.histogram(lengths, edge)[0] / len(lengths)
    mark = language.decimal_mark
    x = replace(frame.make_x(0.0, float(edge[-1])), decimal_mark=mark)
    highest = 1.08 * float(share.max())
    y = replace(frame.make_y(0.0, highest, margin=0.0), decimal_mark=mark)
    at, height = x.place(edge), y.place(share)
    bars = [
        fill_box(left, top, width - 0.6, frame.bottom - top, colour)
        for left, top, width, own in zip(
            at[:-1].tolist(), height.tolist(), np.diff(at).tolist(), share, strict=True
        )
        if own > 0.0
    ]
    axes = frame.draw_axes(
        x, y, language.text("length_um"), language.text("share_percent"), upright=False
    )
    return join_shapes([frame.draw_title(name), axes, *bars])


def draw_setup(
    axes: Sequence[LinearAxis],
    offset_mm: Float64[np.ndarray, "3"],
    paths_mm: Sequence[Float64[np.ndarray, "n 3"]],
    trackers_mm: Sequence[Float64[np.ndarray, "3"]],
    language: Language,
) -> Markup:
    """Picture of the set-up of all Runs.

    offset_mm : of the target from the point that the axes carry
    paths_mm : of each Run, positions of the target in the order measured
    trackers_mm : stations of the tracker, in the same coordinates
    """
    scene = _Scene(axes, offset_mm, [*paths_mm, *(at[None] for at in trackers_mm)])
    parts = [scene.draw_box()]
    for at in trackers_mm:
        begin, end = scene.place(np.tile(at, (8, 1))), scene.place(scene.corners_mm)
        parts.append(draw_segments(begin, end, Colour.THIRD, width=0.4, dash="2 3"))
    for path in paths_mm:
        if len(path):
            points = "L".join(f"{x:.1f} {y:.1f}" for x, y in scene.place(path).tolist())
            move = f"M{points}"
            parts.append(draw_strokes([move], Colour.ACCENT, width=0.7, opacity=0.75))
    half = _TRACKER / 2.0
    for number, at in enumerate(trackers_mm, start=1):
        x, y = scene.place(at[None])[0].tolist()
        parts.append(fill_box(x - half, y - half, _TRACKER, _TRACKER, Colour.THIRD))
        name = language.text("tracker") + (f" {number}" if number > 1 else "")
        anchor = "end" if x > WIDTH / 2.0 else "middle"
        parts.append(draw_label(x, y + 14.0, name, colour=Colour.INK, anchor=anchor))
    return scene.finish(parts, language.text("section_setup"))


def draw_points(
    axes: Sequence[LinearAxis],
    position_mm: Float64[np.ndarray, "n 3"],
    conformity: Sequence[str],
    language: Language,
) -> Markup:
    """Places of a verification in the travel, by their decisions.

    position_mm : of the linear axes; conformity : of each, a key of `_SIGNS`
    """
    scene = _Scene(axes, np.zeros(3), ())
    floor = position_mm * [1.0, 1.0, 0.0] + [0.0, 0.0, axes[2].low]
    at = scene.place(position_mm)
    below = draw_segments(scene.place(floor), at, Colour.RULE, width=0.6)
    parts = [scene.draw_box(), below]
    for number, (name, (sign, colour, width)) in enumerate(_SIGNS.items(), start=1):
        own = [p for p, of in zip(at.tolist(), conformity, strict=True) if of == name]
        strokes = [f"M{a:.1f} {b:.1f}{sign}" for a, b in own]
        label, y = f"{language.text(f'decision_{name}')}: {len(own)}", 12.0 * number
        parts.append(draw_strokes([f"M8 {y:g}{sign}", *strokes], colour, width=width))
        parts.append(draw_label(17.0, y + 2.7, label, colour=Colour.INK))
    return scene.finish(parts, language.text("places_figure"))


class _Scene:
    """The box of the travel, seen as that of the volumetric error."""

    def __init__(
        self,
        axes: Sequence[LinearAxis],
        offset_mm: Float64[np.ndarray, "3"],
        further_mm: Sequence[Float64[np.ndarray, "n 3"]],
    ) -> None:
        self.axes = axes
        ends = product(*((axis.low, axis.high) for axis in axes))
        self.corners_mm = offset_mm + np.array(list(ends))
        flat = project(np.vstack([self.corners_mm, *further_mm])[None])[0]
        low, high = flat.min(axis=0), flat.max(axis=0)
        begin = np.array([_EDGE + 20.0, _EDGE])
        end = np.array([WIDTH - _EDGE - 30.0, _SCENE_HEIGHT - _EDGE])
        self._scale = float(np.min((end - begin) / np.maximum(high - low, 1e-9)))
        self._shift = 0.5 * (begin + end) - 0.5 * self._scale * (low + high)

    def place(self, room_mm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        return self._scale * project(room_mm[None])[0] + self._shift

    def draw_box(self) -> Markup:
        corners = self.corners_mm
        pairs = [
            (one, other)
            for one in range(8)
            for other in range(one)
            if np.count_nonzero(corners[one] != corners[other]) == 1
        ]
        begin, end = (self.place(corners[[pair[k] for pair in pairs]]) for k in (0, 1))
        return draw_segments(begin, end, Colour.INK, width=0.9)

    def finish(self, parts: Sequence[Markup], title: str) -> Markup:
        """With the names of the axes."""
        labels: list[Markup] = []
        edges = ((0, 4), (4, 6), (0, 1))  # of corners: X in front, Y right, Z left
        beside = ((0.0, 13.0, "middle"), (10.0, 9.0, "start"), (-8.0, 0.0, "end"))
        for axis, edge, (dx, dy, anchor) in zip(self.axes, edges, beside, strict=True):
            x, y = self.place(self.corners_mm[list(edge)]).mean(axis=0).tolist()
            text, at = f"{axis.name} {axis.high - axis.low:.0f} mm", (x + dx, y + dy)
            labels.append(draw_label(*at, text, colour=Colour.INK, anchor=anchor))
        return inline_colours(draw_image(_SCENE_HEIGHT, title, [*parts, *labels]))
