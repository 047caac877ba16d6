"""The driver of Othermake's laser tracker LT-50."""

from __future__ import annotations

import logging
import threading
import time

import numpy as np

from othermake.lines import Inbox, seal
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import Identity, LinkHealth, TrackerSamples
from truepath_drivers.interfaces.tracker import ByteLink, Tracker
from truepath_drivers.transport.tcp_port import TcpPort

log = logging.getLogger(__name__)

RATES_HZ = (10.0, 25.0, 50.0)
_LOOK_S = 0.05


class OthermakeTracker(Tracker, ByteLink):
    """An LT-50 behind TCP. Whoever waits for samples or a reply looks at the port.

    host, port : where it listens
    reply_timeout_s : its patience; an LT-50 that searches its target answers late
    """

    def __init__(self, host: str, port: int, *, reply_timeout_s: float = 1.0) -> None:
        self._port = TcpPort(host, port)
        self._reply_timeout_s = reply_timeout_s
        self._verbs = threading.RLock()  # one verb at a time talks to the device
        self._looking = threading.Lock()
        self._inbox: Inbox | None = None
        self._identity: Identity | None = None
        self._rate_hz: float | None = None

    def connect(self) -> Identity:
        """Open the port and ask who is there; a stream left behind is ended."""
        with self._verbs:
            if self._identity is None:
                self._shut()
                self._port.open()
                self._inbox = Inbox()
                try:
                    self._identity = self._ask_who()
                except DeviceError:
                    self._shut()
                    raise
            return self._identity

    def close(self) -> None:
        """Halt, then release the port."""
        with self._verbs:
            self.stop()
            self._shut()

    def start(self, rate_hz: float) -> None:
        """Begin to stream; a stream at another rate is ended first."""
        with self._verbs:
            self._require_inbox()
            if rate_hz not in RATES_HZ:
                known = ", ".join(f"{rate:g}" for rate in RATES_HZ)
                raise Refused(
                    f"{self._port.name}: an LT-50 streams at {known} Hz, not at "
                    f"{rate_hz:g} Hz; give one of them as the tracker's rate_hz in "
                    "machine.json"
                )
            if self._rate_hz not in (None, rate_hz):
                self.stop()
            if self._rate_hz is None:
                self._ask(f"GO {rate_hz:g}")
                self._rate_hz = rate_hz

    def read(self, timeout_s: float) -> TrackerSamples:
        """Return the samples since the last call, waiting so long for a first one."""
        inbox, end_s = self._require_inbox(), time.monotonic() + timeout_s
        self._look(inbox, 0.0)
        while not inbox.samples and time.monotonic() < end_s:
            self._look(inbox, end_s - time.monotonic())
        with self._looking:
            taken, inbox.samples = inbox.samples, []
        if not taken:
            return TrackerSamples.empty()
        number, time_s, place_mm, status = zip(*taken, strict=True)
        return TrackerSamples(*map(np.array, (number, time_s, place_mm, status)))

    def stop(self) -> None:
        """End the stream."""
        with self._verbs:
            if self._rate_hz is None or self._inbox is None:
                return
            self._rate_hz = None
            try:
                self._ask("HALT")
            except DeviceError as error:
                log.warning("the stream was not ended: %s", error)

    def take_link_bytes(self) -> bytes:
        """Return the bytes as they came."""
        return b"" if self._inbox is None else self._inbox.link_bytes.take()

    @property
    def health(self) -> LinkHealth:
        """Damaged lines since `connect`."""
        inbox = self._inbox
        return LinkHealth(crc_errors=inbox.bad_lines if inbox else 0)

    def _ask_who(self) -> Identity:
        self._ask("HALT")
        kind, _, who = self._ask("WHO").partition(" ")
        if kind != "ME" or who.count(";") != 3:
            raise WrongDevice(f"{self._port.name}: no LT-50 answers, but {who!r}")
        self.take_link_bytes()
        return Identity(*who.split(";"))

    def _shut(self) -> None:
        self._inbox = self._identity = self._rate_hz = None
        self._port.close()

    def _require_inbox(self) -> Inbox:
        if (inbox := self._inbox) is None:
            raise ConnectionLost(f"{self._port.name} is not connected; connect first")
        return inbox

    def _look(self, inbox: Inbox, timeout_s: float) -> None:
        """Sort what comes in so long, or let another thread do so meanwhile."""
        wait_s = min(max(timeout_s, 0.0), _LOOK_S)
        if not self._looking.acquire(timeout=wait_s):
            return
        try:
            inbox.take(self._port.read(wait_s))
        except ConnectionLost:
            self._identity = None  # connect opens the port anew
            raise
        finally:
            self._looking.release()

    def _ask(self, order: str) -> str:
        """Send an order; return its reply. What came before it is late: forgotten."""
        inbox, end_s = self._require_inbox(), time.monotonic() + self._reply_timeout_s
        inbox.replies.clear()
        self._port.write(seal(order))
        while not inbox.replies:
            if time.monotonic() > end_s:
                raise DeviceTimeout(
                    f"{self._port.name}: no reply to {order!r} in "
                    f"{self._reply_timeout_s:g} s; is the tracker on, and idle?"
                )
            self._look(inbox, _LOOK_S)
        reply = inbox.replies.popleft()
        if reply.startswith("NO "):
            raise Refused(f"{self._port.name} refuses {order!r}: {reply[3:]}")
        return reply
