"""The driver of Othermake's control C7: one line of text asked, one answered."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.cnc.control import wait_for_rest
from truepath_drivers.cnc.travel import arrange_path, check_dwells, check_positions
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    MotionFault,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import (
    UNABLE,
    Identity,
    MotionState,
    MotionStatus,
    Path,
)
from truepath_drivers.transport.line_link import LineLink
from truepath_drivers.transport.tcp_port import TcpPort

log = logging.getLogger(__name__)

_POLL_S = 0.05
_LONGEST_DWELL_S = 600.0


class OthermakeControl(MotionController):
    """A C7 behind TCP. Its words for states are those of `MotionState`.

    host, port : where it listens
    reply_timeout_s : its patience
    """

    def __init__(self, host: str, port: int, *, reply_timeout_s: float = 0.5) -> None:
        self._link = LineLink(TcpPort(host, port))
        self._reply_timeout_s = reply_timeout_s
        self._lock = threading.RLock()  # held for one order and its reply, no longer
        self._travel: dict[str, tuple[float, float]] = {}
        self._identity: Identity | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(self._travel)

    @property
    def travel(self) -> tuple[tuple[float, float], ...]:
        return tuple(self._travel.values())

    def connect(self) -> Identity:
        with self._lock:
            if self._identity is None or not self._link.is_open:
                self._link.close()
                self._link.open()
                try:
                    self._identity = self._greet()
                except DeviceError:
                    self._link.close()
                    raise
                log.warning("%s: no C7 of iron has been met", self._link.name)
            return self._identity

    def close(self) -> None:
        """Stop its motion, then release the port."""
        with self._lock:
            try:
                if self._link.is_open and self.status().state is MotionState.RUNNING:
                    self._ask("ABORT")
            except DeviceError as error:
                log.warning("%s closed unanswered: %s", self._link.name, error)
            finally:
                self._identity = None
                self._link.close()

    def status(self) -> MotionStatus:
        numbers, _, why = self._ask("STATE").partition(";")
        word, line, *position = numbers.split()
        state = MotionState(word)
        return MotionStatus(
            state,
            tuple(float(one) for one in position),
            int(line),
            alarm=why if state in UNABLE else "",
            hold_reason=why if state is MotionState.HELD else "",
        )

    def move_to(self, position: Sequence[float], feed_mm_min: float) -> None:
        self._require_open()
        check_positions(self.axes, self.travel, np.atleast_2d(position))
        self._require_rest()
        self._ask(f"MOVE {feed_mm_min:g} 0 {_write_place(position)}")

    def load(self, path: Path) -> None:
        """Each row is read back: the C7 repeats it as it has understood it."""
        self._require_open()
        path = arrange_path(path, self.axes, drives_arcs=False)
        check_positions(self.axes, self.travel, path.position)
        check_dwells(path.dwell_s, _LONGEST_DWELL_S)
        self._require_rest()
        self._ask("CLEAR")
        rows = zip(path.feed_mm_min, path.dwell_s, path.position.tolist(), strict=True)
        for feed_mm_min, dwell_s, position in rows:
            row = f"ROW {feed_mm_min:g} {dwell_s:g} {_write_place(position)}"
            if (told := self._ask(row)) != row:
                self._ask("CLEAR")
                raise Refused(f"{self._link.name} read {row!r} as {told!r}; load again")

    def start(self) -> None:
        self._require_rest()
        self._ask("GO")

    def wait(self, timeout_s: float) -> MotionStatus:
        name = self._link.name
        return wait_for_rest(self, name, self._require_able, timeout_s, _POLL_S)

    def hold(self) -> None:
        self._ask_if_open("HOLD")

    def resume(self) -> None:
        self._ask_if_open("RESUME")

    def abort(self) -> None:
        self._ask_if_open("ABORT")

    def send_heartbeat(self) -> None:
        self._ask_if_open("BEAT")

    def _greet(self) -> Identity:
        told = self._ask("WHO").split(";")
        if told[:2] != ["Othermake", "C7"] or len(told) != 5:
            raise WrongDevice(
                f"{self._link.name}: no C7 but {told}; check host and port"
            )
        parts = [part.split() for part in self._ask("AXES").split(";")]
        self._travel = {name: (float(low), float(high)) for name, low, high in parts}
        return Identity(*told[:4], has_watchdog=told[4] == "WATCHDOG")

    def _require_open(self) -> None:
        if not self._link.is_open:
            raise ConnectionLost(f"{self._link.name} is not connected; connect first")

    def _require_able(self, status: MotionStatus) -> None:
        if status.state in UNABLE:
            raise MotionFault(f"{UNABLE[status.state]} ({status.alarm})")

    def _require_rest(self) -> None:
        status = self.status()
        self._require_able(status)
        if status.state in (MotionState.RUNNING, MotionState.HELD):
            raise Refused(f"{self._link.name} is {status.state}; wait or abort first")

    def _ask_if_open(self, order: str) -> None:
        if self._link.is_open:
            self._ask(order)

    def _ask(self, order: str) -> str:
        """Send an order once, whatever becomes of its reply."""
        name = self._link.name
        with self._lock:
            self._require_open()
            self._link.send(order.encode())
            reply = self._link.receive(host_clock.now_s() + self._reply_timeout_s)
            if reply is None:
                self._link.close()  # a late reply would be taken for the next one's
                raise DeviceTimeout(
                    f"{name}: no reply to {order.split()[0]} in "
                    f"{self._reply_timeout_s:g} s; check control and cable, then "
                    "connect again"
                )
        word, _, text = reply.decode("ascii", "replace").partition(" ")
        if word != "OK":
            raise Refused(f"{name} refuses {order.split()[0]}: {text or word}")
        return text


def _write_place(position: Sequence[float]) -> str:
    return " ".join(f"{value:.4f}" for value in position)
