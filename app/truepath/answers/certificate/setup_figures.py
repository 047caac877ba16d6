"""Pictures of the working volume: path and tracker, and places of a verification."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.certificate.language import Language
from truepath.answers.certificate.paper_colours import inline_colours
from truepath.answers.shown.chart import (
    WIDTH,
    Colour,
    draw_image,
    draw_segments,
    draw_strokes,
    fill_box,
    write_label,
)
from truepath.answers.shown.error_figures import project
from truepath.kinematics.machine.machine import LinearAxis

_HEIGHT, _EDGE = 300.0, 26.0
_TRACKER = 7.0  # size of the tracker's sign
# Told apart by form as well as by colour: a dot, a cross, a ring.
_SIGNS = {
    "within": ("m-1.5 0h3", Colour.THIRD, 3.0),
    "outside": ("m-3 -3l6 6m0 -6l-6 6", Colour.SECOND, 1.6),
    "undecided": ("m-3 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0", Colour.INK, 0.9),
}


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
    corners = offset_mm + _list_corners(axes)
    every = np.vstack([corners, *paths_mm, *(t[None] for t in trackers_mm)])
    fit = _Fit(_flatten(every))
    parts = [_draw_box(corners, fit)]
    parts += [
        draw_segments(
            fit.place(np.tile(at, (8, 1))),
            fit.place(corners),
            Colour.THIRD,
            width=0.4,
            dash="2 3",
        )
        for at in trackers_mm
    ]
    parts += [_draw_path(path, fit) for path in paths_mm if len(path)]
    parts += [
        _draw_tracker(at, number, fit, language)
        for number, at in enumerate(trackers_mm, start=1)
    ]
    parts += _write_axes(axes, corners, fit)
    return inline_colours(draw_image(_HEIGHT, language.say("section_setup"), parts))


def draw_places(
    axes: Sequence[LinearAxis],
    position_mm: Float64[np.ndarray, "n 3"],
    conformity: Sequence[str],
    language: Language,
) -> Markup:
    """Places of a verification in the travel, by their decisions.

    position_mm : of the linear axes; conformity : of each, a key of `_SIGNS`
    """
    corners = _list_corners(axes)
    fit = _Fit(_flatten(corners))
    floor = position_mm * [1.0, 1.0, 0.0] + [0.0, 0.0, axes[2].low]
    at = fit.place(position_mm)
    below = draw_segments(fit.place(floor), at, Colour.RULE, width=0.6)
    parts = [_draw_box(corners, fit), below]
    parts += _draw_signs(at.tolist(), conformity, language)
    parts += _write_axes(axes, corners, fit)
    return inline_colours(draw_image(_HEIGHT, language.say("places_figure"), parts))


def _draw_signs(
    at: Sequence[Sequence[float]], conformity: Sequence[str], language: Language
) -> Iterator[Markup]:
    y = 12.0
    for name, (sign, colour, width) in _SIGNS.items():
        own = [p for p, said in zip(at, conformity, strict=True) if said == name]
        strokes = [f"M{a:.1f} {b:.1f}{sign}" for a, b in own]
        label = f"{language.say(f'decision_{name}')}: {len(own)}"
        yield draw_strokes([f"M8 {y:g}{sign}", *strokes], colour, width=width)
        yield write_label(17.0, y + 2.7, label, colour=Colour.INK)
        y += 12.0


def _list_corners(axes: Sequence[LinearAxis]) -> Float64[np.ndarray, "8 3"]:
    return np.array(list(product(*((axis.low, axis.high) for axis in axes))))


class _Fit:
    def __init__(self, flat: Float64[np.ndarray, "n 2"]) -> None:
        low, high = flat.min(axis=0), flat.max(axis=0)
        begin = np.array([_EDGE + 20.0, _EDGE])
        end = np.array([WIDTH - _EDGE - 30.0, _HEIGHT - _EDGE])
        self._scale = float(np.min((end - begin) / np.maximum(high - low, 1e-9)))
        self._shift = 0.5 * (begin + end) - 0.5 * self._scale * (low + high)

    def place(self, room_mm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        return self._scale * _flatten(room_mm) + self._shift


def _flatten(room_mm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
    return project(room_mm[None])[0]


def _draw_box(corners: Float64[np.ndarray, "8 3"], fit: _Fit) -> Markup:
    pairs = [
        (one, other)
        for one in range(8)
        for other in range(one)
        if np.count_nonzero(corners[one] != corners[other]) == 1
    ]
    begin, end = (fit.place(corners[[pair[k] for pair in pairs]]) for k in (0, 1))
    return draw_segments(begin, end, Colour.INK, width=0.9)


def _draw_path(path: Float64[np.ndarray, "n 3"], fit: _Fit) -> Markup:
    at = fit.place(path)
    points = "L".join(f"{x:.1f} {y:.1f}" for x, y in at.tolist())
    return draw_strokes([f"M{points}"], Colour.ACCENT, width=0.7, opacity=0.75)


def _draw_tracker(
    at_mm: Float64[np.ndarray, "3"], number: int, fit: _Fit, language: Language
) -> Markup:
    x, y = fit.place(at_mm[None])[0].tolist()
    half = _TRACKER / 2.0
    name = language.say("tracker") + (f" {number}" if number > 1 else "")
    is_right = x > WIDTH / 2.0
    return fill_box(x - half, y - half, _TRACKER, _TRACKER, Colour.THIRD) + write_label(
        x,
        y + 14.0,
        name,
        colour=Colour.INK,
        anchor="end" if is_right else "middle",
    )


def _write_axes(
    axes: Sequence[LinearAxis], corners: Float64[np.ndarray, "8 3"], fit: _Fit
) -> list[Markup]:
    edges = ((0, 4), (4, 6), (0, 1))  # of corners: X in front, Y right, Z left
    beside = ((0.0, 13.0, "middle"), (10.0, 9.0, "start"), (-8.0, 0.0, "end"))
    parts: list[Markup] = []
    for axis, edge, (dx, dy, anchor) in zip(axes, edges, beside, strict=True):
        x, y = fit.place(corners[list(edge)]).mean(axis=0).tolist()
        text = f"{axis.name} {axis.high - axis.low:.0f} mm"
        parts.append(
            write_label(x + dx, y + dy, text, colour=Colour.INK, anchor=anchor)
        )
    return parts
