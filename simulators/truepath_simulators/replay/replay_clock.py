"""The time of a replay: that of the recording, which waits for the host if necessary.

A host never works at exactly the same pace twice. So the recording stops before each of
its motions until the host orders it, and at its end until the host has read it: the
host then receives no less of the stream at every standstill than in the recording. It
waits for some seconds at most; then the stream continues, since the same samples come
in any case.
"""

from __future__ import annotations

from dataclasses import dataclass

from truepath_simulators.replay.recorded_run import Move

_TELL_EARLY_S = 0.25  # a host looks a few times a second
_OPENING_S = 0.06  # of the stream, until a host has seen it begin
_SEEN_S = 0.3  # of the wall clock, for a host to see the stream begin
_PATIENCE_S = 2.0  # of the wall clock, for a busy host to order or to look


@dataclass(slots=True)
class _Gate:
    time_s: float
    patience_s: float = _PATIENCE_S
    is_open: bool = False


class ReplayClock:
    """Seconds of the recording.

    speed : seconds of the recording per wall second
    """

    def __init__(self, moves: tuple[Move, ...], speed: float) -> None:
        self._moves, self._speed = moves, speed
        self._wall_s: float | None = None
        self._rewind()

    @property
    def runs(self) -> bool:
        """Whether the stream has begun."""
        return self._wall_s is not None

    @property
    def is_past_moves(self) -> bool:
        """Whether the host has read the end of the last motion."""
        return all(gate.is_open for gate in self._told)

    def begin(self, wall_s: float) -> None:
        """Start at the begin of the recording."""
        self._rewind()
        self._wall_s = wall_s

    def advance(self, wall_s: float) -> None:
        """Advance the time, up to the next action that the host still has to do."""
        if self._wall_s is None:
            return
        self.now_s += self._speed * (wall_s - self._wall_s)
        self._wall_s = wall_s
        closed = [g for g in self._gates if not g.is_open and g.time_s <= self.now_s]
        if not closed:
            self._waits_since_s = None
            return
        self._waits_since_s = self._waits_since_s or wall_s
        self.now_s = min(gate.time_s for gate in closed)
        if wall_s - self._waits_since_s > max(gate.patience_s for gate in closed):
            self._waits_since_s = None
            for gate in closed:
                gate.is_open |= gate.time_s <= self.now_s

    def end(self) -> None:
        """Stop; the host has ended the stream."""
        self._wall_s = None

    def has_arrived(self, move: int) -> bool:
        """Whether a motion is over."""
        return self.now_s >= self._told[move].time_s

    def mark_ordered(self, move: int) -> None:
        """Open all gates up to this motion, which the host has ordered."""
        for number in range(move + 1):
            self._ordered[number].is_open = True
            self._told[number].is_open |= number < move

    def join_moves(self, first: int, last: int) -> None:
        """Open the gates between motions that the host orders as one."""
        for number in range(first, last):
            self._ordered[number + 1].is_open = self._told[number].is_open = True

    def mark_read(self, move: int) -> None:
        """Open the gate after this motion, whose end the host has read."""
        self._told[move].is_open = True

    @property
    def _gates(self) -> list[_Gate]:
        return [self._opening, *self._ordered, *self._told]

    def _rewind(self) -> None:
        self.now_s = 0.0
        self._waits_since_s: float | None = None
        self._opening = _Gate(_OPENING_S, _SEEN_S, is_open=not self._moves)
        self._ordered = [_Gate(move.begin_s) for move in self._moves]
        told = [(m.begin_s, m.end_s - _TELL_EARLY_S) for m in self._moves]
        self._told = [_Gate(max(times)) for times in told]
