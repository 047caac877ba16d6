"""Commanded motion of a machine, and changes to it: hold, resume, change of feed, stop.

Each ride (`profile`) becomes pieces of a timeline, with standstill after the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truepath_simulators.motion.profile import (
    Limits,
    Stretch,
    brake,
    rest_to_rest,
    ride,
)
from truepath_simulators.motion.program import SHORTEST_MM, Program, path_length
from truepath_simulators.timeline import State, Timeline, bend, join, standing, turn

_ROUNDED_MM = 0.01  # of an arc: its ends are rounded, so that it never quite ends


def make_line_timeline(
    stretches: Sequence[Stretch], state: State, begin_s: float, end: np.ndarray | None
) -> Timeline:
    """Stretches on the line of a state, then standstill (at `end` if given)."""
    pieces = [s for s in stretches if s.duration_s > 0.0]
    start, run, speed = [begin_s], [0.0], [state.speed]
    for t, a, j in pieces:
        start.append(start[-1] + t)
        run.append(run[-1] + t * (speed[-1] + t * (a / 2.0 + t * j / 6.0)))
        speed.append(max(speed[-1] + t * (a + t * j / 2.0), 0.0))
    here = state.position[None], state.direction[None], state.curvature[None]
    first, length = np.zeros(len(run), np.int64), np.array(run)
    origin = bend(*here, first, length)
    direction, curvature = turn(*here[1:], first, length)
    curvature[-1] = 0.0
    if end is not None:
        origin[-1] = end
    motion = Timeline(
        np.array(start),
        origin,
        direction,
        np.array([*speed[:-1], 0.0]),
        np.array([*(s.acceleration for s in pieces), 0.0]),
        np.array([*(s.jerk for s in pieces), 0.0]),
        np.full(len(start), state.row),
        curvature,
        state.gone + length,
    )
    return split_at_reversals(motion)


def make_program_timeline(
    program: Program,
    origin: np.ndarray,
    begin_s: float,
    limits: Limits,
    first_row: int = 0,
    gone: float = 0.0,
) -> Timeline:
    """Motion from standstill at `origin` through rows from `first_row`.

    gone : completed length of the arc to the first of these rows
    """
    rows = np.arange(first_row, len(program))
    target = program.position[first_row:]
    begin = np.vstack([origin, target[:-1]])[: len(target)]
    length = path_length(target - begin)
    moved = length > SHORTEST_MM
    direction, curvature = np.zeros_like(target), np.zeros_like(target)
    direction[moved] = (target[moved] - begin[moved]) / length[moved, None]
    done = np.zeros(len(rows))
    done[:1] = gone
    for k, arc in enumerate(program.arc[first_row:]):
        if arc is not None:
            length[k] = arc.length_mm(begin[k]) - done[k]
            moved[k] = length[k] > _ROUNDED_MM
            direction[k] = moved[k] * arc.direction(begin[k])
            curvature[k] = moved[k] * arc.curvature(begin[k])
    stretches = np.zeros((len(rows), 8, 3))
    stretches[moved, :7] = rest_to_rest(
        length[moved], program.feed_mm_s[first_row:][moved], limits
    )
    stretches[:, 7, 0] = program.dwell_s[first_row:]
    lines = _Lines(begin, direction, curvature, target, rows, done)
    return _laid_out(stretches, lines, begin_s, origin)


@dataclass(frozen=True, slots=True)
class _Lines:
    """Lines and arcs to rows, each from its begin; done : completed length of each."""

    begin: np.ndarray
    direction: np.ndarray
    curvature: np.ndarray
    target: np.ndarray
    row: np.ndarray
    done: np.ndarray


def _laid_out(
    stretches: np.ndarray, lines: _Lines, begin_s: float, origin: np.ndarray
) -> Timeline:
    t, a, j = np.moveaxis(stretches, 2, 0)
    change = t * (a + t * j / 2.0)
    speed = np.cumsum(change, axis=1) - change
    step = t * (speed + t * (a / 2.0 + t * j / 6.0))
    run = np.cumsum(step, axis=1) - step
    count, axes = lines.target.shape
    of = np.repeat(np.arange(count), 8)
    place = bend(lines.begin, lines.direction, lines.curvature, of, run.ravel())
    heading, curvature = turn(lines.direction, lines.curvature, of, run.ravel())
    at_end = np.arange(7, 8 * count, 8)
    place[at_end], heading[at_end], curvature[at_end] = lines.target, 0.0, 0.0
    speed[:, 7] = 0.0
    start = begin_s + np.cumsum(t.ravel()) - t.ravel()
    some = t.ravel() > 0.0
    motion = Timeline(
        start[some],
        place.reshape(-1, axes)[some],
        heading.reshape(-1, axes)[some],
        np.maximum(speed, 0.0).ravel()[some],
        a.ravel()[some],
        j.ravel()[some],
        lines.row[of][some],
        curvature.reshape(-1, axes)[some],
        (lines.done[:, None] + run).ravel()[some],
    )
    end = begin_s + float(t.sum())
    last = lines.target[-1] if count else origin
    motion = motion.then(standing(last, end, int(lines.row[-1]) if count else 0))
    return split_at_reversals(motion)


_BISECTIONS = 50  # of a piece of some minutes: to a picosecond


def split_at_reversals(timeline: Timeline) -> Timeline:
    """Arcs are divided where an axis reverses."""
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
    times = [begin_s, *_find_times(own, sorted(at), end_s)]
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


def _find_times(own: Timeline, runs: Sequence[float], end_s: float) -> list[float]:
    """Times of completed lengths, all at once: a controller answers in 0.2 s."""
    low, high = np.full(len(runs), own.start_s[0]), np.full(len(runs), end_s)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_short = own.lengths(middle) - own.gone[0] < runs
        low, high = np.where(is_short, middle, low), np.where(is_short, high, middle)
    return high.tolist()


def hold_motion(timeline: Timeline, time_s: float, limits: Limits) -> Timeline:
    """A motion that brakes along its line from `time_s` on, then stands."""
    state = timeline.state(time_s)
    stretches = brake(state.speed, state.acceleration, limits)
    return timeline.cut(time_s).then(make_line_timeline(stretches, state, time_s, None))


def find_rest(timeline: Timeline, program: Program, time_s: float) -> Program:
    """The program with the remaining dwell if `time_s` is within a dwell.

    After a hold in a dwell its rest follows; elsewhere the program is unchanged.
    """
    left = _remaining_dwell(timeline, time_s)
    if left is None:
        return program
    dwell_s = program.dwell_s.copy()
    dwell_s[timeline.state(time_s).row] = left
    return replace(program, dwell_s=dwell_s)


def resume_motion(
    stopped: Timeline, program: Program, time_s: float, limits: Limits
) -> Timeline:
    """A held motion that continues at `time_s` with the row in which it was held."""
    state = stopped.state(time_s)
    begin = state.position, time_s, limits, state.row, state.gone
    return stopped.cut(time_s).then(make_program_timeline(program, *begin))


def with_feed(
    timeline: Timeline, program: Program, time_s: float, limits: Limits
) -> Timeline:
    """A motion in progress with the feeds of `program` from `time_s` on.

    A line on which the machine already brakes for its end is unchanged.
    """
    state = timeline.state(time_s)
    if state.speed == 0.0 and state.acceleration == 0.0:
        rest = find_rest(timeline, program, time_s)
        begin = state.position, time_s, limits, state.row, state.gone
        return timeline.cut(time_s).then(make_program_timeline(rest, *begin))
    line = _rest_of_line(timeline, program, state, time_s, limits)
    target = program.position[state.row]
    end = target, line.end_s, limits, state.row, line.state(line.end_s).gone
    return line.cut(line.end_s).then(make_program_timeline(program, *end))


def _rest_of_line(
    timeline: Timeline, program: Program, state: State, time_s: float, limits: Limits
) -> Timeline:
    target = program.position[state.row]
    length = float(path_length((target - state.position)[None])[0])
    arc = program.arc[state.row] if program.arc else None
    if arc is not None:
        length = arc.length_mm(state.position) - state.gone
    feed = float(program.feed_mm_s[state.row])
    way = ride(length, feed, state.speed, state.acceleration, limits)
    if way is not None:
        return timeline.cut(time_s).then(make_line_timeline(way, state, time_s, target))
    moving = (timeline.row == state.row) & (np.abs(timeline.direction).max(axis=1) > 0)
    last = int(np.flatnonzero(moving)[-1])
    return timeline.select(slice(0, last + 2))


def _remaining_dwell(timeline: Timeline, time_s: float) -> float | None:
    piece = int(np.searchsorted(timeline.start_s, time_s, side="right")) - 1
    if piece < 0 or piece + 1 >= len(timeline) or timeline.direction[piece].any():
        return None
    return float(timeline.start_s[piece + 1]) - time_s
