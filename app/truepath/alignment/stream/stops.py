"""Detection of standstills in a stream.

The paper's predecessor (Montavon 2019) measures at these; on the fly they are the exact
stops at the waypoints, whose *sequence* identifies the lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

_BLOCK_S, _FEWEST = 0.02, 5  # samples on either side whose means give a speed
_QUIET_S = 0.06  # noise of a sample over the speed of rest, that of two means
SAME_PLACE_MM = 0.1  # nearer than this two standstills are one


@dataclass(frozen=True, slots=True)
class StopSequence:
    """Standstills in the order of time.

    first, last : (m,) indices of the first sample at rest and of the one after the last
    position_mm : (m, 3), in the frame of the stream
    """

    first: Int64[np.ndarray, " m"]
    last: Int64[np.ndarray, " m"]
    position_mm: Float64[np.ndarray, "m 3"]

    def __len__(self) -> int:
        return len(self.first)


def count_block(time_step_s: float) -> int:
    """Number of samples averaged on either side for a speed, at any rate.

    Enough to keep its noise below the speed of rest: rare samples are far apart in
    time, so that fewer do, and more would not fit into a standstill.
    """
    step_s = max(time_step_s, 1e-9)
    enough = int(np.ceil((_QUIET_S / step_s) ** (2.0 / 3.0)))
    return max(min(_FEWEST, enough), round(_BLOCK_S / step_s))


def speed_mm_s(
    time_s: Float64[np.ndarray, " n"], position_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """Speed from the block before each sample to the block after it."""
    n = len(time_s)
    block = count_block(float(np.median(np.diff(time_s)))) if n > 1 else 1
    w = min(block, max(1, n // 3))
    stacked = np.column_stack([time_s - time_s[0], position_mm - position_mm[0]])
    total = np.vstack([np.zeros(4), np.cumsum(stacked, axis=0)])
    means = (total[w:] - total[:-w]) / w
    step = means[w:] - means[:-w]
    speed = np.linalg.norm(step[:, 1:], axis=1) / step[:, 0]
    return np.pad(speed, (w, n - w - len(speed)), mode="edge")


def detect_stops(
    time_s: Float64[np.ndarray, " n"],
    position_mm: Float64[np.ndarray, "n 3"],
    slowest_mm_s: float,
) -> StopSequence:
    """Standstills of a stream, by a limit from its slowest motion.

    time_s, position_mm : valid samples only
    """
    threshold = standstill_speed_mm_s(slowest_mm_s)
    still = speed_mm_s(time_s, position_mm) < threshold
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.view(np.int8), [0]])))
    first, last = edges[::2], edges[1::2]
    if len(first) == 0:
        return StopSequence(first, last, np.empty((0, 3)))
    where = np.array(
        [rest_position_mm(position_mm[a:b]) for a, b in zip(first, last, strict=True)]
    )
    return _merge(first, last, where, position_mm)


def standstill_speed_mm_s(slowest_mm_s: float) -> float:
    """Limit of rest: a fifth of the slowest motion, from 0.5 to 20."""
    return float(np.clip(0.2 * slowest_mm_s, 0.5, 20.0))


def rest_position_mm(
    position_mm: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "3"]:
    quarter = len(position_mm) // 4
    middle = position_mm[quarter : len(position_mm) - quarter]
    return np.median(middle, axis=0)


def is_away_between(
    between_mm: Float64[np.ndarray, "n 3"], place_mm: Float64[np.ndarray, "3"]
) -> bool:
    """True if the target was away between two standstills at one point.

    So it is after a full turn of a rotary axis; a spike or a lost frame is no motion.
    """
    if not len(between_mm):
        return False
    away = np.linalg.norm(between_mm - place_mm, axis=1)
    return bool(np.median(away) > SAME_PLACE_MM)


def _merge(
    first: Int64[np.ndarray, " m"],
    last: Int64[np.ndarray, " m"],
    where: Float64[np.ndarray, "m 3"],
    position_mm: Float64[np.ndarray, "n 3"],
) -> StopSequence:
    """Joins neighbours at one point: a lost frame does not make two standstills."""
    moved = np.linalg.norm(np.diff(where, axis=0), axis=1) > SAME_PLACE_MM
    for k in np.flatnonzero(~moved):
        moved[k] = is_away_between(position_mm[last[k] : first[k + 1]], where[k])
    begins = np.flatnonzero(np.concatenate([[True], moved]))
    ends = np.append(begins[1:], len(first)) - 1
    longest = [
        b + int(np.argmax(last[b : e + 1] - first[b : e + 1]))
        for b, e in zip(begins, ends, strict=True)
    ]
    return StopSequence(first[begins], last[ends], where[longest])


ARRIVED_S = 0.2  # at rest for so long: noted before the next motion
_ENOUGH = 2000  # enough samples for the position of a standstill


@dataclass(frozen=True, slots=True)
class Stop:
    """One standstill; `first` and `last` count the samples since the beginning.

    last : one after the newest sample at rest; grows until the next motion
    position_mm : (3,) in the frame of the stream
    """

    first: int
    last: int
    position_mm: Float64[np.ndarray, "3"]


class StopStream:
    """Valid samples in order of time, and the standstills among them. One thread.

    slowest_mm_s : of any motion; rate_hz : of the samples
    """

    def __init__(self, slowest_mm_s: float, rate_hz: float) -> None:
        self._block = count_block(1.0 / rate_hz)
        self._threshold_mm_s = standstill_speed_mm_s(slowest_mm_s)
        self._time_s = np.empty(0)
        self._point_mm = np.empty((0, 3))
        self._dropped = 0  # samples that were dropped
        self._classified = 0  # samples classified as at rest or moving
        self._rest_since: int | None = None
        self._is_noted = False  # the present standstill is among the stops
        self.stops: list[Stop] = []

    def __len__(self) -> int:
        return self._dropped + len(self._time_s)

    def add(
        self, time_s: Float64[np.ndarray, " n"], point_mm: Float64[np.ndarray, "n 3"]
    ) -> None:
        self._time_s = np.concatenate([self._time_s, time_s])
        self._point_mm = np.concatenate([self._point_mm, point_mm])
        self._assess(len(self) - self._block)

    def end(self) -> None:
        self._assess(len(self))
        if self._rest_since is not None:
            self._note(self._rest_since, len(self))

    def discard_before(self, index: int) -> None:
        gone = min(index, self._classified - self._block) - self._dropped
        if gone > 0:
            self._time_s, self._point_mm = self._time_s[gone:], self._point_mm[gone:]
            self._dropped += gone

    @property
    def begin(self) -> int:
        return self._dropped

    @property
    def kept(self) -> int:
        return len(self._time_s)

    def part(
        self, first: int, last: int
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        inside = slice(first - self._dropped, last - self._dropped)
        return self._time_s[inside], self._point_mm[inside]

    def _assess(self, until: int) -> None:
        if until <= self._classified or self.kept < 3 * self._block:
            return
        at_rest = self._at_rest(self._classified, until)
        for first, last, rests in _runs(at_rest, self._classified):
            if not rests:
                self._depart(first)
            else:
                self._stay(first, last)
        self._classified = until

    def _at_rest(self, first: int, last: int) -> Bool[np.ndarray, " n"]:
        context = max(first - 2 * self._block, self._dropped)
        context = min(context, max(len(self) - 3 * self._block, self._dropped))
        time_s, point_mm = self.part(context, len(self))
        slow = speed_mm_s(time_s, point_mm) < self._threshold_mm_s
        return slow[first - context : last - context]

    def _stay(self, first: int, last: int) -> None:
        if self._rest_since is None:
            self._rest_since, self._is_noted = first, False
        time_s, _ = self.part(self._rest_since, last)
        if self._is_noted or time_s[-1] - time_s[0] >= ARRIVED_S:
            self._note(self._rest_since, last)
            self._is_noted = True

    def _depart(self, first: int) -> None:
        if self._rest_since is not None:
            self._note(self._rest_since, first)
        self._rest_since = None

    def _note(self, first: int, last: int) -> None:
        begin = max(first, self._dropped)
        inside = self.part(begin, min(last, begin + _ENOUGH))[1]
        stop = Stop(first, last, rest_position_mm(inside))
        before = self.stops[-1] if self.stops else None
        if before is None or self._is_another(stop, before):
            self.stops.append(stop)
            return
        longer = stop if last - first >= before.last - before.first else before
        self.stops[-1] = Stop(before.first, last, longer.position_mm)

    def _is_another(self, stop: Stop, before: Stop) -> bool:
        if stop.first <= before.first:
            return False
        if float(np.linalg.norm(stop.position_mm - before.position_mm)) > SAME_PLACE_MM:
            return True
        between = self.part(max(before.last, self._dropped), stop.first)[1]
        return is_away_between(between, before.position_mm)


def concatenate_stops(stops: list[Stop], origin: int) -> StopSequence:
    """As one block, counted from `origin`."""
    return StopSequence(
        np.array([s.first - origin for s in stops]),
        np.array([s.last - origin for s in stops]),
        np.array([s.position_mm for s in stops]),
    )


def _runs(
    flags: Bool[np.ndarray, " n"], origin: int
) -> Iterator[tuple[int, int, bool]]:
    edges = np.flatnonzero(np.diff(flags)) + 1
    begins = [0, *edges.tolist()]
    for first, last in zip(begins, [*edges.tolist(), len(flags)], strict=True):
        yield origin + first, origin + last, bool(flags[first])
