"""The picture of the set-up: working volume, commanded path, tracker and its view."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.app.kinematics.machine import LinearAxis
from truepath.app.reporting.certificate.language import Language
from truepath.app.reporting.certificate.picture import paint
from truepath.app.reporting.svg import (
    WIDTH,
    Colour,
    draw_image,
    draw_segments,
    draw_strokes,
    fill_box,
    write_label,
)
from truepath.app.reporting.volume_figure import project

_HEIGHT, _EDGE = 300.0, 26.0
_TRACKER = 7.0  # size of the tracker's sign


def draw_setup(
    axes: Sequence[LinearAxis],
    offset_mm: Float64[np.ndarray, "3"],
    paths_mm: Sequence[Float64[np.ndarray, "n 3"]],
    trackers_mm: Sequence[Float64[np.ndarray, "3"]],
    language: Language,
) -> Markup:
    """Draw the set-up of all Runs.

    offset_mm : of the target, with which the axes carry it
    paths_mm : of each Run, places of the target in the order driven
    trackers_mm : where the tracker stood, in the same coordinates
    """
    ends = product(*((axis.low, axis.high) for axis in axes))
    corners = offset_mm + np.array(list(ends))
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
    return paint(draw_image(_HEIGHT, language.say("section_setup"), parts))


class _Fit:
    """Places points of the room in the picture, as large as it holds."""

    def __init__(self, flat: Float64[np.ndarray, "n 2"]) -> None:
        low, high = flat.min(axis=0), flat.max(axis=0)
        begin = np.array([_EDGE + 20.0, _EDGE])
        end = np.array([WIDTH - _EDGE - 30.0, _HEIGHT - _EDGE])
        self._scale = float(np.min((end - begin) / np.maximum(high - low, 1e-9)))
        self._shift = 0.5 * (begin + end) - 0.5 * self._scale * (low + high)

    def place(self, room_mm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Return where points are drawn."""
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
