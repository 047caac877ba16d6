"""Base of instruments that measure one point at a time, over lines of text."""

from __future__ import annotations

import logging
import math
import threading
from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceError, Refused
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.tracker import ByteLink, EventSource, PolledTracker
from truepath_drivers.interfaces.tracker_records import (
    Air,
    PointMeasurement,
    TrackerEvent,
    TrackerEventKind,
)
from truepath_drivers.transport.line_link import LineLink

log = logging.getLogger(__name__)


class LineInstrument(PolledTracker, ByteLink, EventSource):
    """A polled instrument; a driver defines its identification and its shot."""

    def __init__(self, link: LineLink) -> None:
        self._link = link
        self._lock = threading.RLock()
        self._stopping = threading.Event()
        self._identity: Identity | None = None
        self._events: list[TrackerEvent] = []

    @abstractmethod
    def greet(self) -> Identity:
        """Identify the instrument over the open link. Raises DeviceError."""

    def prepare(self) -> None:
        """Set up the instrument before its first point: here no action."""

    @abstractmethod
    def shoot(self) -> tuple[NDArray[np.float64], float]:
        """One point in mm, and its quality: 1 good, 0 doubtful, NaN not reported."""

    def find_air(self) -> Air | None:
        """Air of a point as the instrument reports it; None by default."""
        return None

    def connect(self) -> Identity:
        """Open the link, identify and prepare the instrument. Idempotent."""
        with self._lock:
            if self._identity is None or not self._link.is_open:
                self._stopping.clear()
                self._link.close()
                self._link.open()
                try:
                    self._identity = self.greet()
                    self.prepare()
                except DeviceError:
                    self.close()
                    raise
                log.info(
                    "%s: %s answers; this driver has met simulated instruments only",
                    self._link.name,
                    self._identity,
                )
            return self._identity

    def close(self) -> None:
        self.stop()
        with self._lock:
            self._identity = None
            self._link.close()

    def stop(self) -> None:
        """End an active dwell; a shot that cannot be interrupted ends by itself."""
        self._stopping.set()

    def measure(self, dwell_s: float) -> PointMeasurement:
        if not 0.0 <= dwell_s < math.inf:
            raise Refused(f"a dwell of {dwell_s} s is no time to measure for")
        with self._lock:
            if self._identity is None:
                raise ConnectionLost(f"{self._link.name}: connect first")
            self._stopping.clear()
            begin_s = host_clock.now_s()
            shots: list[NDArray[np.float64]] = []
            qualities: list[float] = []
            times: list[float] = []
            while not shots or host_clock.now_s() - begin_s < dwell_s:
                before_s = host_clock.now_s()
                shot, quality = self.shoot()
                shots.append(shot)
                qualities.append(quality)
                times.append(0.5 * (before_s + host_clock.now_s()))
                if self._stopping.is_set():
                    raise Refused(f"{self._link.name}: the measurement was stopped")
            good = float(np.mean(qualities))
            return PointMeasurement.average(
                np.array(times), np.array(shots), self.find_air(), good
            )

    def take_link_bytes(self) -> bytes:
        """Bytes as received, at most the last 1 MiB."""
        return self._link.take_bytes()

    def take_events(self) -> tuple[TrackerEvent, ...]:
        taken = tuple(self._events)
        del self._events[: len(taken)]
        return taken

    def tell(self, kind: TrackerEventKind, text: str, action: str = "") -> None:
        self._events.append(TrackerEvent(kind, text, action))
