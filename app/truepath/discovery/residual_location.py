"""Location of residuals: by line, axis, position, direction, time, feed.

The share of a grouping is the part of the squared residual in the means of its groups:
an effect that follows the line's number shows there and not elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.kinematics.machine.machine import position_unit

_BINS, _SIDE = 8, 4
_SIDES = {-1.0: "− direction", 0.0: "not yet moved", 1.0: "+ direction"}


@dataclass(frozen=True, slots=True)
class Segment:
    """Residual on one line or standstill.

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
class ResidualLocation:
    """Segments, the worst first, and the share of each grouping.

    residual_mm : (n, 3) of the cells, in the frame that the tracker is mounted on
    """

    residual_mm: Float64[np.ndarray, "n 3"]
    segments: tuple[Segment, ...]
    shares: dict[str, float]


@dataclass(frozen=True)
class RunResidual:
    observations: Observations
    before: ResidualLocation
    after: ResidualLocation


@dataclass(frozen=True)
class Covariate:
    """A number of each cell that the residual may depend on.

    label : with its unit; is_class : cells are grouped by the number itself
    names : of the classes, where their numbers mean nothing to a reader
    """

    name: str
    label: str
    values: Float64[np.ndarray, " n"]
    is_class: bool = False
    names: Mapping[float, str] | None = None


def list_covariates(seen: Observations) -> list[Covariate]:
    """Candidates for grouping residuals, by the names of their shares."""
    at, recorded = seen.at, seen.at.recorded
    length_mm = np.linalg.norm(seen.tracker_mm, axis=1)
    speed = np.linalg.norm(at.velocity_mm_s, axis=1)
    found = [
        Covariate("line", "row of the path", seen.row.astype(float), is_class=True),
        Covariate("time", "time, s", at.time_s - float(at.time_s.min())),
        Covariate("beam", "length of the beam, mm", length_mm),
    ]
    if np.ptp(speed) > 0.01 * max(float(speed.max()), 1e-9):
        found.append(Covariate("feed", "feed, mm/min", 60.0 * speed))
    for column, axis in enumerate(at.machine.axes):
        label, place = f"{axis.name}, {position_unit(axis)}", at.position_mm[:, column]
        found.append(Covariate(f"position of {axis.name}", label, place))
        name = f"direction of {axis.name}"
        side = at.approach[:, column]
        found.append(Covariate(name, "", side, is_class=True, names=_SIDES))
    if recorded is not None and recorded.temperature_degc is not None:
        celsius = recorded.temperature_degc.T
        for name, column in zip(recorded.sensors, celsius, strict=True):
            found.append(Covariate(f"temperature of {name}", f"{name}, °C", column))
    return found


def locate_residual(
    seen: Observations, residual_mm: Float64[np.ndarray, "n 3"]
) -> ResidualLocation:
    """Segments sorted by root mean square, and shares of all groupings."""
    parts = [slice(first, last) for first, last in seen.lines]
    segments = [_describe_segment(seen, residual_mm, part) for part in parts]
    segments.sort(key=lambda s: -s.rms_um)
    shares = {
        name: _find_share(residual_mm, seen.count, group)
        for name, group in _list_groups(seen).items()
    }
    ordered = dict(sorted(shares.items(), key=lambda item: -item[1]))
    return ResidualLocation(residual_mm, tuple(segments), ordered)


def _describe_segment(
    seen: Observations, residual_mm: Float64[np.ndarray, "n 3"], part: slice
) -> Segment:
    first = part.start
    weight = seen.count[part] / seen.count[part].sum()
    square = float(weight @ np.sum(residual_mm[part] ** 2, axis=1))
    rate = np.zeros(len(seen.at.machine.axes))
    if seen.at.recorded is not None:
        rate = seen.at.recorded.rate[first]
    main = int(np.argmax(np.abs(rate)))
    sign = "+" if rate[main] > 0.0 else "-"
    moves = bool(rate.any())
    return Segment(
        int(seen.row[first]),
        seen.at.machine.axis_names[main] if moves else "",
        sign if moves else "",
        _describe_region(seen, part),
        float(seen.at.time_s[part].mean()),
        float(np.linalg.norm(seen.at.velocity_mm_s[first])) * 60.0,
        float(np.sqrt(square)) * 1e3,
    )


def _describe_region(seen: Observations, part: slice) -> str:
    low = seen.at.position_mm[part].min(axis=0)
    high = seen.at.position_mm[part].max(axis=0)
    return ", ".join(
        f"{name} {a:.0f}" if b - a < 0.5 else f"{name} {a:.0f} to {b:.0f}"
        for name, a, b in zip(seen.at.machine.axis_names, low, high, strict=True)
    )


def _list_groups(seen: Observations) -> dict[str, Int64[np.ndarray, " n"]]:
    at = seen.at
    groups = {
        one.name: one.values.astype(np.int64) if one.is_class else _bin(one.values)
        for one in list_covariates(seen)
    }
    for one, two in combinations(at.machine.linear_axes, 2):
        row, column = (_bin(at.axis_mm(a.name), _SIDE) for a in (one, two))
        groups[f"region of {one.name} and {two.name}"] = _SIDE * row + column
    if at.recorded is not None:
        speed = np.abs(at.recorded.rate)
        fastest = np.argmax(speed, axis=1)
        groups["moving axis"] = np.where(speed.max(axis=1) > 0.0, fastest, -1)
    return groups


def _bin(
    values: Float64[np.ndarray, " n"], bins: int = _BINS
) -> Int64[np.ndarray, " n"]:
    edges = np.quantile(values, np.linspace(0.0, 1.0, bins + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values, side="right"), np.int64)


def _find_share(
    residual_mm: Float64[np.ndarray, "n 3"],
    weight: Float64[np.ndarray, " n"],
    group: Int64[np.ndarray, " n"],
) -> float:
    _, index = np.unique(group, return_inverse=True)
    total = np.bincount(index, weight)
    means = np.stack([np.bincount(index, weight * c) / total for c in residual_mm.T])
    held = float(np.sum(total * np.sum(means**2, axis=0)))
    return held / max(float(np.sum(weight * np.sum(residual_mm**2, axis=1))), 1e-300)
