"""The receiving end of a GST/1 link: one thread that reads, checks and sorts frames.

The thread polls and reads, cuts frames (CRC), puts measurements into a bounded queue,
passes replies to the waiting thread, and sends a PING per second. Arithmetic is left to
the thread that takes the queue.
"""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    NotHomed,
    Refused,
)
from truepath_drivers.streams.received_bytes import ReceivedBytes
from truepath_drivers.tracker.streaming.codec import is_measurement
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_drivers.tracker.streaming.messages import (
    Ack,
    Command,
    Hello,
    Nak,
    NakCode,
    Ping,
    Reply,
    encode_message,
    parse_message,
)
from truepath_drivers.transport.byte_port import BytePort

log = logging.getLogger(__name__)

# 65 s at 500 Hz, 6.5 s at 5 kHz: longer than any stall that was ever measured.
QUEUED_FRAMES = 1 << 15
KEPT_BYTES = 1 << 22
PING_PERIOD_S = 1.0
_POLL_S = 0.05


class Receiver:
    """Reads one open port until it is closed or lost.

    ping : sends the keep-alive; called once per second by the receiving thread
    """

    def __init__(self, port: BytePort, ping: Callable[[], None]) -> None:
        self.frames = FrameReader()
        self.bytes_received = 0
        self.echoes = False
        self.error: ConnectionLost | None = None
        self._port = port
        self._ping = ping
        self._changed = threading.Condition()
        self._bodies: list[bytes] = []
        self._kept = ReceivedBytes(KEPT_BYTES)
        self._awaited: int | None = None
        self._reply: Reply | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._run, name=f"tracker {port.name}", daemon=True
        )

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """End the thread; the port may be closed afterwards."""
        self._closing.set()
        if self._thread.ident is not None:
            host_clock.join(self._thread)

    def take(self, timeout_s: float, gather_s: float) -> list[bytes]:
        """All bodies in the queue; waits at most `timeout_s` for a first one.

        Then it waits `gather_s` for more: a block of ten samples costs little more than
        a single one. Raises ConnectionLost once the queue is empty and the port lost.
        """
        with self._changed:
            host_clock.wait_for(
                self._changed, lambda: bool(self._bodies or self.error), timeout_s
            )
            host_clock.wait_for(self._changed, lambda: bool(self.error), gather_s)
            bodies, self._bodies = self._bodies, []
        if self.error is not None and not bodies:
            raise self.error
        return bodies

    def take_link_bytes(self) -> bytes:
        """Bytes since the last call; without calls the oldest are dropped."""
        return self._kept.take()

    def expect(self, transaction: int) -> None:
        """Keep the reply of this transaction, and of no other."""
        with self._changed:
            self._awaited, self._reply = transaction, None

    def wait_reply(self, timeout_s: float) -> Reply | None:
        """The expected reply, None after `timeout_s`. Raises ConnectionLost."""
        with self._changed:
            host_clock.wait_for(
                self._changed, lambda: bool(self._reply or self.error), timeout_s
            )
            if self._reply is None and self.error is not None:
                raise self.error
            return self._reply

    def _run(self) -> None:
        due_s = host_clock.now_s() + PING_PERIOD_S
        try:
            while not self._closing.is_set():
                data = self._port.read(_POLL_S)
                if data:
                    self._sort(data)
                if host_clock.now_s() >= due_s:
                    due_s += PING_PERIOD_S
                    self._keep_alive()
        except ConnectionLost as error:
            with self._changed:
                self.error = error
                self._changed.notify_all()

    def _keep_alive(self) -> None:
        try:
            self._ping()
        except DeviceTimeout as error:
            log.warning("keep-alive not sent: %s", error)

    def _sort(self, data: bytes) -> None:
        self.bytes_received += len(data)
        bodies = self.frames.feed(data)
        with self._changed:
            self._kept.add(data)
            was_empty = not self._bodies
            answered = [self._queue(body) for body in bodies]
            # The taker sleeps through the rest of its block, whatever else comes.
            if any(answered) or (was_empty and self._bodies):
                self._changed.notify_all()

    def _queue(self, body: bytes) -> bool:
        """True if it is the awaited reply. When the queue is full, the newest samples
        are dropped: their numbers show how many. Other frames have a queue of the same
        size, so that no START is missed.
        """
        measured = is_measurement(body)
        if len(self._bodies) < (QUEUED_FRAMES if measured else 2 * QUEUED_FRAMES):
            self._bodies.append(body)
        return not measured and self._answers(body)

    def _answers(self, body: bytes) -> bool:
        match parse_message(body):
            case Ack() | Nak() as reply if reply.transaction == self._awaited:
                self._reply, self._awaited = reply, None
                return True
            case Hello():
                self.echoes = True
            case _:
                pass
        return False


_TRIES = 2


class CommandLink:
    """Sends commands over a port. One thread at a time may `request`, any may `ping`.

    reply_timeout_s : longest wait for a reply; the command is sent twice in that time
    """

    def __init__(self, port: BytePort, reply_timeout_s: float) -> None:
        self._port, self._reply_timeout_s = port, reply_timeout_s
        self._write_lock = threading.Lock()
        self._transactions = itertools.count(1)

    def request(
        self,
        receiver: Receiver,
        build: Callable[[int], Command],
        longer_s: float = 0.0,
    ) -> Ack:
        """Send a command until its reply comes; a repeat has the same number.

        build : makes the command from its number; longer_s : additional time

        Raises DeviceTimeout without a reply, ConnectionLost, Refused or NotHomed.
        """
        command = build(next(self._transactions) & 0xFF)
        receiver.expect(command.transaction)
        for left in reversed(range(_TRIES)):
            self._send(command)
            patience_s = self._reply_timeout_s / _TRIES + longer_s * (left == 0)
            reply = receiver.wait_reply(patience_s)
            if reply is not None:
                return self._reject_nak(reply)
        raise DeviceTimeout(
            f"{self._port.name}: no reply to {type(command).__name__.upper()} in "
            f"{self._reply_timeout_s + longer_s:g} s; is the tracker on, warm and in "
            "remote mode?"
        )

    def ping(self) -> None:
        """Send the keep-alive without waiting for its reply."""
        self._send(Ping(next(self._transactions) & 0xFF))

    def _reject_nak(self, reply: Reply) -> Ack:
        if isinstance(reply, Nak):
            family = NotHomed if reply.code == NakCode.NOT_READY else Refused
            raise family(
                f"{self._port.name} refuses: {reply.text or 'no reason given'} "
                f"(code {reply.code})",
                reply.code,
            )
        return reply

    def _send(self, command: Command) -> None:
        with self._write_lock:
            self._port.write(encode_message(command))
