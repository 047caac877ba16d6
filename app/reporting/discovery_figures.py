"""Figures of what simulation and measurement differ by, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.discovery.discover import Gap
from app.discovery.where import Segment, Shown
from app.kinematics.machine import position_unit
from app.reporting.chart import Frame, Scale
from app.reporting.svg import (
    NUMBER,
    WIDTH,
    Colour,
    box,
    curve,
    image,
    segments,
    words,
)

_TOP, _LEFT, _EDGE, _GAP = 16.0, 36.0, 7.0, 40.0
_HEIGHT, _ROW = 104.0, 150.0
_BARS, _NAMES = 16.0, 130.0
_POINTS, _BINS, _PROFILES = 240, 24, 6
_COLOURS = (Colour.ACCENT, Colour.SECOND, Colour.THIRD)


@dataclass(frozen=True)
class Covariate:
    """What the disagreement may depend on: a number of each cell."""

    name: str
    label: str
    values: Float64[np.ndarray, " n"]


def covariates(seen: Observations) -> dict[str, Covariate]:
    """Return what the disagreement is located by, under the names of its shares."""
    at, around = seen.at, seen.at.recorded
    begin = float(at.time_s.min())
    found = [
        Covariate("line", "row of the path", seen.row.astype(np.float64)),
        Covariate("time", "time, s", at.time_s - begin),
        Covariate("beam", "length of the beam, mm", _length(seen.tracker_mm)),
        Covariate("feed", "feed, mm/min", 60.0 * _length(at.velocity_mm_s)),
    ]
    for column, axis in enumerate(at.machine.axes):
        unit = f"{axis.name}, {position_unit(axis)}"
        position, approach = at.position_mm[:, column], at.approach[:, column]
        found.append(Covariate(f"position of {axis.name}", unit, position))
        name = f"direction of {axis.name}"
        found.append(Covariate(name, f"direction of {axis.name}", approach))
    if around is not None and around.temperature_degc is not None:
        for name, column in zip(around.sensors, around.temperature_degc.T, strict=True):
            found.append(Covariate(f"temperature of {name}", f"{name}, °C", column))
    return {c.name: c for c in found}


def gap_figure(gap: Gap) -> str:
    """Draw the gap before and after as bars against the noise floor."""
    frame = Frame(60.0, 20.0, WIDTH - 60.0, 68.0)
    high = 1.1 * max(gap.before_um, gap.after_um, gap.noise_floor_um)
    x = Scale(0.0, high, frame.left, frame.right)
    rows = (
        ("before", gap.before_um, Colour.MUTED),
        ("after", gap.after_um, Colour.ACCENT),
    )
    parts: list[str] = []
    for row, (name, value, colour) in enumerate(rows):
        top, end = frame.top + 26.0 * row, _place(x, value)
        parts += [
            words(frame.left - 6.0, top + 13.0, name, anchor="end", colour=Colour.INK),
            box(frame.left, top, end - frame.left, 18.0, colour),
            words(end + 5.0, top + 13.0, f"{value:.2f} µm", colour=Colour.INK),
        ]
    floor = _place(x, gap.noise_floor_um)
    begin, end = np.array([[floor, frame.top - 5.0]]), np.array([[floor, frame.bottom]])
    parts += [
        segments(begin, end, Colour.SECOND, width=1.4, dash="4 2"),
        words(
            floor,
            frame.top - 9.0,
            f"noise {gap.noise_floor_um:.2f} µm",
            anchor="middle",
        ),
    ]
    return image(76.0, "Gap on lines not seen, before and after", parts)


def along_run_figure(shown: Shown) -> str:
    """Draw what is left along the Run, before and after, on one scale."""
    seen = shown.seen
    time_s = seen.at.time_s - seen.at.time_s.min()
    edges = np.linspace(0.0, float(time_s.max()) + 1e-9, _POINTS + 1)
    drawn = [
        _binned(time_s, 1e3 * left, seen.count, edges)
        for left in (shown.left_before_mm, shown.left_after_mm)
    ]
    reach = 1.05 * max(float(np.abs(mean).max()) for _, mean in drawn)
    parts: list[str] = []
    for row, ((at, mean), title) in enumerate(
        zip(drawn, ("Residual along the run, before", "After"), strict=True)
    ):
        top = _TOP + 136.0 * row
        frame = Frame(_LEFT, top, WIDTH - _EDGE, top + _HEIGHT)
        x = frame.across(0.0, float(edges[-1]))
        label = "time, s" if row else ""
        parts.append(_components(frame, x, at, mean, reach, title, label))
    parts.append(_key(Frame(_LEFT, _TOP, WIDTH - _EDGE, _TOP + _HEIGHT)))
    return image(_TOP + 136.0 + _HEIGHT + 28.0, "Residual along the run", parts)


def by_line_figure(before: Sequence[Segment], after: Sequence[Segment]) -> str:
    """Draw the root mean square on every line, before and after."""
    frame = Frame(_LEFT, _TOP, WIDTH - _EDGE, _TOP + _HEIGHT)
    rows = np.array([s.row for s in before], float)
    high = 1.05 * max(s.rms_um for s in (*before, *after))
    x = frame.across(float(rows.min()), float(rows.max()), margin=0.02)
    y = frame.up(0.0, high, margin=0.0)
    width = float(np.clip(220.0 / len(rows), 0.5, 3.0))
    parts = [
        frame.title("By line: before and, on top of it, after"),
        frame.drawn(x, y, "row of the path", "rms, µm", upright=False),
    ]
    for states, colour in ((before, Colour.MUTED), (after, Colour.ACCENT)):
        at = x.at(np.array([s.row for s in states], float))
        rms = y.at(np.array([s.rms_um for s in states]))
        foot = np.full(len(at), frame.bottom)
        begin, end = np.column_stack([at, foot]), np.column_stack([at, rms])
        parts.append(segments(begin, end, colour, width=width))
    return image(_TOP + _HEIGHT + 28.0, "Residual by line before and after", parts)


def shares_figure(before: dict[str, float], after: dict[str, float]) -> str:
    """Draw the share of the disagreement that each grouping explains."""
    frame = Frame(_NAMES, 8.0, WIDTH - 110.0, 8.0 + _BARS * len(before))
    x = Scale(0.0, max(max(before.values()), 0.05), frame.left, frame.right)
    parts: list[str] = []
    for row, (name, share) in enumerate(before.items()):
        top = frame.top + _BARS * row
        end, left = _place(x, share), after.get(name, 0.0)
        parts += [
            words(frame.left - 6.0, top + 9.0, name, anchor="end", colour=Colour.INK),
            box(frame.left, top, end - frame.left, 6.0, Colour.MUTED),
            box(
                frame.left, top + 6.0, _place(x, left) - frame.left, 5.0, Colour.ACCENT
            ),
            words(
                max(end, _place(x, left)) + 5.0,
                top + 9.0,
                f"{100 * share:.0f} %, after {100 * left:.0f} %",
                size=NUMBER,
            ),
        ]
    return image(frame.bottom + 4.0, "Share explained by each grouping", parts)


def profiles_figure(shown: Shown) -> str:
    """Draw the mean disagreement against what explains most of it, before."""
    known = covariates(shown.seen)
    chosen = [known[name] for name in shown.before.shares if name in known][:_PROFILES]
    parts: list[str] = []
    for number, covariate in enumerate(chosen):
        row, column = divmod(number, 3)
        width = (WIDTH - _LEFT - 2 * _GAP - _EDGE) / 3
        left, top = _LEFT + column * (width + _GAP), _TOP + row * _ROW
        frame = Frame(left, top, left + width, top + _HEIGHT)
        parts.append(_profile(frame, shown, covariate))
    rows = -(-len(chosen) // 3)
    return image(_TOP + _ROW * (rows - 1) + _HEIGHT + 28.0, "Profiles", parts)


def _profile(frame: Frame, shown: Shown, covariate: Covariate) -> str:
    seen = shown.seen
    edges = np.unique(np.quantile(covariate.values, np.linspace(0.0, 1.0, _BINS + 1)))
    if len(edges) <= _BINS // 2:  # few values: a bin for each
        own = np.unique(covariate.values)
        middle = 0.5 * (own[1:] + own[:-1])
        edges = np.concatenate([[own[0] - 1.0], middle, [own[-1] + 1.0]])
    edges[-1] += 1e-9 * max(abs(float(edges[-1])), 1.0)
    at, mean = _binned(covariate.values, 1e3 * shown.left_before_mm, seen.count, edges)
    reach = 1.05 * max(float(np.abs(mean).max()), 0.1)
    low, high = float(covariate.values.min()), float(covariate.values.max())
    x = frame.across(low, high, margin=0.03)
    return _components(frame, x, at, mean, reach, covariate.name, covariate.label)


def _components(
    frame: Frame,
    x: Scale,
    at: Float64[np.ndarray, " b"],
    mean: Float64[np.ndarray, "b 3"],
    reach: float,
    title: str,
    label: str,
) -> str:
    y = frame.up(-reach, reach)
    return "".join(
        [
            frame.title(title),
            frame.drawn(x, y, label, "µm"),
            *(
                curve(x.at(at), y.at(component), colour, width=1.1)
                for component, colour in zip(mean.T, _COLOURS, strict=True)
            ),
        ]
    )


def _key(frame: Frame) -> str:
    parts: list[str] = []
    for number, (name, colour) in enumerate(zip("XYZ", _COLOURS, strict=True)):
        x, y = frame.right - 84.0 + 28.0 * number, frame.top - 8.0
        line = np.array([[x, y]]), np.array([[x + 12.0, y]])
        parts.append(segments(*line, colour, width=1.6))
        parts.append(words(x + 15.0, y + 2.7, name, colour=Colour.INK))
    return "".join(parts)


def _binned(
    at: Float64[np.ndarray, " n"],
    values: Float64[np.ndarray, "n 3"],
    weight: Float64[np.ndarray, " n"],
    edges: Float64[np.ndarray, " e"],
) -> tuple[Float64[np.ndarray, " b"], Float64[np.ndarray, "b 3"]]:
    """Return weighted means of place and values of the bins that hold anything."""
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    total = np.bincount(index, weight, len(edges) - 1)
    told = total > 0.0
    sums = [np.bincount(index, weight * v, len(total)) for v in (at, *values.T)]
    place, *means = (s[told] / total[told] for s in sums)
    return place, np.stack(means, axis=1)


def _length(vector: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    return np.linalg.norm(vector, axis=1)


def _place(scale: Scale, value: float) -> float:
    return float(scale.at(np.array([value]))[0])
