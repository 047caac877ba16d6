"""The driver of Othermake's laser tracker LT-50."""

from __future__ import annotations

import logging
import threading

import numpy as np

from othermake.lines import seal
from othermake.listener import Listener
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


class OthermakeTracker(Tracker, ByteLink):
    """An LT-50 behind TCP.

    host, port : where it listens
    reply_timeout_s : its patience; an LT-50 that searches its target answers late
    """

    def __init__(self, host: str, port: int, *, reply_timeout_s: float = 1.0) -> None:
        self._port = TcpPort(host, port)
        self._reply_timeout_s = reply_timeout_s
        self._verbs = threading.RLock()  # one verb at a time talks to the device
        self._listener: Listener | None = None
        self._identity: Identity | None = None
        self._rate_hz: float | None = None

    def connect(self) -> Identity:
        """Open the port and ask who is there; a stream left behind is ended."""
        with self._verbs:
            if self._listener is None or self._listener.error or not self._identity:
                self._shut()
                self._open()
            if self._identity is None:
                raise ConnectionLost(f"{self._port.name} is not connected")
            return self._identity

    def close(self) -> None:
        """Halt, then release the port."""
        with self._verbs:
            self.stop()
            self._shut()

    def start(self, rate_hz: float) -> None:
        """Begin to stream; a stream at another rate is ended first."""
        with self._verbs:
            self._require_listener()
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
        """Return the samples since the last call."""
        taken = self._require_listener().take_samples(timeout_s)
        if not taken:
            return TrackerSamples.empty()
        return TrackerSamples(
            np.array([s.number for s in taken], np.int64),
            np.array([s.time_s for s in taken]),
            np.array([s.position_mm for s in taken]),
            np.array([s.status for s in taken], np.int64),
        )

    def stop(self) -> None:
        """End the stream."""
        with self._verbs:
            if self._rate_hz is None or self._listener is None:
                return
            self._rate_hz = None
            try:
                self._ask("HALT")
            except DeviceError as error:
                log.warning("the stream was not ended: %s", error)

    def take_link_bytes(self) -> bytes:
        """Return the bytes as they came."""
        return b"" if self._listener is None else self._listener.take_bytes()

    @property
    def health(self) -> LinkHealth:
        """Counts since `connect`."""
        return LinkHealth() if self._listener is None else self._listener.health

    def _open(self) -> None:
        self._port.open()
        self._listener = Listener(self._port)
        self._listener.start()
        try:
            self._ask("HALT")
            kind, _, who = self._ask("WHO").partition(" ")
            if kind != "ME" or who.count(";") != 3:
                raise WrongDevice(f"{self._port.name}: no LT-50 answers, but {who!r}")
        except DeviceError:
            self._shut()
            raise
        self._identity = Identity(*who.split(";"))
        self._listener.take_bytes()

    def _shut(self) -> None:
        listener, self._listener = self._listener, None
        self._identity = self._rate_hz = None
        if listener is not None:
            listener.close()
        self._port.close()

    def _require_listener(self) -> Listener:
        listener = self._listener
        if listener is None:
            raise ConnectionLost(f"{self._port.name} is not connected; connect first")
        return listener

    def _ask(self, order: str) -> str:
        """Send an order; return its reply. What came before it is late: forgotten."""
        listener = self._require_listener()
        listener.forget_replies()
        self._port.write(seal(order))
        reply = listener.take_reply(self._reply_timeout_s)
        if reply is None:
            raise DeviceTimeout(
                f"{self._port.name}: no reply to {order!r} in "
                f"{self._reply_timeout_s:g} s; is the tracker on, and idle?"
            )
        if reply.startswith("NO "):
            raise Refused(f"{self._port.name} refuses {order!r}: {reply[3:]}")
        return reply
