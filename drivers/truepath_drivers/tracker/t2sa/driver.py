"""Driver of trackers behind SpatialAnalyzer's T2SA application."""

from __future__ import annotations

import logging
import math
import re
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    BeamLost,
    DeviceError,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.tracker_records import (
    Clock,
    TrackerCapabilities,
    TrackerEventKind,
)
from truepath_drivers.tracker.line_instrument import LineInstrument
from truepath_drivers.transport.line_link import LineLink
from truepath_drivers.transport.tcp_port import TcpPort

log = logging.getLogger(__name__)

_MM = {"mm": 1.0, "m": 1e3, "inch": 25.4}
_POLL_S = 0.2  # between two looks at a busy application, and at `stop`


class T2saTracker(LineInstrument):
    """A tracker behind T2SA, one point at a time.

    collection, group, point : of the job, under which a point is measured repeatedly
        (`!MEAS_SINGLE_POINT`)
    plan : a measurement plan to run in place of it (`!CMDEXE`, then `?POS`)
    unit : of the job's coordinates, `mm`, `m` or `inch`; the working frame is the
        instrument's own, or one fixed to the tracker
    instrument : its name; the dialogue gives no serial number
    reply_timeout_s : longest wait for a reply; shot_s : for a point
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        collection: str = "A",
        group: str = "truepath",
        point: str = "truepath_1",
        plan: str = "",
        unit: str = "mm",
        instrument: str = "not told",
        reply_timeout_s: float = 2.0,
        shot_s: float = 15.0,
    ) -> None:
        if unit not in _MM:
            raise ValueError(f"unit {unit!r} is none of {', '.join(_MM)}")
        super().__init__(LineLink(TcpPort(host, int(port))))
        self._name = plan or point
        self._command = (
            f"!CMDEXE:{plan}"
            if plan
            else f"!MEAS_SINGLE_POINT:{collection};{group};{point}"
        )
        self._is_plan, self._mm, self._instrument = bool(plan), _MM[unit], instrument
        self._reply_timeout_s, self._shot_s = reply_timeout_s, shot_s

    @property
    def capabilities(self) -> TrackerCapabilities:
        """Polled; the application does not report the tracker's capabilities."""
        return TrackerCapabilities(streams=False, clock=Clock.HOST)

    def greet(self) -> Identity:
        """Request the instrument's status and switch its laser on."""
        try:
            status = self._request("?STAT")
        except DeviceTimeout as error:
            if not self._link.has_received:
                raise
            raise WrongDevice(
                f"{self._link.name}: something answers, but not as T2SA does; check "
                "address and port"
            ) from error
        busy = not status.is_good and status.code in (
            ErrorCode.BUSY,
            ErrorCode.NOT_READY,
        )
        if not busy and CONNECTED not in self._expect(status):
            raise WrongDevice(f"{self._link.name}: no instrument: {status.text}")
        laser = self._expect(self._request("?LSTA"))
        if laser.startswith(LASER_OFF):
            self._expect(self._request("!LST:1"))
        if not laser.startswith(LASER_ON):
            text, action = "the tracker's laser warms up", "wait until it is warm"
            self.tell(TrackerEventKind.WARNING, text, action)
        return Identity("NRK", "T2SA", self._instrument, "")

    def shoot(self) -> tuple[NDArray[np.float64], float]:
        """Measure the point, or run the plan and request the position."""
        if not self._link.is_open:
            self._link.open()
        reply = self._request_when_free(self._command)
        text = self._expect(reply)
        if self._is_plan:
            text = self._expect(self._request_when_free(f"?POS {self._name}"))
        place = parse_point(text, self._name)
        if place is None:
            self._link.close()
            raise DeviceError(
                f"{self._link.name}: {text!r} is no place of {self._name}; check the "
                "names in the settings and in the job"
            )
        return self._mm * place, math.nan

    def _request_when_free(self, command: str) -> Reply:
        deadline_s = host_clock.now_s() + self._shot_s
        while True:
            reply = self._request(command, self._shot_s)
            if reply.is_good or reply.code != ErrorCode.BUSY:
                return reply
            if (
                host_clock.wait(self._stopping, _POLL_S)
                or host_clock.now_s() > deadline_s
            ):
                return reply

    def _request(self, command: str, longer_s: float = 0.0) -> Reply:
        """A reply names no request. So earlier lines are discarded, and after a missing
        reply the connection is closed: a late one is never taken for that of the next
        request.
        """
        with self._lock:
            if self._link.is_open and (stale := self._link.drain()):
                log.warning("%s: left out %r", self._link.name, stale)
            self._link.send(command.encode())
            deadline_s = host_clock.now_s() + self._reply_timeout_s + longer_s
            while (now_s := host_clock.now_s()) < deadline_s:
                line = self._link.receive(min(now_s + _POLL_S, deadline_s))
                reply = None if line is None else parse_reply(line)
                if reply is not None:
                    return reply
                if longer_s and self._stopping.is_set():
                    self._link.send(b"!HALT")
                    self._link.close()
                    raise Refused(f"{self._link.name}: the measurement was stopped")
            self._link.close()
        raise DeviceTimeout(
            f"{self._link.name}: no reply to {command} in "
            f"{self._reply_timeout_s + longer_s:g} s; is T2SA running?"
        )

    def _expect(self, reply: Reply) -> str:
        if self._stopping.is_set() and self._identity is not None:
            raise Refused(f"{self._link.name}: the measurement was stopped")
        if reply.is_good:
            return reply.text
        text = f"{self._link.name}: {reply.text} (ERR-{reply.code})"
        if reply.code in NO_TARGET:
            raise BeamLost(f"{text}; bring the reflector into the beam, then go on")
        raise Refused(text, reply.code)


_REPLY = re.compile(rb"^(ACK|ERR)-(\d{3})\s+(.*)$")
_POINT = re.compile(
    r"^Single Point Measurement (?P<name>.*) result "
    r"(?P<x>[^,]+),(?P<y>[^,]+),(?P<z>[^, ]+)(?: .*)?$"
)
_FRAME = re.compile(
    r"^Object Offset Report (?P<name>[^;]*);"
    r"X:(?P<x>[^;]+);Y:(?P<y>[^;]+);Z:(?P<z>[^;]+);"
)
CONNECTED = "Instrument is connected"
LASER_ON, LASER_OFF = "LON", "LOFF"


class ErrorCode(IntEnum):
    REJECTED = 200
    BUSY = 201
    POINT_FAILED = 305
    HALTED = 330
    NOT_READY = 338
    GROUP_FAILED = 340
    NO_LOCK = 342
    NO_BEAM_LOCK = 343


NO_TARGET = frozenset(
    {
        ErrorCode.POINT_FAILED,
        ErrorCode.GROUP_FAILED,
        ErrorCode.NO_LOCK,
        ErrorCode.NO_BEAM_LOCK,
    }
)


@dataclass(frozen=True, slots=True)
class Reply:
    is_good: bool
    code: int
    text: str


def parse_reply(line: bytes) -> Reply | None:
    """The reply in a line, None where there is none."""
    found = _REPLY.match(line.strip())
    if found is None:
        return None
    kind, code, text = found.groups()
    return Reply(kind == b"ACK", int(code), text.decode("utf-8", "replace"))


def parse_point(text: str, name: str) -> NDArray[np.float64] | None:
    """Point of that name, or frame with it in its name, (3,); else None."""
    point, frame = _POINT.match(text), _FRAME.match(text)
    found = point if point is not None and point["name"] == name else None
    if frame is not None and name in frame["name"]:
        found = frame
    if found is None:
        return None
    try:
        place = np.array([float(found[axis]) for axis in "xyz"])
    except ValueError:
        return None
    # The tracker sees nothing at its own centre: zeros are a point that failed.
    return place if np.isfinite(place).all() and place.any() else None
