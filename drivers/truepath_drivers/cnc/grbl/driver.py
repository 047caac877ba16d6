"""The driver of controllers that speak GRBL 1.1."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.cnc.control import PriorityLock, wait_for_rest
from truepath_drivers.cnc.grbl.motion import GrblMotion
from truepath_drivers.cnc.grbl.protocol import AXES, Settings, find_least_feed
from truepath_drivers.cnc.grbl.session import GrblSession
from truepath_drivers.cnc.travel import (
    arrange_path,
    check_dwells,
    check_feeds,
    check_positions,
)
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
    Identity,
    MotionState,
    MotionStatus,
    Path,
)
from truepath_drivers.interfaces.tracker import EventSource
from truepath_drivers.interfaces.tracker_records import TrackerEvent
from truepath_drivers.transport.make_port import make_port

log = logging.getLogger(__name__)

_LONGEST_DWELL_S = 3000.0  # GRBL counts 65 535 steps of 0.05 s
_TCP_SILENT_S = 1.0  # after which a network must not deliver lines any more
_OVERRIDE_S = 5.0  # within which all override characters have been obeyed


class GrblController(MotionController, EventSource):
    """GRBL 1.1 with three axes, on a serial `port`, or at `host` behind a converter.

    serial_number : refuse any other machine; GRBL's text, set by `$I=`
    open_s : longest wait for the control to restart when its port is opened
    reply_timeout_s : longest wait for a reply
    poll_s : time between two polls of `wait`

    GRBL has no watchdog. `status` and `wait` send it the next lines, a twentieth of a
    second each: without these calls it stops when its queue is empty, and after a
    second without one it is held.
    Every verb may be called from any thread; `hold` and `abort` go before the others.
    """

    def __init__(
        self,
        *,
        port: str | int,
        host: str | None = None,
        baudrate: int = 115_200,
        serial_number: str = "",
        open_s: float = 3.0,
        reply_timeout_s: float = 0.5,
        poll_s: float = 0.05,
    ) -> None:
        line = make_port(port, host, baudrate, _TCP_SILENT_S)
        self._session = GrblSession(line, open_s, reply_timeout_s)
        self._serial_number, self._poll_s = serial_number, poll_s
        self._motion = GrblMotion(self._session)
        self._lock = PriorityLock()

    @property
    def axes(self) -> tuple[str, ...]:
        return AXES if self._session.settings else ()

    @property
    def travel(self) -> tuple[tuple[float, float], ...]:
        return self._session.settings.travel if self._session.settings else ()

    def connect(self) -> Identity:
        """Open the line, stop any motion, read the settings."""
        with self._lock.hold():
            settings = self._session.settings
            if settings is None or not self._session.is_open:
                self._motion.note_reconnection()
                settings = self._session.open()
                log.info(
                    "%s: GRBL %s answers; this driver has met a simulated one only",
                    self._session.name,
                    settings.version,
                )
            if self._serial_number not in ("", settings.words):
                self._session.close()
                raise WrongDevice(
                    f"{self._session.name}: GRBL calls itself {settings.words!r}, not "
                    f"{self._serial_number!r}"
                )
        return Identity(
            "GRBL", "GRBL", settings.words, settings.version, stops_unasked=True
        )

    def status(self) -> MotionStatus:
        """Read state and position, and send the lines that fit."""
        self._require_settings()
        with self._lock.hold():
            return self._motion.poll()

    def move_to(self, position: Sequence[float], feed_mm_min: float) -> None:
        stops = self._session.stops
        where = np.atleast_2d(np.asarray(position, np.float64))
        row = Path(AXES, where, np.array([feed_mm_min], np.float64), np.zeros(1))
        self._check(row)
        with self._lock.hold():
            self._motion.begin(row, stops)

    def load(self, path: Path) -> None:
        """Store a path here: GRBL has no memory for one."""
        self._require_settings()
        path = arrange_path(path, AXES, drives_arcs=False)
        if not len(path):
            raise Refused("the path has no rows")
        self._check(path)
        check_dwells(path.dwell_s, _LONGEST_DWELL_S)
        with self._lock.hold():
            self._motion.store(path)

    def start(self) -> None:
        stops = self._session.stops
        self._require_settings()
        if (path := self._motion.loaded) is None:
            raise Refused("no path is loaded; load one")
        with self._lock.hold():
            self._motion.begin(path, stops)

    def wait(self, timeout_s: float) -> MotionStatus:
        """Wait until the axes are at rest, sending lines meanwhile."""
        return wait_for_rest(
            self, self._session.name, self._motion.require_able, timeout_s, self._poll_s
        )

    def hold(self) -> None:
        """Feed hold; a reset while it homes. No action before `connect`."""
        if self._session.settings is None:
            return
        if self._motion.is_under_way:
            self._session.brake("command")
            return
        self._session.count_stop()
        with self._lock.hold(urgent=True):
            runs = self._motion.poll().state is MotionState.RUNNING
            if runs or self._motion.is_under_way:
                self._session.brake("command")

    def resume(self) -> None:
        """Resume after a hold by us or the operator, but not after a later one."""
        stops = self._session.stops
        self._require_settings()
        with self._lock.hold():
            self._motion.resume(stops)

    def abort(self) -> None:
        """Brake and discard the path; the axes keep their position."""
        if self._motion.is_under_way:
            self._motion.brake()  # at once, and not as a hold
        else:
            self._session.count_stop()
        if self._session.settings is None:
            return
        with self._lock.hold(urgent=True):
            self._motion.stop()

    def send_heartbeat(self) -> None:
        """GRBL has no watchdog."""

    def take_events(self) -> tuple[TrackerEvent, ...]:
        """Rows that were not executed at one feed."""
        events = self._motion.events
        return tuple(events.popleft() for _ in range(len(events)))

    def reset(self) -> None:
        """Clear an alarm; a machine with homing has to be homed afterwards."""
        self._require_settings()
        with self._lock.hold():
            self._motion.reset()

    def home(self, timeout_s: float) -> None:
        stops = self._session.stops
        if not self._require_settings().homes:
            raise Refused(f"{self._session.name}: homing is not enabled ($22=0)")
        deadline_s = host_clock.now_s() + timeout_s
        try:
            with self._lock.hold():
                self._motion.home(stops)
            while (status := self.status()).state is MotionState.RUNNING:
                if host_clock.now_s() > deadline_s:
                    raise DeviceTimeout(
                        f"{self._session.name}: not homed in {timeout_s:g} s"
                    )
                host_clock.sleep_s(self._poll_s)
        except BaseException:
            if self._session.is_homing:
                self._session.brake("command")
            raise
        if self._session.error:
            raise MotionFault(f"{self._session.name}: {self._session.error}")
        self._motion.require_able(status)
        if status.state is not MotionState.FINISHED:
            raise MotionFault(f"{self._session.name} does not home: {status.alarm}")

    def limit_override(self, largest: float) -> None:
        """Lower the feed override where it is above, one step per poll.

        GRBL keeps these characters as flags: ten that arrive together count once.
        """
        self._require_settings()
        if largest < 0.1:
            raise Refused("GRBL's feed override does not go below 10 %")
        deadline_s = host_clock.now_s() + _OVERRIDE_S
        while True:
            with self._lock.hold():
                for _ in range(2):  # a change is reported in the second at the latest
                    self._motion.poll()
                if self._session.lower(largest):
                    return
                if host_clock.now_s() > deadline_s:
                    raise Refused(f"{self._session.name} does not lower its feed")

    def close(self) -> None:
        with self._lock.hold(urgent=True):  # throughout: no motion may begin meanwhile
            try:
                if self._session.settings and self._session.is_open:
                    self._motion.stop_own_motion()
            except DeviceError as error:
                log.warning("%s closed unanswered: %s", self._session.name, error)
            finally:
                self._session.close()

    def _check(self, path: Path) -> None:
        settings = self._require_settings()
        check_positions(AXES, settings.travel, path.position)
        most = float(np.linalg.norm(settings.rate_mm_min))
        check_feeds(path.feed_mm_min, find_least_feed(settings), most)

    def _require_settings(self) -> Settings:
        if self._session.settings is None:
            raise ConnectionLost(
                f"{self._session.name} is not connected; connect first"
            )
        return self._session.settings
