"""The tracker behind its wire: commands in, frames out. No I/O, time is given.

The link counts wall seconds (keep-alive), the measurement machine seconds: a sped-up
simulation shortens the measurement, not the time limits of a link.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.codec import (
    RawSamples,
    StatusBit,
    encode_measurements,
)
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_simulators.faults import Fault, Schedule
from truepath_simulators.machine.tracker_head import (
    SampleNoise,
)
from truepath_simulators.randomness import generator
from truepath_simulators.timeline import Timeline
from truepath_simulators.tracker.tracker_sight import TrackerParts, TrackerSight

MAX_RATE_HZ = 5000.0
PING_PATIENCE_S = 5.0
STATUS_PERIOD_S = 0.5
BUFFER_BYTES = 1 << 16
_LOCKED_SIGNAL = 200
_VERSIONS = (gst.VERSION, gst.VERBS_VERSION)
_KINDS: dict[type[gst.Message], gst.Type] = {
    gst.Start: gst.Type.START,
    gst.Aim: gst.Type.AIM,
    gst.Search: gst.Type.SEARCH,
    gst.Select: gst.Type.SELECT,
}


@dataclass(frozen=True, slots=True)
class _Stream:
    """Sample i is due at begin + i / rate on the device clock."""

    rate_hz: float
    format: gst.Format
    begin_us: int
    noise: SampleNoise

    def clock_us(self, index: np.ndarray) -> np.ndarray:
        return self.begin_us + np.rint(index * (1e6 / self.rate_hz)).astype(np.int64)


class TrackerDevice:
    """Answers commands and samples the truth. Samples are numbered since power-on."""

    def __init__(
        self, parts: TrackerParts, faults: Schedule, buffer_bytes: int = BUFFER_BYTES
    ) -> None:
        self._buffer_bytes = buffer_bytes
        self._parts = parts
        self._faults = faults
        self._frames = FrameReader()
        self._line = FrameDamage(faults, generator(parts.seed, "faults: damage"))
        self._stream: _Stream | None = None
        self._streams = 0
        self._sequence = 0
        self._sent_of_stream = 0
        self._frames_sent = 0
        self._frames_dropped = 0
        self._high_water = 0
        self._overflown = False
        self._beam_locked = True
        self._is_homed = False
        self._last_heard_s = -np.inf
        self._next_status_s = 0.0
        self.sight = TrackerSight(parts, faults)

    @property
    def streaming(self) -> bool:
        return self._stream is not None

    def read_state(self) -> dict[str, Any]:
        """Stream, counts of samples and frames, and lock of the beam."""
        rate_hz = 0.0 if self._stream is None else self._stream.rate_hz
        return {
            "streaming": self.streaming,
            "rate_hz": rate_hz,
            "samples": self._sequence,
            "frames_sent": self._frames_sent,
            "frames_dropped": self._frames_dropped,
            "beam_locked": self._beam_locked,
        }

    def receive(self, data: bytes, true_s: float, wall_s: float) -> bytes:
        replies = b""
        for body in self._frames.feed(data):
            self._last_heard_s = wall_s
            reply = self._answer(body, true_s)
            if reply is not None:
                replies += gst.encode_message(reply)
        return b"" if self._faults.strikes("silence", true_s) else replies

    def due(
        self, timeline: Timeline, true_s: float, wall_s: float, waiting_bytes: int = 0
    ) -> bytes:
        """Every frame due by now.

        waiting_bytes : not accepted by the link yet. Beyond the device's buffer samples
            are lost, and the next one reports it.
        """
        self.sight.follow(timeline)
        if self._stream is None:
            return b""
        if wall_s - self._last_heard_s > PING_PATIENCE_S:
            self._stream = None
            event = gst.Event(
                gst.EventCode.STREAM_STOPPED_NO_PING, self._device_us(true_s)
            )
            return gst.encode_message(event)
        self._high_water = max(self._high_water, waiting_bytes)
        full = waiting_bytes > self._buffer_bytes
        frames = self._samples_due(self._stream, timeline, true_s, full=full)
        return frames + (b"" if full else self._status_due(true_s, wall_s))

    def forget_host(self) -> None:
        """Stop streaming: the connection has gone."""
        self._stream = None

    def _answer(self, body: bytes, true_s: float) -> gst.Message | None:
        match gst.parse_message(body):
            case gst.Hello(transaction, version) if version not in _VERSIONS:
                text = (
                    f"this device speaks versions {gst.VERSION} to {gst.VERBS_VERSION}"
                )
                code = gst.NakCode.VERSION_NOT_SPOKEN
                return gst.Nak(transaction, gst.Type.HELLO, code, text)
            case gst.Hello(transaction, version):
                self.sight.verbs.is_known = version >= gst.VERBS_VERSION
                return gst.Ack(transaction, gst.Type.HELLO, self._info(true_s, version))
            case gst.Start() | gst.Aim() | gst.Search() | gst.Select() as early if (
                self._waits_for_home(true_s)
            ):
                kind, code = _KINDS[type(early)], gst.NakCode.NOT_READY
                return gst.Nak(early.transaction, kind, code, "not initialised")
            case gst.Start() as start:
                return self._start(start, true_s)
            case gst.Stop(transaction):
                self._stream = None
                if not self.sight.has_moved:
                    self._faults.start_over()  # a host has only listened
                return gst.Ack(transaction, gst.Type.STOP)
            case gst.Ping(transaction):
                return gst.Ack(transaction, gst.Type.PING)
            case None if len(body) > 2:
                return gst.Nak(body[2], body[1], _explain(body), "not understood")
            case None | gst.Ack() | gst.Nak() | gst.Status() | gst.Event():
                return None
            case verb:
                self._is_homed = self._is_homed or isinstance(verb, gst.Home)
                blocked = self._faults.strikes("beam-break", true_s) is not None
                return self.sight.verbs.answer(verb, true_s, is_blocked=blocked)

    def _waits_for_home(self, true_s: float) -> bool:
        is_asked = self._faults.strikes("unhomed", true_s) is not None
        return is_asked and not self._is_homed

    def _info(self, true_s: float, version: int) -> gst.DeviceInfo:
        if self._faults.strikes("wrong-identity", true_s):
            return gst.DeviceInfo(
                "Nobody", "Barcode scanner", "0", "0", 1.0, version=99
            )
        serial = f"SIM-{self._parts.seed:06d}"
        who = "Truepath", "Simulated tracker", serial, "1.0"
        return gst.DeviceInfo(*who, MAX_RATE_HZ, version)

    def _start(self, start: gst.Start, true_s: float) -> gst.Message:
        if not 0.0 < start.rate_hz <= MAX_RATE_HZ:
            text = f"{start.rate_hz:g} Hz is not in 0 to {MAX_RATE_HZ:g} Hz"
            return gst.Nak(
                start.transaction, gst.Type.START, gst.NakCode.RATE_NOT_POSSIBLE, text
            )
        now_us = self._device_us(true_s)
        if self._stream is None:
            seed, air = self._parts.seed, self._parts.air
            noise = SampleNoise(seed, start.rate_hz, air, self._streams)
            self._streams += 1
            self._stream = _Stream(start.rate_hz, start.format, now_us, noise)
            self._sent_of_stream = 0
            self._faults.begin(true_s)
        elif (self._stream.rate_hz, self._stream.format) != (
            start.rate_hz,
            start.format,
        ):
            return gst.Nak(
                start.transaction, gst.Type.START, gst.NakCode.BUSY, "streams otherwise"
            )
        info = gst.StreamInfo(start.rate_hz, self._sequence & 0xFFFF, now_us)
        return gst.Ack(start.transaction, gst.Type.START, info)

    def _samples_due(
        self, stream: _Stream, timeline: Timeline, true_s: float, *, full: bool
    ) -> bytes:
        elapsed_s = 1e-6 * (self._device_us(true_s) - stream.begin_us)
        count = int(elapsed_s * stream.rate_hz) + 1 - self._sent_of_stream
        if count <= 0:
            return b""
        index = self._sent_of_stream + np.arange(count)
        number = self._sequence + np.arange(count)
        self._sent_of_stream += count
        self._sequence += count
        raw, moments_s = self._measure(stream, timeline, index, number)
        if full:
            self._frames_dropped += count
            self._overflown = True
            return b""
        self._frames_sent += count
        frames = self._line.damage(encode_measurements(raw), moments_s, number)
        return frames + self._beam_event(raw)

    def _measure(
        self,
        stream: _Stream,
        timeline: Timeline,
        index: np.ndarray,
        number: np.ndarray,
    ) -> tuple[RawSamples, np.ndarray]:
        clock_us = stream.clock_us(index)
        moments_s = self._parts.clock.true_s(1e-6 * clock_us)
        noise = stream.noise.draw(len(index))
        polar, status = self.sight.read(timeline, moments_s, number, noise)
        if self._overflown:
            status[0] |= StatusBit.OVERFLOW
            self._overflown = False
        locked = (status & StatusBit.BEAM_BROKEN) == 0
        return RawSamples(
            stream.format,
            number,
            clock_us.astype(np.uint64),
            1e-3 * polar[:, 0],
            polar[:, 1],
            polar[:, 2],
            status,
            np.where(locked, _LOCKED_SIGNAL, 0),
        ), moments_s

    def _beam_event(self, raw: RawSamples) -> bytes:
        locked = not raw.status[-1] & StatusBit.BEAM_BROKEN
        if locked == self._beam_locked:
            return b""
        self._beam_locked = locked
        code = gst.EventCode.BEAM_LOCKED if locked else gst.EventCode.BEAM_BROKEN
        return gst.encode_message(gst.Event(code, int(raw.clock_us[-1])))

    def _status_due(self, true_s: float, wall_s: float) -> bytes:
        if wall_s < self._next_status_s or self._faults.strikes("silence", true_s):
            return b""
        self._next_status_s = wall_s + STATUS_PERIOD_S
        status = gst.Status(
            gst.DeviceState.STREAMING,
            self._device_us(true_s),
            self._frames_sent,
            self._frames_dropped,
            self._high_water,
        )
        return gst.encode_message(status)

    def _device_us(self, true_s: float) -> int:
        return int(1e6 * self._parts.clock.device_s(true_s))


def _explain(body: bytes) -> gst.NakCode:
    if body[0] != gst.VERSION:
        return gst.NakCode.VERSION_NOT_SPOKEN
    if gst.Type.HELLO <= body[1] <= gst.Type.GET_AIR:
        return gst.NakCode.BAD_ARGUMENT
    return gst.NakCode.UNKNOWN_COMMAND


class FrameDamage:
    """Applies the faults of a line to blocks of frames, one frame per sample."""

    def __init__(self, faults: Schedule, rng: np.random.Generator) -> None:
        self._faults = faults
        self._rng = rng
        self._kept_back = b""

    def damage(self, data: bytes, time_s: np.ndarray, number: np.ndarray) -> bytes:
        """Bytes after the line, for whole frames taken at `time_s` (n,)."""
        frames = [b"\0" + piece + b"\0" for piece in data.split(b"\0") if piece]
        struck = False
        for kind in ("lost-bytes", "bit-flip", "duplicate", "noise", "drop", "silence"):
            for fault, mask in self._faults.struck(kind, time_s, number):
                struck = True
                for i in np.flatnonzero(mask & self._lot(fault, len(mask))):
                    frames[i] = self._damage_frame(kind, fault, frames[i])
        out = b"".join(frames) if struck else data
        return self._delay(out, time_s, number)

    def _lot(self, fault: Fault, n: int) -> np.ndarray:
        share = fault.amount if fault.kind in _SHARES else 1.0
        return self._rng.uniform(size=n) < share

    def _damage_frame(self, kind: str, fault: Fault, frame: bytes) -> bytes:
        match kind:
            case "lost-bytes":
                at = int(self._rng.integers(len(frame)))
                return frame[:at] + frame[at + 1 :]
            case "bit-flip":
                return self._flip_bits(frame)
            case "duplicate":
                return frame + frame
            case "noise":
                return self._rng.bytes(int(fault.amount)) + frame
            case _:
                return b""

    def _flip_bits(self, frame: bytes) -> bytes:
        at, bit = int(self._rng.integers(len(frame))), int(self._rng.integers(8))
        flipped = bytearray(frame)
        flipped[at] ^= 1 << bit
        return bytes(flipped)

    def _delay(self, data: bytes, time_s: np.ndarray, number: np.ndarray) -> bytes:
        for _, mask in self._faults.struck("delay", time_s, number):
            if mask[-1]:
                self._kept_back += data
                return b""
        data, self._kept_back = self._kept_back + data, b""
        return data


_SHARES = frozenset({"lost-bytes", "bit-flip", "duplicate", "drop"})
