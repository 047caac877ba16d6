"""Where measured and simulated disagree: by line, axis, place, direction, time, feed.

What a grouping explains is the share of the squared disagreement that the means of its
groups hold: an effect that follows the line's number shows there and not elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float64, Int64

from app.alignment.observations import Observations
from app.discovery.view import stretches

_BINS, _SIDE = 8, 4


@dataclass(frozen=True, slots=True)
class Segment:
    """Disagreement on one line or standstill.

    row : of the path; axis : that moves most, empty at a standstill; region : in words
    """

    row: int
    axis: str
    direction: str
    region: str
    time_s: float
    feed_mm_min: float
    rms_um: float


@dataclass(frozen=True)
class Where:
    """Segments, the worst first, and the share that each grouping explains."""

    segments: tuple[Segment, ...]
    shares: dict[str, float]


@dataclass(frozen=True)
class Shown:
    """What is left of one Run, before the effects are in the model and with them.

    left_before_mm, left_after_mm : (n, 3) of its cells, where the tracker stands
    before, after : where that lies
    """

    seen: Observations
    left_before_mm: Float64[np.ndarray, "n 3"]
    left_after_mm: Float64[np.ndarray, "n 3"]
    before: Where
    after: Where


def shown(
    seen: Observations,
    left_before_mm: Float64[np.ndarray, "n 3"],
    left_after_mm: Float64[np.ndarray, "n 3"],
) -> Shown:
    """Return what is left of a Run, and where it lies."""
    before, after = where(seen, left_before_mm), where(seen, left_after_mm)
    return Shown(seen, left_before_mm, left_after_mm, before, after)


def where(seen: Observations, left_mm: Float64[np.ndarray, "n 3"]) -> Where:
    """Return where what is left lies."""
    segments = [_segment(seen, left_mm, first, last) for first, last in stretches(seen)]
    segments.sort(key=lambda s: -s.rms_um)
    groups = _groups(seen)
    shares = {name: _explained(left_mm, seen.count, g) for name, g in groups.items()}
    ordered = dict(sorted(shares.items(), key=lambda item: -item[1]))
    return Where(tuple(segments), ordered)


def _segment(
    seen: Observations, left_mm: Float64[np.ndarray, "n 3"], first: int, last: int
) -> Segment:
    part = slice(first, last)
    weight = seen.count[part] / seen.count[part].sum()
    square = float(weight @ np.sum(left_mm[part] ** 2, axis=1))
    rate = np.zeros(len(seen.at.machine.axes))
    if seen.at.recorded is not None:
        rate = seen.at.recorded.rate[first]
    names, main = seen.at.machine.axis_names, int(np.argmax(np.abs(rate)))
    moves = bool(rate.any())
    return Segment(
        int(seen.row[first]),
        names[main] if moves else "",
        ("+" if rate[main] > 0.0 else "-") if moves else "",
        _region(seen, first, last),
        float(seen.at.time_s[part].mean()),
        float(np.linalg.norm(seen.at.velocity_mm_s[first])) * 60.0,
        float(np.sqrt(square)) * 1e3,
    )


def _region(seen: Observations, first: int, last: int) -> str:
    low = seen.at.position_mm[first:last].min(axis=0)
    high = seen.at.position_mm[first:last].max(axis=0)
    return ", ".join(
        f"{name} {a:.0f}" if b - a < 0.5 else f"{name} {a:.0f} to {b:.0f}"
        for name, a, b in zip(seen.at.machine.axis_names, low, high, strict=True)
    )


def _groups(seen: Observations) -> dict[str, Int64[np.ndarray, " n"]]:
    at = seen.at
    distance = np.linalg.norm(seen.tracker_mm, axis=1)
    groups = {"line": seen.row, "time": _binned(at.time_s)}
    groups["beam"] = _binned(distance)
    speed = np.linalg.norm(at.velocity_mm_s, axis=1)
    if np.ptp(speed) > 0.01 * max(float(speed.max()), 1e-9):
        groups["feed"] = _binned(speed)
    for column, name in enumerate(at.machine.axis_names):
        groups[f"position of {name}"] = _binned(at.position_mm[:, column])
        sign = np.sign(at.approach[:, column]).astype(np.int64)
        groups[f"direction of {name}"] = sign
    for one, two in combinations(at.machine.linear_axes, 2):
        row, column = (_binned(at.axis_mm(a.name), _SIDE) for a in (one, two))
        groups[f"region of {one.name} and {two.name}"] = _SIDE * row + column
    if at.recorded is not None:
        groups["moving axis"] = _moving(at.recorded.rate)
    if at.recorded is not None and at.recorded.temperature_degc is not None:
        celsius = at.recorded.temperature_degc.T
        for name, column in zip(at.recorded.sensors, celsius, strict=True):
            groups[f"temperature of {name}"] = _binned(column)
    return groups


def _moving(rate: Float64[np.ndarray, "n a"]) -> Int64[np.ndarray, " n"]:
    """Return which axis moves most in each cell, −1 where none does."""
    main = np.argmax(np.abs(rate), axis=1)
    return np.where(np.abs(rate).max(axis=1) > 0.0, main, -1)


def _binned(
    values: Float64[np.ndarray, " n"], bins: int = _BINS
) -> Int64[np.ndarray, " n"]:
    edges = np.quantile(values, np.linspace(0.0, 1.0, bins + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values, side="right"), np.int64)


def _explained(
    left_mm: Float64[np.ndarray, "n 3"],
    weight: Float64[np.ndarray, " n"],
    group: Int64[np.ndarray, " n"],
) -> float:
    """Return the share of the weighted squares that the groups' means hold."""
    _, index = np.unique(group, return_inverse=True)
    total = np.bincount(index, weight)
    means = np.stack([np.bincount(index, weight * c) / total for c in left_mm.T])
    held = float(np.sum(total * np.sum(means**2, axis=0)))
    return held / max(float(np.sum(weight * np.sum(left_mm**2, axis=1))), 1e-300)
