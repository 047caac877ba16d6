"""Divides the arcs of a motion where an axis turns back.

Hidden effects of a reversal then find it at the begin of a piece.
"""

from __future__ import annotations

import numpy as np

from truepath.simulators.program import SHORTEST_MM
from truepath.simulators.timeline import Timeline, join

_BISECTIONS = 50  # of a piece of some minutes: to a picosecond


def split_at_reversals(timeline: Timeline) -> Timeline:
    """Return the motion with its arcs divided where an axis turns back."""
    parts: list[Timeline] = []
    first = 0
    for piece in np.flatnonzero(timeline.curvature.any(axis=1)).tolist():
        parts.append(timeline.select(slice(first, piece)))
        parts.append(_split_piece(timeline, piece))
        first = piece + 1
    if not parts:
        return timeline
    return join([*parts, timeline.select(slice(first, None))])


def _split_piece(timeline: Timeline, piece: int) -> Timeline:
    """Return one piece on an arc as pieces in which no axis turns back."""
    begin_s, end_s = timeline.start_s[piece : piece + 2].tolist()
    own = timeline.select(slice(piece, piece + 1))
    direction, curvature = own.direction[0], own.curvature[0]
    bend_per_mm = float(np.linalg.norm(curvature))
    whole = float(own.state(end_s).gone - own.gone[0])
    at: set[float] = set()
    for d, c in zip(direction, curvature / bend_per_mm, strict=True):
        if np.hypot(d, c) > SHORTEST_MM:  # d cos x + c sin x = 0
            x = float(np.arctan2(-d, c)) % np.pi
            at |= {
                run
                for k in range(int(bend_per_mm * whole / np.pi) + 1)
                if 0.0 < (run := (x + k * np.pi) / bend_per_mm) < whole
            }
    times = [begin_s, *(_find_time(own, run, end_s) for run in sorted(at))]
    times = [t for t in times if begin_s <= t < end_s]
    states = [own.state(t) for t in times]
    return Timeline(
        np.array(times),
        np.array([s.position for s in states]),
        np.array([s.direction for s in states]),
        np.array([s.speed for s in states]),
        np.array([s.acceleration for s in states]),
        np.repeat(own.jerk, len(times)),
        np.repeat(own.row, len(times)),
        np.array([s.curvature for s in states]),
        np.array([s.gone for s in states]),
    )


def _find_time(own: Timeline, run: float, end_s: float) -> float:
    """Return when a length of a single piece is gone."""
    low, high = float(own.start_s[0]), end_s
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if own.state(middle).gone - own.gone[0] < run:
            low = middle
        else:
            high = middle
    return high
