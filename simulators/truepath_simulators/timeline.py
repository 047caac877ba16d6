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

    def lengths(self, time_s: np.ndarray) -> np.ndarray:
        """Return the distance travelled along the path (n,) at times (n,)."""
        piece, run = self._run(time_s)
        return self.gone[piece] + run

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
