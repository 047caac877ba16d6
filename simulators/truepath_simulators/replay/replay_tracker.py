"""A tracker that sends the bytes of a Run. No I/O, time is given."""

from __future__ import annotations

from typing import Any

import numpy as np

from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_drivers.tracker.streaming.measurements import (
    RawSamples,
    StatusBit,
    encode_measurements,
)
from truepath_drivers.tracker.streaming.message_codec import (
    encode_message,
    parse_message,
)
from truepath_drivers.tracker.streaming.messages import (
    Ack,
    DeviceInfo,
    Format,
    Hello,
    Message,
    Nak,
    NakCode,
    Ping,
    Start,
    Stop,
    Type,
)
from truepath_simulators.replay.recorded_run import RecordedRun
from truepath_simulators.replay.replay_clock import ReplayClock

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
        """Replies to bytes of the host."""
        replies = [self._answer(body, wall_s) for body in self._frames.feed(data)]
        return b"".join(encode_message(reply) for reply in replies if reply)

    def due(self, wall_s: float) -> bytes:
        """Every byte due by now."""
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
        """Progress of the replay."""
        return {
            "streaming": self._clock.runs,
            "recording_s": self._clock.now_s,
            "sent_share": self._sent / len(self._run.pieces),
        }

    def _answer(self, body: bytes, wall_s: float) -> Message | None:
        match parse_message(body):
            case Hello(transaction):
                return Ack(transaction, Type.HELLO, self._info())
            case Start() as start:
                return self._start(start, wall_s)
            case Stop(transaction):
                self._clock.end()
                return Ack(transaction, Type.STOP)
            case Ping(transaction):
                return Ack(transaction, Type.PING)
            case _:
                return None

    def _info(self) -> DeviceInfo:
        who = self._run.devices["tracker"]
        names = (who["maker"], who["model"], who["serial_number"], who["firmware"])
        return DeviceInfo(*names, self._run.opening.rate_hz)

    def _start(self, start: Start, wall_s: float) -> Message:
        recorded_hz = self._run.opening.rate_hz
        if abs(start.rate_hz - recorded_hz) > 0.01 * recorded_hz:
            text = f"recorded at {recorded_hz:g} Hz"
            return Nak(start.transaction, Type.START, NakCode.RATE_NOT_POSSIBLE, text)
        if not self._clock.runs:
            self._clock.begin(wall_s)
            self._sent = self._extra = 0
            self._ended_s = None
        return Ack(start.transaction, Type.START, self._run.opening)

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
                Format.MEAS64,
                self._last_number + more,
                (self._last_us + np.rint(more * 1e6 / rate_hz)).astype(np.uint64),
                nothing + 1.0,
                nothing,
                nothing,
                np.full(len(more), int(StatusBit.BEAM_BROKEN)),
                np.zeros(len(more), np.int64),
            )
        )
