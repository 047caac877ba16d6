"""Trackers at the other end of the wire, small and inside the test's process."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_drivers.tracker.streaming.measurements import (
    RawSamples,
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
    Status,
    Stop,
    StreamInfo,
    Type,
)
from truepath_simulators.machine.tracker_head import to_spherical

METRES = np.array([1e-3, 1.0, 1.0])  # ranges are sent in m


class PtyWire:
    """The device end of a pseudo-terminal."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        self.options = {"port": os.ttyname(self._slave)}

    def read(self, timeout_s: float) -> bytes:
        if not select.select([self._master], [], [], timeout_s)[0]:
            return b""
        return os.read(self._master, 4096)

    def write(self, data: bytes) -> None:
        os.write(self._master, data)

    def unplug(self) -> None:
        for end in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)


class TcpWire:
    """The device end of a TCP connection; takes one host after another."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._host: socket.socket | None = None
        port = self._listener.getsockname()[1]
        self.options = {"host": "127.0.0.1", "port": port}

    def read(self, timeout_s: float) -> bytes:
        ends = [self._listener] if self._host is None else [self._host]
        if not select.select(ends, [], [], timeout_s)[0]:
            return b""
        if self._host is None:
            self._host, _ = self._listener.accept()
            return b""
        with contextlib.suppress(ConnectionError):
            if data := self._host.recv(4096):
                return data
        self._host.close()
        self._host = None
        return b""

    def write(self, data: bytes) -> None:
        if self._host is not None:
            with contextlib.suppress(ConnectionError):
                self._host.sendall(data)

    def unplug(self) -> None:
        if self._host is not None:
            self._host.close()
        self._listener.close()


Wire = PtyWire | TcpWire


class Peer:
    """A thread at the device end of a wire."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.options = wire.options
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="peer")

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.halt()
        self.wire.unplug()

    def halt(self) -> None:
        self._closing.set()
        self._thread.join()

    def unplug(self) -> None:
        self.halt()
        self.wire.unplug()

    def _run(self) -> None:
        while not self._closing.is_set():
            self.step(self.wire.read(0.004))

    def step(self, data: bytes) -> None:
        raise NotImplementedError


class EchoPeer(Peer):
    """A loop-back plug."""

    def step(self, data: bytes) -> None:
        self.wire.write(data)


class ChattingPeer(Peer):
    """A device of another kind: lines of text, whatever is asked."""

    def step(self, data: bytes) -> None:
        self.wire.write(b"$GPGGA,0.0*00\r\n")


class SilentPeer(Peer):
    """A device that is switched off behind its adapter."""

    def step(self, data: bytes) -> None:
        return


class ScriptedPeer(Peer):
    """Expects exact bytes and answers with exact bytes; leftovers fail the test."""

    def __init__(self, wire: Wire, table: list[tuple[str, str]]) -> None:
        super().__init__(wire)
        self.rest = [(bytes.fromhex(a), bytes.fromhex(b)) for a, b in table]
        self.unexpected = b""
        self._heard = b""

    def step(self, data: bytes) -> None:
        self._heard += data
        while self.rest and self._heard.startswith(self.rest[0][0]):
            sent, reply = self.rest.pop(0)
            self._heard = self._heard[len(sent) :]
            self.wire.write(reply)
        if not self.rest:
            self.unexpected, self._heard = self.unexpected + self._heard, b""

    def finish(self) -> None:
        assert self.rest == []
        assert self.unexpected + self._heard == b""


class LoopbackTracker(Peer):
    """A tracker that streams a straight line; its faults are attributes."""

    info = DeviceInfo("Truepath", "loopback", "LB-1", "0.1", 5000.0)
    speed_mm_s = np.array([10.0, -5.0, 2.5])

    def __init__(self, wire: Wire) -> None:
        super().__init__(wire)
        self.commands: list[Message] = []
        self.deaf_to: set[type] = set()
        self.silent = False
        self.sent = 0
        self.answered_rate_hz: float | None = None
        self.nak: NakCode | None = None
        self.damage: Callable[[bytes], bytes] = lambda data: data
        self._frames = FrameReader()
        self._stream: Start | None = None
        self._began_s = 0.0
        self._began_at = 0

    @property
    def rate_hz(self) -> float | None:
        return self._stream.rate_hz if self._stream else None

    def step(self, data: bytes) -> None:
        for command in map(parse_message, self._frames.feed(data)):
            if command is None:
                continue
            self.commands.append(command)
            if type(command) not in self.deaf_to and not self.silent:
                self.wire.write(encode_message(self._reply(command)))
        self._emit()

    def send(self, message: Message) -> None:
        self.wire.write(encode_message(message))

    def _reply(self, command: Message) -> Message:
        if self.nak is not None:
            kind = Type[type(command).__name__.upper()]
            return Nak(command.transaction, kind, self.nak, "not now")
        match command:
            case Hello(transaction):
                return Ack(transaction, Type.HELLO, self.info)
            case Start(transaction, rate_hz):
                if self._stream is None:
                    self._begin(command)
                elif self._stream.rate_hz != rate_hz:
                    return Nak(transaction, Type.START, NakCode.BUSY, "streaming")
                told_hz = self.answered_rate_hz or rate_hz
                info = StreamInfo(
                    told_hz, self.sent & 0xFFFF, self._clock_us(self.sent)
                )
                return Ack(transaction, Type.START, info)
            case Stop(transaction):
                self._stream = None
                return Ack(transaction, Type.STOP)
            case Ping(transaction):
                return Ack(transaction, Type.PING)
        raise AssertionError(command)

    def _begin(self, start: Start) -> None:
        self._stream = start
        self._began_s = time.monotonic()
        self._began_at = self.sent

    def _emit(self) -> None:
        if self._stream is None or self.silent:
            return
        elapsed_s = time.monotonic() - self._began_s
        until = self._began_at + int(elapsed_s * self._stream.rate_hz)
        number = np.arange(self.sent, until)
        if len(number):
            self.sent = until
            frames = encode_measurements(self.samples(number, self._stream.format))
            self.wire.write(self.damage(frames))

    def _clock_us(self, number):
        return np.asarray(number) * 2000 + 7_000_000

    def samples(self, number: np.ndarray, measured: Format) -> RawSamples:
        return RawSamples(
            measured,
            number,
            self._clock_us(number).astype(np.uint64),
            *(METRES * to_spherical(self.position_mm(number))).T,
            np.zeros(len(number), np.int64),
            np.full(len(number), 180),
        )

    def position_mm(self, number: np.ndarray) -> np.ndarray:
        start_mm = np.array([1500.0, 300.0, -200.0])
        return start_mm + np.outer(number * 2e-3, self.speed_mm_s)

    def status_frame(self) -> Status:
        return Status(1, 0, self.sent, 0, 0)


WIRES = {"serial": PtyWire, "tcp": TcpWire}


@pytest.fixture(params=list(WIRES))
def wire(request) -> Iterator[Wire]:
    wire = WIRES[request.param]()
    yield wire
    wire.unplug()


@pytest.fixture
def loopback_tracker(wire) -> Iterator[LoopbackTracker]:
    with LoopbackTracker(wire) as peer:
        yield peer


@pytest.fixture
def scripted():
    return ScriptedPeer


@pytest.fixture
def silent():
    return SilentPeer


@pytest.fixture
def chatting():
    return ChattingPeer


@pytest.fixture
def echo():
    return EchoPeer
