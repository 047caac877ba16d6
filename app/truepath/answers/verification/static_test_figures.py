"""Figures of standards for standstills on lines: ISO 230-2 and -6.

Consecutive positions on a straight line are a line: of one axis alone it is a test of
ISO 230-2, of two or three in proportion a diagonal of ISO 230-6. The deviation is that
along the line, target by target, by the side of approach:

    x̄↑, x̄↓ means and s↑, s↓ standard deviations over the runs, B = x̄↑ − x̄↓
    M  range of (x̄↑ + x̄↓)/2               mean bidirectional positioning deviation
    E  range of all x̄↑ and x̄↓             bidirectional systematic deviation
    R  largest of 2 s↑ + 2 s↓ + |B|, 4 s↑, 4 s↓       bidirectional repeatability
    A  range of all x̄ ± 2 s               bidirectional accuracy
    B  largest |x̄↑ − x̄↓|                  reversal

The tracker's noise is scatter as well, so A and R by the standard's formula are too
large by an unknown part of it: the middle of the interval that the noise allows is
stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from truepath.answers.shown.sampled_vectors import SampledVectors
from truepath.answers.verification.circles.static_circles import (
    CircleFigures,
    evaluate_circle,
    find_circles,
)
from truepath.answers.verification.places.noise_bias import enclose_largest
from truepath.answers.verification.places.reduced_points import ReducedPoints
from truepath.files.units import UM_PER_MM

_SAME_MM = 1e-3
_FEWEST_TARGETS, _FEWEST_RUNS = 3, 2
_OF_SCATTER = ("A", "R")
LINE_FIGURES = ("A", "E", "R", "B", "M")
Rows = list[Int64[np.ndarray, " r"]]


@dataclass(frozen=True, slots=True)
class LineFigures:
    """A line in figures, µm.

    axes : that move on it; kind : `iso-230-2` or `iso-230-6`
    begin_mm, end_mm : (a,) positions of its first and last target
    position_mm : (t,) of targets along it; runs : of each direction at the least
    forward_um, backward_um : (t,) means
    figures, uncertainty_um : by name, k = 1; own_um : each figure of noise alone
    predicted_um : by name, from the result, without R and A
    """

    axes: str
    kind: str
    begin_mm: Float64[np.ndarray, " a"]
    end_mm: Float64[np.ndarray, " a"]
    runs: int
    position_mm: Float64[np.ndarray, " t"]
    forward_um: Float64[np.ndarray, " t"]
    backward_um: Float64[np.ndarray, " t"]
    figures_um: dict[str, float]
    uncertainty_um: dict[str, float]
    own_um: dict[str, float]
    predicted_um: dict[str, float]


@dataclass(frozen=True, slots=True)
class StaticTestFigures:
    """Lines and circles that were measured at standstill."""

    lines: tuple[LineFigures, ...]
    circles: tuple[CircleFigures, ...]


def evaluate_static_lines_and_circles(
    places: ReducedPoints,
    measured: SampledVectors,
    predicted_mm: Float64[np.ndarray, "n 3"],
) -> StaticTestFigures:
    """Figures of lines and circles of standstills; those on the fly are left out."""
    order = np.flatnonzero(places.at.line < 0)
    position = places.at.position_mm[order]
    values = measured.select(order)
    lines = [
        _evaluate_line(position, passed, values, predicted_mm[order], places)
        for passed in _find_lines(position)
    ]
    circles = [
        evaluate_circle(position, own, values, predicted_mm[order], places)
        for own in find_circles(position)
    ]
    return StaticTestFigures(
        tuple(line for line in lines if line is not None), tuple(circles)
    )


@dataclass(frozen=True, slots=True)
class _Passes:
    direction: Float64[np.ndarray, " a"]
    origin_mm: Float64[np.ndarray, " a"]
    place: Int64[np.ndarray, " k"]
    sign: Float64[np.ndarray, " k"]


def _find_lines(position: Float64[np.ndarray, "n a"]) -> list[_Passes]:
    """Lines with three consecutive positions on them, with all their passes."""
    step = np.diff(position, axis=0)
    length = np.linalg.norm(step, axis=1)
    unit = step / np.maximum(length, _SAME_MM)[:, None]
    moves = length > _SAME_MM
    straight = np.abs(np.einsum("ni,ni->n", unit[1:], unit[:-1])) > 1.0 - 1e-9
    straight &= moves[1:] & moves[:-1]
    on_line = np.zeros(len(step), bool)
    on_line[1:] |= straight
    on_line[:-1] |= straight
    found: list[_Passes] = []
    for k in np.flatnonzero(on_line).tolist():
        direction = unit[k] * np.sign(unit[k][np.argmax(np.abs(unit[k]) > 1e-9)])
        sign = float(np.sign(direction @ unit[k]))
        for number, line in enumerate(found):
            away = position[k] - line.origin_mm
            away = away - (away @ line.direction) * line.direction
            if (
                np.abs(line.direction - direction).max() < 1e-6
                and np.abs(away).max() < _SAME_MM
            ):
                found[number] = _Passes(
                    direction,
                    line.origin_mm,
                    np.append(line.place, k + 1),
                    np.append(line.sign, sign),
                )
                break
        else:
            place = np.array([k + 1])
            found.append(_Passes(direction, position[k], place, np.array([sign])))
    return found


def _evaluate_line(
    position: Float64[np.ndarray, "n a"],
    passed: _Passes,
    values: SampledVectors,
    predicted_mm: Float64[np.ndarray, "n 3"],
    places: ReducedPoints,
) -> LineFigures | None:
    """None if it has too few targets or runs, or if a rotary axis turns."""
    machine = places.at.machine
    linear = [machine.axis_names.index(axis.name) for axis in machine.linear_axes]
    direction = passed.direction[linear]
    if np.linalg.norm(direction) < 1.0 - 1e-6:
        return None  # a rotary axis turns
    along = (position[passed.place] - passed.origin_mm) @ passed.direction
    groups = _group_by_target(along, passed.sign)
    if groups is None:
        return None
    at_mm, pairs = groups
    column = np.array(["XYZ".index(machine.axis_names[k]) for k in linear])
    vector = np.zeros(3)
    vector[column] = direction
    seen = values.project(passed.place, np.tile(vector, (len(passed.place), 1)))
    deviation = seen.measured_um
    expected = UM_PER_MM * predicted_mm[passed.place] @ vector
    figures = _compute_figures(deviation[:, None], pairs)
    spread = _compute_figures(deviation[:, None] + seen.error_um, pairs)
    own = _compute_figures(seen.noise_um, pairs)
    stated = {
        name: (float(value[0]), float(spread[name].std()))
        for name, value in figures.items()
    }
    by_error = _compute_figures(seen.error_um, pairs)
    for name in _OF_SCATTER:
        value, uncertainty = enclose_largest(
            stated[name][0], by_error[name], stated[name][1]
        )
        stated[name] = max(value, 0.0), uncertainty
    model = _compute_figures(expected[:, None], pairs)
    axes = "".join(
        machine.axis_names[k] for k in linear if abs(passed.direction[k]) > 1e-6
    )
    mean = [np.array([deviation[rows].mean() for rows in side]) for side in pairs]
    ends = [passed.origin_mm + at * passed.direction for at in (at_mm[0], at_mm[-1])]
    return LineFigures(
        axes,
        "iso-230-2" if len(axes) == 1 else "iso-230-6",
        ends[0],
        ends[1],
        min(len(rows) for side in pairs for rows in side),
        at_mm,
        mean[0],
        mean[1],
        {name: value for name, (value, _) in stated.items()},
        {name: uncertainty for name, (_, uncertainty) in stated.items()},
        {name: float(value.mean()) for name, value in own.items()},
        {name: float(model[name][0]) for name in ("E", "B", "M")},
    )


def _group_by_target(
    along_mm: Float64[np.ndarray, " k"], sign: Float64[np.ndarray, " k"]
) -> tuple[Float64[np.ndarray, " t"], tuple[Rows, Rows]] | None:
    forward: Rows = []
    backward: Rows = []
    at_mm: list[float] = []
    for own in _split_at_gaps(along_mm):
        up, down = own[sign[own] > 0], own[sign[own] < 0]
        if min(len(up), len(down)) >= _FEWEST_RUNS:
            forward.append(up)
            backward.append(down)
            at_mm.append(float(along_mm[own].mean()))
    if len(at_mm) < _FEWEST_TARGETS:
        return None
    return np.array(at_mm), (forward, backward)


def _split_at_gaps(along_mm: Float64[np.ndarray, " k"]) -> Rows:
    """Passes of each target, the lowest first.

    Passes of one target differ by rounding: a target must not depend on which side of a
    rounded number it falls.
    """
    order = np.argsort(along_mm, kind="stable")
    gaps = np.flatnonzero(np.diff(along_mm[order]) > _SAME_MM) + 1
    return [np.sort(own) for own in np.split(order, gaps)]


def _compute_figures(
    deviation: Float64[np.ndarray, "k e"], pairs: tuple[Rows, Rows]
) -> dict[str, Float64[np.ndarray, " e"]]:
    up, down = (np.stack([deviation[r].mean(axis=0) for r in side]) for side in pairs)
    s_up, s_down = (
        np.stack([deviation[r].std(axis=0, ddof=1) for r in side]) for side in pairs
    )
    reversal = up - down
    both = np.concatenate([up, down])
    half = 2.0 * np.concatenate([s_up, s_down])
    repeatability = np.maximum.reduce(
        [2.0 * (s_up + s_down) + np.abs(reversal), 4.0 * s_up, 4.0 * s_down]
    )
    mean = 0.5 * (up + down)
    return {
        "A": (both + half).max(axis=0) - (both - half).min(axis=0),
        "E": both.max(axis=0) - both.min(axis=0),
        "R": repeatability.max(axis=0),
        "B": np.abs(reversal).max(axis=0),
        "M": mean.max(axis=0) - mean.min(axis=0),
    }
