"""Figures of what simulation and measurement differ by, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.app.discovery.findings import Gap
from truepath.app.discovery.residual_location import (
    Covariate,
    RunResidual,
    Segment,
    list_covariates,
)
from truepath.app.reporting.chart import EDGE, LEFT, TOP, Frame, Scale, make_panel
from truepath.app.reporting.svg import (
    NUMBER,
    WIDTH,
    Colour,
    draw_curve,
    draw_image,
    draw_segments,
    fill_box,
    join_shapes,
    write_label,
)

_HEIGHT, _ROW = 104.0, 150.0
_BARS, _NAMES = 16.0, 130.0
_HALF = 12.0  # of the level of a class
_POINTS, _BINS, _PROFILES = 240, 24, 6
_COLOURS = (Colour.ACCENT, Colour.SECOND, Colour.THIRD)


def draw_gap(gap: Gap) -> Markup:
    """Draw the gap before and after as bars against the noise floor."""
    frame = Frame(60.0, 20.0, WIDTH - 60.0, 68.0)
    high = 1.1 * max(gap.before_um, gap.after_um, gap.noise_floor_um)
    x = Scale(0.0, high, frame.left, frame.right)
    rows = (
        ("before", gap.before_um, Colour.MUTED),
        ("after", gap.after_um, Colour.ACCENT),
    )
    parts: list[Markup] = []
    for row, (name, value, colour) in enumerate(rows):
        top, end = frame.top + 26.0 * row, _place(x, value)
        parts += [
            write_label(
                frame.left - 6.0, top + 13.0, name, anchor="end", colour=Colour.INK
            ),
            fill_box(frame.left, top, end - frame.left, 18.0, colour),
            write_label(end + 5.0, top + 13.0, f"{value:.2f} µm", colour=Colour.INK),
        ]
    floor = _place(x, gap.noise_floor_um)
    ends = (floor, frame.top - 5.0), (floor, frame.bottom)
    noise = f"noise {gap.noise_floor_um:.2f} µm"
    parts += [
        draw_segments(*ends, Colour.SECOND, width=1.4, dash="4 2"),
        write_label(floor, frame.top - 9.0, noise, anchor="middle"),
    ]
    return draw_image(76.0, "Gap on held-out lines, before and after", parts)


def draw_along_run(residual: RunResidual) -> Markup:
    """Draw the residual along the Run, before and after, on one scale."""
    observations = residual.observations
    time_s = observations.at.time_s - observations.at.time_s.min()
    edges = np.linspace(0.0, float(time_s.max()) + 1e-9, _POINTS + 1)
    drawn = [
        _bin_means(time_s, 1e3 * residual_mm, observations.count, edges)
        for residual_mm in (residual.before.residual_mm, residual.after.residual_mm)
    ]
    reach = 1.05 * max(float(np.abs(mean).max()) for _, mean in drawn)
    parts: list[Markup] = []
    for row, ((at, mean), title) in enumerate(
        zip(drawn, ("Residual along the run, before", "After"), strict=True)
    ):
        top = TOP + 136.0 * row
        frame = Frame(LEFT, top, WIDTH - EDGE, top + _HEIGHT)
        x = frame.make_x(0.0, float(edges[-1]))
        label = "time, s" if row else ""
        parts.append(_draw_components(frame, x, at, mean, reach, title, label))
    parts.append(_draw_key(Frame(LEFT, TOP, WIDTH - EDGE, TOP + _HEIGHT)))
    return draw_image(TOP + 136.0 + _HEIGHT + 28.0, "Residual along the run", parts)


def draw_by_line(before: Sequence[Segment], after: Sequence[Segment]) -> Markup:
    """Draw the root mean square on every line, before and after."""
    frame = Frame(LEFT, TOP, WIDTH - EDGE, TOP + _HEIGHT)
    rows = np.array([s.row for s in before], float)
    high = 1.05 * max(s.rms_um for s in (*before, *after))
    x = frame.make_x(float(rows.min()), float(rows.max()), margin=0.02)
    y = frame.make_y(0.0, high, margin=0.0)
    width = float(np.clip(220.0 / len(rows), 0.5, 3.0))
    parts = [
        frame.write_title("By line: before and, on top of it, after"),
        frame.draw_axes(x, y, "row of the path", "rms, µm", upright=False),
    ]
    for states, colour in ((before, Colour.MUTED), (after, Colour.ACCENT)):
        at = x.place(np.array([s.row for s in states], float))
        rms = y.place(np.array([s.rms_um for s in states]))
        foot = np.full(len(at), frame.bottom)
        ends = np.column_stack([at, foot]), np.column_stack([at, rms])
        parts.append(draw_segments(*ends, colour, width=width))
    return draw_image(TOP + _HEIGHT + 28.0, "Residual by line before and after", parts)


def draw_shares(before: dict[str, float], after: dict[str, float]) -> Markup:
    """Draw the share of the disagreement that each grouping explains."""
    frame = Frame(_NAMES, 8.0, WIDTH - 110.0, 8.0 + _BARS * len(before))
    x = Scale(0.0, max(max(before.values()), 0.05), frame.left, frame.right)
    parts: list[Markup] = []
    for row, (name, share) in enumerate(before.items()):
        top = frame.top + _BARS * row
        end, rest = _place(x, share), after.get(name, 0.0)
        parts += [
            write_label(
                frame.left - 6.0, top + 9.0, name, anchor="end", colour=Colour.INK
            ),
            fill_box(frame.left, top, end - frame.left, 6.0, Colour.MUTED),
            fill_box(
                frame.left, top + 6.0, _place(x, rest) - frame.left, 5.0, Colour.ACCENT
            ),
            write_label(
                max(end, _place(x, rest)) + 5.0,
                top + 9.0,
                f"{100 * share:.0f} %, after {100 * rest:.0f} %",
                size=NUMBER,
            ),
        ]
    return draw_image(frame.bottom + 4.0, "Share explained by each grouping", parts)


def draw_profiles(residual: RunResidual) -> Markup:
    """Draw the mean disagreement against what explains most of it, before."""
    by_name = {c.name: c for c in list_covariates(residual.observations)}
    chosen = [by_name[name] for name in residual.before.shares if name in by_name][
        :_PROFILES
    ]
    parts: list[Markup] = []
    for number, covariate in enumerate(chosen):
        frame = make_panel(*divmod(number, 3), _HEIGHT, _ROW)
        parts.append(_draw_profile(frame, residual, covariate))
    rows = -(-len(chosen) // 3)
    return draw_image(TOP + _ROW * (rows - 1) + _HEIGHT + 28.0, "Profiles", parts)


def _draw_profile(frame: Frame, residual: RunResidual, covariate: Covariate) -> Markup:
    observations = residual.observations
    edges = np.unique(np.quantile(covariate.values, np.linspace(0.0, 1.0, _BINS + 1)))
    if len(edges) <= _BINS // 2:  # few values: a bin for each
        own = np.unique(covariate.values)
        middle = 0.5 * (own[1:] + own[:-1])
        edges = np.concatenate([[own[0] - 1.0], middle, [own[-1] + 1.0]])
    edges[-1] += 1e-9 * max(abs(float(edges[-1])), 1.0)
    at, mean = _bin_means(
        covariate.values, 1e3 * residual.before.residual_mm, observations.count, edges
    )
    reach = 1.05 * max(float(np.abs(mean).max()), 0.1)
    low, high = float(covariate.values.min()), float(covariate.values.max())
    x = frame.make_x(low, high, margin=0.03)
    if covariate.names:
        own = np.unique(covariate.values).tolist()
        x = replace(
            frame.make_x(low, high, margin=0.5),
            names={value: covariate.names[value] for value in own},
        )
    return _draw_components(frame, x, at, mean, reach, covariate.name, covariate.label)


def _draw_components(
    frame: Frame,
    x: Scale,
    at: Float64[np.ndarray, " b"],
    mean: Float64[np.ndarray, "b 3"],
    reach: float,
    title: str,
    label: str,
) -> Markup:
    y = frame.make_y(-reach, reach)
    return join_shapes(
        [
            frame.write_title(title),
            frame.draw_axes(x, y, label, "µm"),
            *(
                _draw_levels(x.place(at), y.place(component), colour)
                if x.names
                else draw_curve(x.place(at), y.place(component), colour, width=1.1)
                for component, colour in zip(mean.T, _COLOURS, strict=True)
            ),
        ]
    )


def _draw_levels(
    x: Float64[np.ndarray, " b"], y: Float64[np.ndarray, " b"], colour: str
) -> Markup:
    begin, end = np.column_stack([x - _HALF, y]), np.column_stack([x + _HALF, y])
    return draw_segments(begin, end, colour, width=2.0)


def _draw_key(frame: Frame) -> Markup:
    parts: list[Markup] = []
    for number, (name, colour) in enumerate(zip("XYZ", _COLOURS, strict=True)):
        x, y = frame.right - 84.0 + 28.0 * number, frame.top - 8.0
        parts.append(draw_segments((x, y), (x + 12.0, y), colour, width=1.6))
        parts.append(write_label(x + 15.0, y + 2.7, name, colour=Colour.INK))
    return join_shapes(parts)


def _bin_means(
    at: Float64[np.ndarray, " n"],
    values: Float64[np.ndarray, "n 3"],
    weight: Float64[np.ndarray, " n"],
    edges: Float64[np.ndarray, " e"],
) -> tuple[Float64[np.ndarray, " b"], Float64[np.ndarray, "b 3"]]:
    """Return weighted means of place and values of the bins that hold anything."""
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    total = np.bincount(index, weight, len(edges) - 1)
    filled = total > 0.0
    sums = [np.bincount(index, weight * v, len(total)) for v in (at, *values.T)]
    place, *means = (s[filled] / total[filled] for s in sums)
    return place, np.stack(means, axis=1)


def _place(scale: Scale, value: float) -> float:
    return float(scale.place(np.array([value]))[0])
