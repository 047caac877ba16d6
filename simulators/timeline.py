"""A whole motion as pieces of constant jerk on straight lines.

The pieces follow one another without a gap; the last one stands still for ever. Where
the machine is follows in closed form for any times at once. A motion is changed under
way by cutting the timeline and appending another future.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truepath.simulators.profile import Limits, Stretch, rest_to_rest

# A line shorter than this is no line: waypoints come in steps of 0.1 µm.
SHORTEST_MM = 1e-6
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
    """Where the machine is at one moment, and how fast along its line."""

    position: np.ndarray
    direction: np.ndarray
    speed: float
    acceleration: float
    row: int


@dataclass(frozen=True, slots=True)
class Timeline:
    """Pieces in order of time; all arrays have one entry a piece.

    Lengths are those that the feed counts, `path_length`.

    start_s : begin on the clock of the machine
    origin, direction : (m, axes), begin of the piece and step per length of its line
    speed, acceleration, jerk : at its begin, along the line; all zero while standing
    row : row of the path that the machine moves towards or dwells at
    """

    start_s: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    row: np.ndarray

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def end_s(self) -> float:
        """When the last piece begins: from then on the machine stands."""
        return float(self.start_s[-1])

    def positions(self, time_s: np.ndarray) -> np.ndarray:
        """Return axis positions (n, axes) at times (n,)."""
        piece, t = self._locate(time_s)
        run = t * (
            self.speed[piece]
            + t * (self.acceleration[piece] / 2.0 + t * self.jerk[piece] / 6.0)
        )
        return self.origin[piece] + run[:, None] * self.direction[piece]

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
        piece = int(self._locate(at)[0][0])
        return State(
            position=self.positions(at)[0],
            direction=self.direction[piece],
            speed=max(float(self.speeds(at)[0]), 0.0),
            acceleration=float(self.accelerations(at)[0]),
            row=int(self.row[piece]),
        )

    def cut(self, time_s: float) -> Timeline:
        """Return what was before a time; the last piece is the one running then."""
        keep = max(int(np.searchsorted(self.start_s, time_s, side="left")), 1)
        return self.first(keep)

    def first(self, count: int) -> Timeline:
        """Return the first pieces."""
        return self._select(slice(0, count))

    def last(self, count: int) -> Timeline:
        """Return the last pieces."""
        return self._select(slice(-count, None))

    def since(self, time_s: float) -> Timeline:
        """Forget what ended before a time."""
        piece = int(self._locate(np.array([time_s]))[0][0])
        return self._select(slice(piece, None))

    def then(self, other: Timeline) -> Timeline:
        """Return this timeline with another appended, which begins later."""
        return Timeline(
            *(
                np.concatenate([getattr(self, name), getattr(other, name)])
                for name in Timeline.__slots__
            )
        )

    def _select(self, part: slice) -> Timeline:
        return Timeline(*(getattr(self, name)[part] for name in Timeline.__slots__))

    def _locate(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        piece = np.searchsorted(self.start_s, time_s, side="right") - 1
        piece = np.maximum(piece, 0)
        return piece, np.maximum(time_s - self.start_s[piece], 0.0)


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
    origin = state.position + np.outer(run, state.direction)
    if end is not None:
        origin[-1] = end
    return Timeline(
        np.array(start),
        origin,
        np.tile(state.direction, (len(start), 1)),
        np.array([*speed[:-1], 0.0]),
        np.array([*(s.acceleration for s in pieces), 0.0]),
        np.array([*(s.jerk for s in pieces), 0.0]),
        np.full(len(start), state.row),
    )


@dataclass(frozen=True, slots=True)
class Program:
    """Waypoints in order, joined by straight lines with an exact stop at each.

    position : (n, axes), mm or deg; dwell_s : (n,) at each row
    feed_mm_s : (n,) towards each row; deg/s where no straight axis moves
    target : measured on the way to and at each row; none for the machine's first
    """

    position: np.ndarray
    feed_mm_s: np.ndarray
    dwell_s: np.ndarray
    target: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


def follow(
    program: Program,
    origin: np.ndarray,
    begin_s: float,
    limits: Limits,
    first_row: int = 0,
) -> Timeline:
    """Return the motion from standstill at `origin` through rows from `first_row`."""
    rows = np.arange(first_row, len(program))
    target = program.position[first_row:]
    begin = np.vstack([origin, target[:-1]])[: len(target)]
    length = path_length(target - begin)
    moved = length > SHORTEST_MM
    stretches = np.zeros((len(rows), 8, 3))
    stretches[moved, :7] = rest_to_rest(
        length[moved], program.feed_mm_s[first_row:][moved], limits
    )
    stretches[:, 7, 0] = program.dwell_s[first_row:]
    direction = np.zeros_like(target)
    direction[moved] = (target[moved] - begin[moved]) / length[moved, None]
    return _laid_out(stretches, begin, direction, target, rows, begin_s, origin)


def _laid_out(
    stretches: np.ndarray,
    begin: np.ndarray,
    direction: np.ndarray,
    target: np.ndarray,
    rows: np.ndarray,
    begin_s: float,
    origin: np.ndarray,
) -> Timeline:
    """Join the eight stretches of each row, seven of motion and one of dwell."""
    t, a, j = np.moveaxis(stretches, 2, 0)
    change = t * (a + t * j / 2.0)
    speed = np.cumsum(change, axis=1) - change
    step = t * (speed + t * (a / 2.0 + t * j / 6.0))
    run = np.cumsum(step, axis=1) - step
    place = begin[:, None] + run[:, :, None] * direction[:, None]
    place[:, 7] = target
    heading = np.repeat(direction[:, None], 8, axis=1)
    heading[:, 7] = 0.0
    start = begin_s + np.cumsum(t.ravel()) - t.ravel()
    some = t.ravel() > 0.0
    axes = target.shape[1]
    speed[:, 7] = 0.0
    motion = Timeline(
        start[some],
        place.reshape(-1, axes)[some],
        heading.reshape(-1, axes)[some],
        np.maximum(speed, 0.0).ravel()[some],
        a.ravel()[some],
        j.ravel()[some],
        np.repeat(rows, 8)[some],
    )
    end = begin_s + float(t.sum())
    last = target[-1] if len(target) else origin
    return motion.then(standing(last, end, int(rows[-1]) if len(rows) else 0))
