"""Trackers at the other end of the wire, small and inside the test's process."""

import time

import numpy as np

from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.tracker.streaming import codec, framing, messages
from truepath_drivers.tracker.streaming import messages as gst
from truepath_simulators.machine.tracker_head import to_spherical
from wires import Peer

METRES = np.array([1e-3, 1.0, 1.0])  # ranges are sent in m


def raw_samples(measured, number, clock_us, position_mm, status=0, signal=200):
    """What a tracker sends of these places; all samples have this status."""
    n, polar = len(position_mm), (METRES * to_spherical(position_mm)).T
    number, clock_us = np.asarray(number), np.asarray(clock_us).astype(np.uint64)
    told = np.full(n, status), np.broadcast_to(signal, n)
    return codec.RawSamples(measured, number, clock_us, *polar, *told)


def one_sample(measured, number, clock_us, polar, status, signal):
    """A single sample: range in m, azimuth, elevation."""
    columns = map(np.atleast_1d, (np.uint64(clock_us), *polar, status, signal))
    return codec.RawSamples(measured, np.array([number]), *columns)


def read_samples(tracker, least, pause_s=0.0):
    """Return so many samples at least; ten seconds without any are too long."""
    blocks, last_s = [], time.monotonic()
    while sum(map(len, blocks)) < least:
        blocks.append(tracker.read(0.5))
        last_s = time.monotonic() if len(blocks[-1]) else last_s
        assert time.monotonic() < last_s + 10.0
        time.sleep(pause_s)
    return TrackerSamples.join(blocks)


class AnsweringPeer(Peer):
    """Sends what a function makes of the bytes that came, of none too."""

    def __init__(self, wire, answer):
        super().__init__(wire)
        self._answer = answer

    def step(self, data):
        self.wire.write(self._answer(data))


class LinePeer(Peer):
    def __init__(self, wire):
        super().__init__(wire)
        self._rest = b""

    def step(self, data):
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        for line in lines:
            self.wire.write(self.answer(line))

    def answer(self, line):
        raise NotImplementedError


class ScriptedPeer(Peer):
    """Expects exact bytes and answers with exact bytes; leftovers fail the test."""

    def __init__(self, wire, table):
        super().__init__(wire)
        self.rest = [(bytes.fromhex(a), bytes.fromhex(b)) for a, b in table]
        self._heard = b""

    def step(self, data):
        self._heard += data
        while self.rest and self._heard.startswith(self.rest[0][0]):
            sent, reply = self.rest.pop(0)
            self._heard = self._heard[len(sent) :]
            self.wire.write(reply)

    def __exit__(self, *_):
        super().__exit__()
        assert (self.rest, self._heard) == ([], b"")


class LoopbackTracker(Peer):
    """A tracker that streams a straight line; its faults are attributes."""

    info = gst.DeviceInfo("Truepath", "loopback", "LB-1", "0.1", 5000.0)
    speed_mm_s = np.array([10.0, -5.0, 2.5])

    def __init__(self, wire):
        super().__init__(wire)
        self.commands, self.deaf_to = [], set()
        self.silent, self.sent = False, 0
        self.answered_rate_hz = self.nak = self._stream = None
        self.damage = lambda data: data
        self._frames = framing.FrameReader()
        self._began_s, self._began_at = 0.0, 0

    @property
    def rate_hz(self):
        return self._stream.rate_hz if self._stream else None

    def step(self, data):
        for command in map(messages.parse_message, self._frames.feed(data)):
            if command is None:
                continue
            self.commands.append(command)
            if type(command) not in self.deaf_to and not self.silent:
                self.wire.write(messages.encode_message(self._reply(command)))
        self._emit()

    def send(self, message):
        self.wire.write(messages.encode_message(message))

    def _reply(self, command):
        kind = gst.Type[type(command).__name__.upper()]
        if self.nak is not None:
            return gst.Nak(command.transaction, kind, self.nak, "not now")
        told = ()
        match command:
            case gst.Hello():
                told = (self.info,)
            case gst.Start(_, rate_hz):
                if self._stream is None:
                    self._stream, self._began_at = command, self.sent
                    self._began_s = time.monotonic()
                clock_us = self._clock_us(self.sent)
                known = self.answered_rate_hz or rate_hz, self.sent & 0xFFFF, clock_us
                told = (gst.StreamInfo(*known),)
            case gst.Stop():
                self._stream = None
        return gst.Ack(command.transaction, kind, *told)

    def _emit(self):
        if self._stream is None or self.silent:
            return
        elapsed_s = time.monotonic() - self._began_s
        until = self._began_at + int(elapsed_s * self._stream.rate_hz)
        number = np.arange(self.sent, until)
        if len(number):
            self.sent = until
            frames = codec.encode_measurements(
                self.samples(number, self._stream.format)
            )
            self.wire.write(self.damage(frames))

    def _clock_us(self, number):
        return np.asarray(number) * 2000 + 7_000_000

    def samples(self, number, measured):
        place_mm = self.position_mm(number)
        return raw_samples(measured, number, self._clock_us(number), place_mm)

    def position_mm(self, number):
        start_mm = np.array([1500.0, 300.0, -200.0])
        return start_mm + np.outer(number * 2e-3, self.speed_mm_s)
