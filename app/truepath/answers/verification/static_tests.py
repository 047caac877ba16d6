"""Figures of tests at standstill: lines (ISO 230-2 and -6) and circles (ISO 230-4).

Consecutive positions on a straight line are a line: of one axis alone it is a test of
ISO 230-2, of two or three in proportion a diagonal of ISO 230-6. The deviation is that
along the line, target by target, by the side of approach:

    x̄↑, x̄↓ means and s↑, s↓ standard deviations over the runs, B = x̄↑ − x̄↓
    M  range of (x̄↑ + x̄↓)/2               mean bidirectional positioning deviation
    E  range of all x̄↑ and x̄↓             bidirectional systematic deviation
    R  largest of 2 s↑ + 2 s↓ + |B|, 4 s↑, 4 s↓       bidirectional repeatability
    A  range of all x̄ ± 2 s               bidirectional accuracy
    B  largest |x̄↑ − x̄↓|                  reversal

Of the radial deviations of a circle, G is the range about the circle of least squares
in both senses, F the largest and smallest about the commanded centre. At standstill,
they show geometry and lost motion, no servo.

The tracker's noise makes ranges and scatter larger: of an exact machine it makes all of
it. A range, or a repeatability, is the largest of many linear combinations a·m of the
measured m = t + e. So whatever the true t,

    f(m) − f(e) ≤ f(t) ≤ f(m) − a·e    with the a that is largest at t

The interval from f(m) less the 99 % quantile of f(e) to f(m) plus 1.96 times the
largest standard deviation of any a·e holds the true figure in 95 % of cases or more,
with some hundreds of draws of e as well. Its middle is stated, with half of it as
expanded uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.special import ndtri

from truepath.answers.verification.circle_figures import StatedFigures
from truepath.answers.verification.matched_points import K
from truepath.answers.verification.reduced_points import ReducedPoints
from truepath.files.units import UM_PER_MM

CIRCLE_FIGURES = ("G", "F_max", "F_min")
_SAME_MM, _SAME_CIRCLE_MM = 1e-3, 0.1
_FEWEST_OF_CIRCLE, _FEWEST_TARGETS, _FEWEST_RUNS = 12, 3, 2
LINE_FIGURES = ("A", "E", "R", "B", "M")
Rows = list[Int64[np.ndarray, " r"]]


def _enclose_largest(
    raw: float, by_error: Float64[np.ndarray, " e"], largest_sigma: float
) -> tuple[float, float]:
    """Middle of the interval, and its standard uncertainty (k = 1).

    raw : figure of the measurement; by_error : of draws of the error alone
    largest_sigma : largest standard deviation of the combinations a·e
    """
    more = float(np.quantile(by_error, 0.99))
    less = float(ndtri(0.975)) * largest_sigma
    return raw - 0.5 * (more - less), 0.5 * (more + less) / K


@dataclass(frozen=True, slots=True)
class SampledVectors:
    """Vectors at n positions, mm.

    noise_mm : sampled from the noise of measured_mm
    common_mm : by one standard uncertainty of each error that all positions share
    """

    measured_mm: Float64[np.ndarray, "n 3"]
    noise_mm: Float64[np.ndarray, "n 3 d"]
    common_mm: Float64[np.ndarray, "n 3 c"]

    def select(self, rows: Int64[np.ndarray, " r"]) -> SampledVectors:
        """By row number."""
        return SampledVectors(
            self.measured_mm[rows], self.noise_mm[rows], self.common_mm[rows]
        )

    def project(
        self, rows: Int64[np.ndarray, " k"], direction: Float64[np.ndarray, "k 3"]
    ) -> tuple[
        Float64[np.ndarray, " k"],
        Float64[np.ndarray, "k d"],
        Float64[np.ndarray, "k d"],
    ]:
        """Components of some vectors, each along its own direction, µm.

        As measured, samples of their noise, and of all their errors.
        """
        own = self.select(rows)
        noise_um = UM_PER_MM * np.einsum("ni,nie->ne", direction, own.noise_mm)
        common_um = UM_PER_MM * np.einsum("ni,nic->nc", direction, own.common_mm)
        # Common errors are the same at all positions: the same numbers per draw in
        # every call.
        size = own.common_mm.shape[2], own.noise_mm.shape[2]
        common = np.random.default_rng(3).standard_normal(size)
        return (
            UM_PER_MM * np.einsum("ni,ni->n", direction, own.measured_mm),
            noise_um,
            noise_um + common_um @ common,
        )


@dataclass(frozen=True, slots=True)
class CircleFigures:
    """A circle in figures, µm.

    plane : both axes; angle_deg, radial_um : (n,) of its positions, about the commanded
        centre
    predicted_um : by name, from the result
    """

    plane: str
    centre_mm: Float64[np.ndarray, " a"]
    radius_mm: float
    angle_deg: Float64[np.ndarray, " n"]
    radial_um: Float64[np.ndarray, " n"]
    figures: StatedFigures
    predicted_um: dict[str, float]


def _find_circles(
    position: Float64[np.ndarray, "n a"],
) -> list[Int64[np.ndarray, " k"]]:
    """Rows of each circle, in both senses: equal chords that turn.

    Circles in different planes may share centre and radius, and are different circles.
    """
    found: list[tuple[Float64[np.ndarray, " c"], list[Int64[np.ndarray, " k"]]]] = []
    step = np.diff(position, axis=0)
    length = np.linalg.norm(step, axis=1)
    turn = np.einsum("ni,ni->n", step[1:], step[:-1]) / np.maximum(
        length[1:] * length[:-1], _SAME_MM**2
    )
    alike = np.abs(length[1:] - length[:-1]) < 10.0 * _SAME_MM
    rounds: Bool[np.ndarray, " m"] = alike & (turn > 0.0) & (turn < 1.0 - 1e-6)
    changes = np.diff(np.concatenate([[0], rounds.astype(np.int64), [0]]))
    begins, ends = np.flatnonzero(changes > 0), np.flatnonzero(changes < 0)
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        own: Int64[np.ndarray, " k"] = np.arange(first, last + 2)
        plane, centre_mm, radius = _fit_nominal(position[own])
        off = np.abs(np.linalg.norm(position[own] - centre_mm, axis=1) - radius)
        if len(own) >= _FEWEST_OF_CIRCLE and off.max() < 10.0 * _SAME_MM:
            circle = np.array([*plane, *centre_mm, radius])
            for other, senses in found:
                if np.abs(other - circle).max() < _SAME_CIRCLE_MM:
                    senses.append(own)
                    break
            else:
                found.append((circle, [own]))
    return [np.concatenate(senses) for _, senses in found]


def _evaluate_circle(
    position: Float64[np.ndarray, "n a"],
    own: Int64[np.ndarray, " k"],
    values: SampledVectors,
    predicted_mm: Float64[np.ndarray, "n 3"],
    points: ReducedPoints,
) -> CircleFigures:
    plane, centre_mm, radius_mm = _fit_nominal(position[own])
    out = (position[own] - centre_mm)[:, plane] / radius_mm
    every = points.at.machine.axis_names
    names = "".join(every[int(k)] for k in plane)
    column = ["XYZ".index(name) for name in names]
    across = np.zeros((len(own), 3))
    across[:, column] = out
    measured_um, noise_um, error_um = values.project(own, across)
    expected = UM_PER_MM * np.einsum("ni,ni->n", across, predicted_mm[own])
    raw = _compute_circle_figures(measured_um[:, None], out)
    value = {name: float(raw[name][0]) for name in CIRCLE_FIGURES}
    by_error = _compute_circle_figures(error_um, out)
    model = _compute_circle_figures(expected[:, None], out)
    single = float(error_um.std(axis=1).max())
    apart = np.cov(_centre(error_um, out))
    variance = np.diag(apart)
    pair = float(np.max(variance[:, None] + variance - 2.0 * apart))
    G, u_G = _enclose_largest(value["G"], by_error["G"], max(pair, 0.0) ** 0.5)
    # The smallest is less the largest of −m.
    low, u_low = _enclose_largest(-value["F_min"], -by_error["F_min"], single)
    stated = {
        # A range below 0 is 0: the interval about it still reaches as far up.
        "G": (max(G, 0.0), u_G),
        "F_max": _enclose_largest(value["F_max"], by_error["F_max"], single),
        "F_min": (-low, u_low),
    }
    return CircleFigures(
        names,
        centre_mm,
        radius_mm,
        np.degrees(np.arctan2(out[:, 1], out[:, 0])),
        measured_um,
        _join_figures(stated, _compute_circle_figures(noise_um, out)),
        {name: float(value[0]) for name, value in model.items()},
    )


def _join_figures(
    stated: Mapping[str, tuple[float, float]],
    own: Mapping[str, Float64[np.ndarray, " d"]],
) -> StatedFigures:
    return StatedFigures(
        {name: value for name, (value, _) in stated.items()},
        {name: uncertainty for name, (_, uncertainty) in stated.items()},
        {name: float(one.mean()) for name, one in own.items()},
    )


def _compute_circle_figures(
    radial: Float64[np.ndarray, "n e"], out: Float64[np.ndarray, "n 2"]
) -> dict[str, Float64[np.ndarray, " e"]]:
    return {
        "G": np.ptp(_centre(radial, out), axis=0),
        "F_max": radial.max(axis=0),
        "F_min": radial.min(axis=0),
    }


def _centre(
    radial: Float64[np.ndarray, "n e"], out: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n e"]:
    # Each angle counts once, however often the circle was begun and ended there.
    _, place, count = np.unique(
        np.round(out, 4), axis=0, return_inverse=True, return_counts=True
    )
    root = np.sqrt(1.0 / count[place.ravel()])[:, None]
    columns = np.column_stack([out, np.ones(len(out))])
    fit = np.linalg.pinv(root * columns) @ (root * radial)
    return radial - out @ fit[:2]


def _fit_nominal(
    position: Float64[np.ndarray, "n a"],
) -> tuple[Int64[np.ndarray, "2"], Float64[np.ndarray, " a"], float]:
    plane = np.sort(np.argsort(-np.ptp(position, axis=0))[:2])
    flat = position[:, plane]
    columns = np.column_stack([2.0 * flat, np.ones(len(flat))])
    fitted = np.linalg.pinv(columns) @ (flat**2).sum(axis=1)
    centre = position.mean(axis=0)
    centre[plane] = fitted[:2]
    return plane, centre, float(np.sqrt(fitted[2] + fitted[:2] @ fitted[:2]))


@dataclass(frozen=True, slots=True)
class LineFigures:
    """A line in figures, µm.

    axes : that move on it; kind : `iso-230-2` or `iso-230-6`
    begin_mm, end_mm : (a,) positions of its first and last target
    position_mm : (t,) of targets along it; runs : of each direction at the least
    forward_um, backward_um : (t,) means
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
    figures: StatedFigures
    predicted_um: dict[str, float]


@dataclass(frozen=True, slots=True)
class StaticTestFigures:
    """Lines and circles that were measured at standstill."""

    lines: tuple[LineFigures, ...]
    circles: tuple[CircleFigures, ...]


def evaluate_static_lines_and_circles(
    points: ReducedPoints,
    measured: SampledVectors,
    predicted_mm: Float64[np.ndarray, "n 3"],
) -> StaticTestFigures:
    """Figures of lines and circles of standstills; those on the fly are left out."""
    order = np.flatnonzero(points.at.line < 0)
    position = points.at.position_mm[order]
    values = measured.select(order)
    lines = [
        _evaluate_line(position, passed, values, predicted_mm[order], points)
        for passed in _find_lines(position)
    ]
    circles = [
        _evaluate_circle(position, own, values, predicted_mm[order], points)
        for own in _find_circles(position)
    ]
    return StaticTestFigures(
        tuple(line for line in lines if line is not None), tuple(circles)
    )


@dataclass(frozen=True, slots=True)
class _LinePasses:
    direction: Float64[np.ndarray, " a"]
    origin_mm: Float64[np.ndarray, " a"]
    place: Int64[np.ndarray, " k"]
    sign: Float64[np.ndarray, " k"]


def _find_lines(position: Float64[np.ndarray, "n a"]) -> list[_LinePasses]:
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
    found: list[_LinePasses] = []
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
                found[number] = _LinePasses(
                    direction,
                    line.origin_mm,
                    np.append(line.place, k + 1),
                    np.append(line.sign, sign),
                )
                break
        else:
            place = np.array([k + 1])
            found.append(_LinePasses(direction, position[k], place, np.array([sign])))
    return found


def _evaluate_line(
    position: Float64[np.ndarray, "n a"],
    passed: _LinePasses,
    values: SampledVectors,
    predicted_mm: Float64[np.ndarray, "n 3"],
    points: ReducedPoints,
) -> LineFigures | None:
    """None if it has too few targets or runs, or if a rotary axis turns."""
    machine = points.at.machine
    linear = [machine.axis_names.index(axis.name) for axis in machine.linear_axes]
    direction = passed.direction[linear]
    if np.linalg.norm(direction) < 1.0 - 1e-6:
        return None  # a rotary axis turns
    along = (position[passed.place] - passed.origin_mm) @ passed.direction
    groups = _group_by_target(along, passed.sign)
    if groups is None:
        return None
    at_mm, pairs = groups
    vector = np.zeros(3)
    vector[["XYZ".index(machine.axis_names[k]) for k in linear]] = direction
    along_line = np.tile(vector, (len(passed.place), 1))
    deviation, noise_um, error_um = values.project(passed.place, along_line)
    expected = UM_PER_MM * predicted_mm[passed.place] @ vector
    figures = _compute_line_figures(deviation[:, None], pairs)
    spread = _compute_line_figures(deviation[:, None] + error_um, pairs)
    own = _compute_line_figures(noise_um, pairs)
    stated = {
        name: (float(value[0]), float(spread[name].std()))
        for name, value in figures.items()
    }
    by_error = _compute_line_figures(error_um, pairs)
    for name in ("A", "R"):  # of scatter
        value, uncertainty = _enclose_largest(
            stated[name][0], by_error[name], stated[name][1]
        )
        stated[name] = max(value, 0.0), uncertainty
    model = _compute_line_figures(expected[:, None], pairs)
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
        _join_figures(stated, own),
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


def _compute_line_figures(
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
