"""A whole motion as pieces of constant jerk along straight lines and arcs.

The pieces follow one another without a gap; the last one stands still for ever. Where
the machine is follows in closed form for any times at once. A motion is changed under
way by cutting the timeline and appending another future. Within a piece no axis turns
back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truepath.simulators.arc import Arc
from truepath.simulators.profile import Limits, Stretch, rest_to_rest

# A line shorter than this is no line: waypoints come in steps of 0.1 µm.
SHORTEST_MM = 1e-6
_ROUNDED_MM = 0.01  # of an arc: its ends are rounded, so that it never quite ends
_BISECTIONS = 50  # of a piece of some minutes: to a picosecond
_LINEAR = 3  # columns are X, Y, Z, then the rotary axes


def path_length(step: np.ndarray) -> np.ndarray:
    """Return the lengths that the feed counts of steps (n, axes) between waypoints.

    That of the straight axes in mm; where none of them moves, that of the rotary axes
    in deg.
    """
    straight = np.linalg.norm(step[:, :_LINEAR], axis=1)
    turn = np.linalg.norm(step[:, _LINEAR:], axis=1)
    return np.where(straight > SHORTEST_MM, straight, turn)


@dataclass(frozen=True, slots=True)
class State:
    """Where the machine is at one moment, and how fast along its line.

    curvature : change of the direction per length; gone : length of its line so far
    """

    position: np.ndarray
    direction: np.ndarray
    speed: float
    acceleration: float
    row: int
    curvature: np.ndarray
    gone: float


@dataclass(frozen=True, slots=True)
class Timeline:
    """Pieces in order of time; all arrays have one entry a piece.

    Lengths are those that the feed counts, `path_length`.

    start_s : begin on the clock of the machine
    origin, direction : (m, axes), begin of the piece and step per length of its line
    speed, acceleration, jerk : at its begin, along the line; all zero while standing
    row : row of the path that the machine moves towards or dwells at
    curvature : (m, axes) change of the direction per length at its begin; zero on a
        straight line
    gone : length of the line to its row before it
    """

    start_s: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    row: np.ndarray
    curvature: np.ndarray
    gone: np.ndarray

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def end_s(self) -> float:
        """When the last piece begins: from then on the machine stands."""
        return float(self.start_s[-1])

    def positions(self, time_s: np.ndarray) -> np.ndarray:
        """Return axis positions (n, axes) at times (n,)."""
        piece, run = self._run(time_s)
        return bend(self.origin, self.direction, self.curvature, piece, run)

    def directions(self, time_s: np.ndarray) -> np.ndarray:
        """Return the step of the axes (n, axes) per length at times (n,)."""
        return turn(self.direction, self.curvature, *self._run(time_s))[0]

    def curvatures(self, time_s: np.ndarray) -> np.ndarray:
        """Return the change of the direction (n, axes) per length at times (n,)."""
        return turn(self.direction, self.curvature, *self._run(time_s))[1]

    def speeds(self, time_s: np.ndarray) -> np.ndarray:
        """Return speeds along the path (n,) at times (n,)."""
        piece, t = self._locate(time_s)
        return self.speed[piece] + t * (
            self.acceleration[piece] + t * self.jerk[piece] / 2.0
        )

    def accelerations(self, time_s: np.ndarray) -> np.ndarray:
        """Return accelerations along the path (n,) at times (n,)."""
        piece, t = self._locate(time_s)
        return self.acceleration[piece] + t * self.jerk[piece]

    def rows(self, time_s: np.ndarray) -> np.ndarray:
        """Return the row that the machine moves towards or dwells at, (n,)."""
        return self.row[self._locate(time_s)[0]]

    def state(self, time_s: float) -> State:
        """Return position, line and speed at one time."""
        at = np.array([time_s])
        (piece,), (run,) = self._run(at)
        return State(
            position=self.positions(at)[0],
            direction=self.directions(at)[0],
            speed=max(float(self.speeds(at)[0]), 0.0),
            acceleration=float(self.accelerations(at)[0]),
            row=int(self.row[piece]),
            curvature=self.curvatures(at)[0],
            gone=float(self.gone[piece] + run),
        )

    def cut(self, time_s: float) -> Timeline:
        """Return what was before a time; the last piece is the one running then."""
        keep = max(int(np.searchsorted(self.start_s, time_s, side="left")), 1)
        return self.first(keep)

    def first(self, count: int) -> Timeline:
        """Return the first pieces."""
        return self.select(slice(0, count))

    def last(self, count: int) -> Timeline:
        """Return the last pieces."""
        return self.select(slice(-count, None))

    def since(self, time_s: float) -> Timeline:
        """Forget what ended before a time."""
        piece = int(self._locate(np.array([time_s]))[0][0])
        return self.select(slice(piece, None))

    def then(self, other: Timeline) -> Timeline:
        """Return this timeline with another appended, which begins later."""
        return join([self, other])

    def select(self, part: slice) -> Timeline:
        """Return some of the pieces."""
        return Timeline(*(getattr(self, name)[part] for name in Timeline.__slots__))

    def _run(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the piece and the length gone in it at times (n,)."""
        piece, t = self._locate(time_s)
        change = self.acceleration[piece] / 2.0 + t * self.jerk[piece] / 6.0
        return piece, t * (self.speed[piece] + t * change)

    def _locate(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        piece = np.searchsorted(self.start_s, time_s, side="right") - 1
        piece = np.maximum(piece, 0)
        return piece, np.maximum(time_s - self.start_s[piece], 0.0)


def bend(
    origin: np.ndarray,
    direction: np.ndarray,
    curvature: np.ndarray,
    piece: np.ndarray,
    run: np.ndarray,
) -> np.ndarray:
    """Return where lengths (n,) of pieces (n,) lead to, along circles and lines."""
    x = run * np.linalg.norm(curvature, axis=1)[piece]
    along, aside = run * np.sinc(x / np.pi), 0.5 * (run * np.sinc(0.5 * x / np.pi)) ** 2
    return (
        origin[piece]
        + along[:, None] * direction[piece]
        + aside[:, None] * curvature[piece]
    )


def turn(
    direction: np.ndarray, curvature: np.ndarray, piece: np.ndarray, run: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return direction and curvature after lengths (n,) of pieces (n,)."""
    square = (curvature**2).sum(axis=1)[piece]
    x = run * np.sqrt(square)
    cosine, along = np.cos(x)[:, None], (run * np.sinc(x / np.pi))[:, None]
    return (
        cosine * direction[piece] + along * curvature[piece],
        cosine * curvature[piece] - along * square[:, None] * direction[piece],
    )


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


def join(parts: Sequence[Timeline]) -> Timeline:
    """Return timelines one after another."""
    return Timeline(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in Timeline.__slots__
        )
    )


def standing(
    position: Sequence[float] | np.ndarray, since_s: float, row: int
) -> Timeline:
    """Return a machine that stands still for ever."""
    origin = np.array([position], dtype=float)
    zero = np.zeros(1)
    return Timeline(
        np.array([since_s]),
        origin,
        np.zeros_like(origin),
        zero,
        zero,
        zero,
        np.array([row]),
        np.zeros_like(origin),
        zero,
    )


def along(
    stretches: Sequence[Stretch], state: State, begin_s: float, end: np.ndarray | None
) -> Timeline:
    """Return stretches on the line of a state, then standstill (at `end` if given)."""
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


@dataclass(frozen=True, slots=True)
class Program:
    """Waypoints in order, joined by straight lines and arcs with a stop at each.

    position : (n, axes), mm or deg; dwell_s : (n,) at each row
    feed_mm_s : (n,) towards each row; deg/s where no straight axis moves
    target : measured on the way to and at each row; none for the machine's first
    arc : on which each row is driven to, None for a straight line; none at all if empty
    """

    position: np.ndarray
    feed_mm_s: np.ndarray
    dwell_s: np.ndarray
    target: tuple[str, ...] = ()
    arc: tuple[Arc | None, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


def follow(
    program: Program,
    origin: np.ndarray,
    begin_s: float,
    limits: Limits,
    first_row: int = 0,
    gone: float = 0.0,
) -> Timeline:
    """Return the motion from standstill at `origin` through rows from `first_row`.

    gone : length of the arc to the first of these rows that is behind
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
    """Ways to rows, each from its begin; done : length of each that is behind."""

    begin: np.ndarray
    direction: np.ndarray
    curvature: np.ndarray
    target: np.ndarray
    row: np.ndarray
    done: np.ndarray


def _laid_out(
    stretches: np.ndarray, lines: _Lines, begin_s: float, origin: np.ndarray
) -> Timeline:
    """Join the eight stretches of each row, seven of motion and one of dwell."""
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
