"""A simulated GRBL at the end of a port within the test's process, on its clock."""

from __future__ import annotations

import threading

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.transport.byte_port import BytePort
from truepath_simulators.cnc.grbl import GrblDevice

_STEP_S = 0.005


class GrblPort(BytePort):
    """Every board that it opens begins as it was left; `is_gone` pulls the cable."""

    def __init__(self, device: GrblDevice) -> None:
        self.device = device
        self.is_gone = False
        self.sent = b""
        self._lock = threading.RLock()  # a stop comes from another thread

    name = "grbl"

    def open(self) -> None:
        if self.is_gone:
            raise ConnectionLost("no such port")

    def read(self, timeout_s: float) -> bytes:
        end_s = host_clock.now_s() + timeout_s
        while True:
            with self._lock:
                self.pass_time()
                said = self.device.take()
            if said:
                return said
            if host_clock.now_s() >= end_s:
                return b""
            host_clock.sleep_s(min(_STEP_S, end_s - host_clock.now_s()))

    def write(self, data: bytes) -> None:
        with self._lock:
            self.pass_time()
            self.sent += data
            self.device.receive(data)

    def pass_time(self) -> None:
        if self.is_gone:
            raise ConnectionLost("the port is gone")
        self.device.update(host_clock.now_s())

    def close(self) -> None:
        pass
