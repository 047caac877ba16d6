"""Changes to a motion in progress: hold, resume, change of feed, stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truepath_simulators.motion.driven_motion import (
    make_line_timeline,
    make_program_timeline,
)
from truepath_simulators.motion.profile import Limits, brake, ride
from truepath_simulators.motion.program import Program, path_length
from truepath_simulators.timeline import State, Timeline


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
    return timeline.first(last + 2)


def _remaining_dwell(timeline: Timeline, time_s: float) -> float | None:
    piece = int(np.searchsorted(timeline.start_s, time_s, side="right")) - 1
    if piece < 0 or piece + 1 >= len(timeline) or timeline.direction[piece].any():
        return None
    return float(timeline.start_s[piece + 1]) - time_s
