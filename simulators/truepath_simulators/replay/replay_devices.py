"""A tracker and a controller that repeat a recorded Run, and their time. No I/O.

A host never works at exactly the same pace twice. So the recording stops before each of
its motions until the host orders it, and at its end until the host has read it: the
host then receives no less of the stream at every standstill than in the recording. It
waits for some seconds at most; then the stream continues, since the same samples come
in any case.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from truepath_drivers.cnc.modbus.registers import HoldReason, Result
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.codec import (
    RawSamples,
    StatusBit,
    StreamDecoder,
    encode_measurements,
)
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_simulators.cnc.cnc_controller import Controller
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.replay.recorded_run import Move, RecordedRun

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
        return self._wall_s is not None

    @property
    def is_past_moves(self) -> bool:
        """Whether the host has read the end of the last motion."""
        return all(gate.is_open for gate in self._told)

    def begin(self, wall_s: float) -> None:
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
        self._wall_s = None

    def has_arrived(self, move: int) -> bool:
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


_SAME = 0.02  # mm or deg between an ordered and a recorded end
_AHEAD = 4  # rows that a machine passes between two looks, at most


class ReplayController(Controller):
    """Positions of the recording. All times are those of the replay.

    A motion after the last recorded one is refused; moves without a stream are
    immediate.
    """

    def __init__(
        self, machine: MachineFile, run: RecordedRun, clock: ReplayClock
    ) -> None:
        super().__init__(machine, Limits(), lambda _: None, 0.0)
        self._run_of, self._clock = run, clock
        self._at = run.position[0]
        self._driven, self._line_now = -1, 0
        self._end = MotionState.FINISHED
        self._rows = self._at[None]

    def update(self, now_s: float) -> None:
        """End the motion together with the recorded one."""
        if self.state is MotionState.RUNNING and self._clock.has_arrived(self._driven):
            self.state, self._at = self._end, self._run_of.moves[self._driven].goal

    def note_poll(self) -> None:
        """Record that the host has read the status."""
        if self.state is self._end and self._driven >= 0:
            self._clock.mark_read(self._driven)

    @property
    def has_moved(self) -> bool:
        return self._driven >= 0

    def position(self, now_s: float) -> np.ndarray:
        if self.state is not MotionState.RUNNING:
            return self._at
        columns = self._run_of.position.T
        self._at = np.array(
            [np.interp(self._clock.now_s, self._run_of.axes_s, c) for c in columns]
        )
        return self._at

    def feed_mm_min(self, now_s: float) -> float:
        """Always 0: a Run does not store it."""
        return 0.0

    def line(self, now_s: float) -> int:
        """Row of the nearest line, never an earlier one."""
        here = self.position(now_s)
        rows = range(self._line_now, min(self._line_now + _AHEAD, len(self._rows)))
        away = [_distance(here, self._rows[max(r - 1, 0)], self._rows[r]) for r in rows]
        self._line_now += int(np.argmin(away))
        return self._line_now

    def commit(self, program: Program) -> None:
        super().commit(program)
        self._line_now = 0

    def move_to(self, row: Program, now_s: float) -> None:
        """With the recording while it runs, else immediate."""
        self._rows, self._line_now = row.position, 0
        if not self._clock.runs:
            self._driven = -1
            self._at, self.state = row.position[-1], MotionState.FINISHED
        else:
            self._drive()

    def start(self, now_s: float) -> Result:
        """Run the committed path with the recording."""
        if self.path is None:
            return Result.NO_PATH
        self._rows = self.path.position
        return self._drive()

    def hold(self, reason: HoldReason, now_s: float) -> None:
        """Report a hold; the recording continues."""
        if self.state is MotionState.RUNNING:
            self.state, self.hold_reason = MotionState.HELD, reason

    def resume(self, now_s: float) -> None:
        """Continue with the recording at its present time."""
        if self.state is MotionState.HELD:
            self.state, self.hold_reason = MotionState.RUNNING, HoldReason.NONE

    def abort(self, now_s: float) -> None:
        self.path = None
        self.state, self.hold_reason = MotionState.ABORTED, HoldReason.NONE

    def _drive(self) -> Result:
        """The recorded motion with the same end, else the last one.

        A motion that was ended early ends early again.
        """
        first, moves = self._driven + 1, self._run_of.moves
        if first >= len(moves):
            return Result.BAD_ARGUMENT
        ends = [
            number
            for number in range(first, len(moves))
            if np.abs(moves[number].goal - self._rows[-1]).max() <= _SAME
        ]
        self._driven = (ends or [len(moves) - 1])[0]
        self._end = MotionState.FINISHED if ends else MotionState.ABORTED
        self._clock.mark_ordered(first)
        self._clock.join_moves(first, self._driven)
        self.state, self.hold_reason = MotionState.RUNNING, HoldReason.NONE
        return Result.DONE


def _distance(here: np.ndarray, begin: np.ndarray, end: np.ndarray) -> float:
    way = end - begin
    share = np.dot(here - begin, way) / max(float(np.dot(way, way)), 1e-12)
    return float(np.linalg.norm(here - begin - np.clip(share, 0.0, 1.0) * way))


# A host ends its stream some time after the last motion. So it gets the rest at once
# when that is over, or so long before the end where nothing moved: no sample is lost.
_REST_S = 0.8
_AFTER_S = 0.3  # wall seconds after the last byte, until the host is helped to an end


class ReplayTracker:
    """Answers commands, and sends the recorded bytes at their recorded times."""

    def __init__(self, run: RecordedRun, clock: ReplayClock) -> None:
        self._run, self._clock = run, clock
        self._frames = FrameReader()
        self._sent = 0
        self._ended_s: float | None = None
        self._extra = 0
        samples = StreamDecoder().feed(b"\0".join(run.pieces) + b"\0").samples
        self._last_us = round(1e6 * float(samples.device_time_s[-1]))
        self._last_number = run.opening.next_sequence + int(samples.sequence[-1])

    def receive(self, data: bytes, wall_s: float) -> bytes:
        replies = [self._answer(body, wall_s) for body in self._frames.feed(data)]
        return b"".join(gst.encode_message(reply) for reply in replies if reply)

    def due(self, wall_s: float) -> bytes:
        self._clock.advance(wall_s)
        if not self._clock.runs:
            return b""
        times, now_s = self._run.piece_s, self._clock.now_s
        upto = int(np.searchsorted(times, now_s, side="right"))
        is_rest = bool(self._run.moves) or now_s >= times[-1] - _REST_S
        if is_rest and self._clock.is_past_moves:
            upto = len(times)
        if upto <= self._sent:
            return self._fill(wall_s) if self._sent == len(times) else b""
        pieces, self._sent = self._run.pieces[self._sent : upto], upto
        return b"\0".join(pieces) + b"\0"

    def forget_host(self) -> None:
        """Stop: the connection has gone."""
        self._clock.end()

    def read_state(self) -> dict[str, Any]:
        return {
            "streaming": self._clock.runs,
            "recording_s": self._clock.now_s,
            "sent_share": self._sent / len(self._run.pieces),
        }

    def _answer(self, body: bytes, wall_s: float) -> gst.Message | None:
        match gst.parse_message(body):
            case gst.Hello(transaction):
                return gst.Ack(transaction, gst.Type.HELLO, self._info())
            case gst.Start() as start:
                return self._start(start, wall_s)
            case gst.Stop(transaction):
                self._clock.end()
                return gst.Ack(transaction, gst.Type.STOP)
            case gst.Ping(transaction):
                return gst.Ack(transaction, gst.Type.PING)
            case _:
                return None

    def _info(self) -> gst.DeviceInfo:
        who = self._run.devices["tracker"]
        names = (who["maker"], who["model"], who["serial_number"], who["firmware"])
        return gst.DeviceInfo(*names, self._run.opening.rate_hz)

    def _start(self, start: gst.Start, wall_s: float) -> gst.Message:
        recorded_hz = self._run.opening.rate_hz
        if abs(start.rate_hz - recorded_hz) > 0.01 * recorded_hz:
            text = f"recorded at {recorded_hz:g} Hz"
            return gst.Nak(
                start.transaction, gst.Type.START, gst.NakCode.RATE_NOT_POSSIBLE, text
            )
        if not self._clock.runs:
            self._clock.begin(wall_s)
            self._sent = self._extra = 0
            self._ended_s = None
        return gst.Ack(start.transaction, gst.Type.START, self._run.opening)

    def _fill(self, wall_s: float) -> bytes:
        self._ended_s = self._ended_s or wall_s
        rate_hz = self._run.opening.rate_hz
        due = int((wall_s - self._ended_s - _AFTER_S) * rate_hz)
        if due <= self._extra:
            return b""
        more = np.arange(self._extra, due) + 1
        self._extra = due
        nothing = np.zeros(len(more))
        return encode_measurements(
            RawSamples(
                gst.Format.MEAS64,
                self._last_number + more,
                (self._last_us + np.rint(more * 1e6 / rate_hz)).astype(np.uint64),
                nothing + 1.0,
                nothing,
                nothing,
                np.full(len(more), int(StatusBit.BEAM_BROKEN)),
                np.zeros(len(more), np.int64),
            )
        )
