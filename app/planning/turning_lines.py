"""On-the-fly paths of machines with rotary axes: lines that turn and lines that do not.

Every target in turn, a block of lines each. Of random lines - straight ones with the
rotary axes at any angle, turns of one axis or of all, everything together - the one is
taken that lowers the integrated variance of the volumetric error most for the time it
takes. What a target does not show is shown by another: tool targets tell the axes of
the tool side and, seen from the workpiece, all others; targets on the table tell, seen
from the base, the axes that carry it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.errors import PlanningError
from app.kinematics.machine import Machine, RotaryAxis, Target
from app.motion.travel import DECIMALS, inner_travel
from app.motion.turning_points import moving_targets
from app.planning.line_information import Knowledge
from app.planning.turning_information import (
    nothing_known_of_turning,
    slopes_mm,
    turning_conditions,
    turning_rows,
)
from drivers.interfaces.records import Path

LINES_WITH_ROTARY_AXES = 72
FASTEST_DEG_MIN = 1800.0  # of a rotary axis
_CANDIDATES = 24  # ends that are judged for each line
_DRAWS = 4  # of candidates, if the target hardly moves on any of them
_SHORTEST_MM = 100.0  # way of the target on a line, on average
_PINNED = 0.4  # share of the ends of lines that are ends of the travel
_STOP_S = 1.0  # ramps and dwell
_CHANGE_S = 5.0  # for the tracker to turn to another target


@dataclass(frozen=True)
class _Lines:
    """Lines that could be next: ends, feeds towards them, seconds that they take."""

    end: Float64[np.ndarray, "m a"]
    feed: Float64[np.ndarray, " m"]
    time_s: Float64[np.ndarray, " m"]


def turning_lines(
    machine: Machine, feed_mm_min: float, *, lines: int, dwell_s: float, seed: int
) -> Path:
    """Return a planned path of all axes, a block of lines a target.

    The feed is of the linear axes, and less where a rotary axis would turn faster than
    FASTEST_DEG_MIN; where no linear axis moves it is in deg/min. The same seed gives
    the same path. Raises PlanningError if no target moves where the tracker stands.
    """
    rng = np.random.default_rng(seed)
    targets = moving_targets(machine)
    known = nothing_known_of_turning(machine)
    position, feed, dwell = [_begin(machine)], [feed_mm_min], [dwell_s]
    names = [targets[0].name]
    for count, target in zip(_shares(lines, len(targets)), targets, strict=True):
        if target.name != names[-1]:
            position.append(position[-1])
            feed.append(feed_mm_min)
            dwell.append(_CHANGE_S)
            names.append(target.name)
        for _ in range(count):
            end, speed, known = _next(rng, known, target, position[-1], feed_mm_min)
            position.append(end)
            feed.append(speed)
            dwell.append(dwell_s)
            names.append(target.name)
    return Path(
        machine.axis_names,
        np.array(position),
        np.round(feed, 1),
        np.array(dwell),
        tuple(names) if any(names) else (),
    )


def _shares(lines: int, targets: int) -> list[int]:
    """Spread lines over targets as evenly as it goes."""
    return [lines * (k + 1) // targets - lines * k // targets for k in range(targets)]


def _begin(machine: Machine) -> Float64[np.ndarray, " a"]:
    low, high = inner_travel(machine)
    rotary = np.array([isinstance(axis, RotaryAxis) for axis in machine.axes])
    return np.where(rotary, np.clip(0.0, low, high), low)


def _next(
    rng: np.random.Generator,
    known: Knowledge,
    target: Target,
    begin: Float64[np.ndarray, " a"],
    feed_mm_min: float,
) -> tuple[Float64[np.ndarray, " a"], float, Knowledge]:
    """Return the end of the best next line, the feed to it, and what is known then."""
    machine = known.model.machine
    for _ in range(_DRAWS):
        lines = _timed(machine, begin, _ends(rng, machine, begin), feed_mm_min)
        begins = np.tile(begin, (len(lines.end), 1))
        at = turning_conditions(machine, target, begins, lines.end)
        slope = slopes_mm(at)
        rows = turning_rows(known, at, slope)
        gain = known.belief.drops(rows) / lines.time_s
        gain[np.linalg.norm(slope, axis=2).mean(axis=1) < _SHORTEST_MM] = -1.0
        best = int(np.argmax(gain))
        if gain[best] > 0.0:
            return lines.end[best], float(lines.feed[best]), known.after(rows[best])
    raise PlanningError(
        f"target {target.name} hardly moves where the tracker stands: no line takes it "
        f"{_SHORTEST_MM:g} mm far; place it farther from the axes that turn it"
    )


def _ends(
    rng: np.random.Generator, machine: Machine, begin: Float64[np.ndarray, " a"]
) -> Float64[np.ndarray, "m a"]:
    """Draw ends of lines: straight ones, turns, and everything together."""
    low, high = inner_travel(machine)
    share = rng.random((_CANDIDATES, len(low)))
    pinned = rng.random(share.shape) < _PINNED
    share[pinned] = np.rint(share[pinned])
    end = np.round(low + share * (high - low), DECIMALS)
    rotary = np.array([isinstance(axis, RotaryAxis) for axis in machine.axes])
    kind = np.arange(_CANDIDATES) % 4
    moves = np.ones(end.shape, bool)
    moves[kind == 0] = ~rotary
    moves[kind == 1] = rotary
    one = np.flatnonzero(kind == 2)
    moves[one] = False
    moves[one, rng.choice(np.flatnonzero(rotary), len(one))] = True
    return np.where(moves, end, begin)


def _timed(
    machine: Machine,
    begin: Float64[np.ndarray, " a"],
    end: Float64[np.ndarray, "m a"],
    feed_mm_min: float,
) -> _Lines:
    """Return feeds at which no rotary axis turns too fast, and the times."""
    rotary = np.array([isinstance(axis, RotaryAxis) for axis in machine.axes])
    step = end - begin
    straight = np.linalg.norm(step[:, ~rotary], axis=1)
    turn = np.linalg.norm(step[:, rotary], axis=1)
    most = np.abs(step[:, rotary]).max(axis=1)
    minutes = np.maximum(straight / feed_mm_min, most / FASTEST_DEG_MIN)
    length = straight + turn * (straight == 0.0)  # formats.md: what the feed counts
    feed = length / np.maximum(minutes, 1e-9)
    return _Lines(end, feed, 60.0 * minutes + _STOP_S)
