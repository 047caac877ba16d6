"""The path that is driven when nobody has planned a better one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.errors import PlanningError
from app.kinematics.machine import Machine
from app.motion.paths import DEFAULT_FEED_MM_MIN, unit_corners
from app.motion.travel import DECIMALS, inner_travel
from app.planning.line_information import Knowledge, nothing_known
from app.planning.turning_lines import LINES_WITH_ROTARY_AXES, turning_lines
from drivers.interfaces.records import Path

DEFAULT_LINES = 22  # a minute and a half on a small mill
_CANDIDATES = 64  # ends that are judged for each line; corners beside
_LONG = 0.55  # of the diagonal of the travel: no line is shorter


def default_path(
    machine: Machine,
    feed_mm_min: float = DEFAULT_FEED_MM_MIN,
    *,
    lines: int | None = None,
    dwell_s: float = 0.35,
    seed: int = 0,
) -> Path:
    """Return a path of long chords through the travel of the linear axes.

    Each line starts where the last one stopped and ends on a face, an edge or a corner.
    Out of random ends the one is taken that lowers the integrated variance of the
    volumetric error most for the time it takes, so corners recur but lines between
    corners, which share a blind spot, do not prevail. The same seed gives one path.
    Where there are rotary axes, lines turn them as well and every target is measured.

    lines : 22 where it is left out, 72 with rotary axes

    Raises PlanningError if a feed, a dwell or a number of lines cannot be driven.
    """
    turning = bool(machine.rotary_axes)
    if lines is None:
        lines = LINES_WITH_ROTARY_AXES if turning else DEFAULT_LINES
    if feed_mm_min <= 0 or dwell_s < 0 or lines < 1:
        raise PlanningError(
            f"feed {feed_mm_min:g} mm/min, dwell {dwell_s:g} s, {lines} lines: "
            "feed and lines must be above 0, the dwell not below"
        )
    if turning:
        return turning_lines(
            machine, feed_mm_min, lines=lines, dwell_s=dwell_s, seed=seed
        )
    low, high = inner_travel(machine)
    rng = np.random.default_rng(seed)
    known = nothing_known(machine)
    stops = [low]
    for _ in range(lines):
        ends = _ends(rng, stops[-1], low, high)
        best, known = _most_telling(known, stops[-1], ends, feed_mm_min, dwell_s)
        stops.append(ends[best])
    position = np.array(stops)
    n = len(position)
    return Path(
        machine.axis_names, position, np.full(n, feed_mm_min), np.full(n, dwell_s)
    )


def _ends(
    rng: np.random.Generator,
    begin: Float64[np.ndarray, " 3"],
    low: Float64[np.ndarray, " 3"],
    high: Float64[np.ndarray, " 3"],
) -> Float64[np.ndarray, "m 3"]:
    """Draw ends on faces, edges and corners, far enough from the beginning."""
    share = rng.random((_CANDIDATES, 3))
    # One axis, sometimes two or three, at an end of its travel.
    pinned = rng.random((_CANDIDATES, 3)) < 0.4
    pinned[np.arange(_CANDIDATES), rng.integers(0, 3, _CANDIDATES)] = True
    share[pinned] = np.rint(share[pinned])
    share = np.concatenate([share, unit_corners()])
    ends = np.round(low + share * (high - low), DECIMALS)
    length = np.linalg.norm(ends - begin, axis=1)
    return ends[length >= _LONG * np.linalg.norm(high - low)]


def _most_telling(
    known: Knowledge,
    begin: Float64[np.ndarray, " 3"],
    ends: Float64[np.ndarray, "m 3"],
    feed_mm_min: float,
    dwell_s: float,
) -> tuple[int, Knowledge]:
    """Return the end whose line gains most a second, and what is known after it."""
    rows = known.rows(np.tile(begin, (len(ends), 1)), ends)
    length = np.linalg.norm(ends - begin, axis=1)
    time_s = length / (feed_mm_min / 60.0) + dwell_s
    best = int(np.argmax(known.belief.drops(rows) / time_s))
    return best, known.after(rows[best])
