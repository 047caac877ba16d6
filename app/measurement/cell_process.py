"""The inside of a cell process: it owns the devices and measures, and computes nothing.

Its main thread takes commands from the parent and obeys them at once; a measurement
has a thread of its own. The process ends with its parent, holding the feed first.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any

from app.errors import TruepathError
from app.measurement.faults import classify_fault
from app.measurement.measurement import Measurement
from app.measurement.messages import (
    BlockRecorded,
    CellCommand,
    CellConfig,
    CellEvent,
    CellState,
    CellVerb,
    Connected,
    ConnectRefused,
    FaultReported,
    LivePoints,
    MeasurementCommand,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from app.measurement.timing import EngineSettings
from app.plugins import load
from drivers.interfaces.errors import DeviceError
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import Identity
from drivers.interfaces.tracker import AnyTracker

log = logging.getLogger(__name__)

TRACKERS, CONTROLLERS = "truepath.trackers", "truepath.motion_controllers"
LOOK_S = 0.5
END_S = 20.0


def run_cell(config: CellConfig, link: Connection) -> None:
    """Run a cell until it is told to close or its parent is gone."""
    signal.signal(signal.SIGTERM, _leave)
    parent = parent_process()
    serve(link, config, () if parent is None else (parent.sentinel,))


def serve(link: Connection, config: CellConfig, lifelines: tuple[int, ...]) -> None:
    """Obey commands from `link` until `close`, its end, or a ready life line."""
    cell = _CellServer(config, Outbox(link))
    parent_id = os.getppid()
    try:
        while True:
            ready = connection.wait([link, *lifelines], LOOK_S)
            if any(line in ready for line in lifelines) or os.getppid() != parent_id:
                log.error("the parent process is gone; the feed is held")
                return
            if link in ready and not cell.obey(link.recv()):
                return
    except (EOFError, OSError):
        log.error("the link to the parent is gone; the feed is held")
    finally:
        cell.end()


def _leave(_signal: int, _frame: FrameType | None) -> None:
    raise SystemExit(0)


class _CellServer:
    """Devices and at most one measurement. Belongs to the thread that commands."""

    def __init__(self, config: CellConfig, outbox: Outbox) -> None:
        self._config, self._outbox = config, outbox
        self._tracker: AnyTracker | None = None
        self._motion: MotionController | None = None
        self._identities: dict[str, Identity] = {}
        self._measurement: Measurement | None = None
        self._thread: threading.Thread | None = None

    def obey(self, command: CellCommand) -> bool:
        """Do what is asked; False if it was to end."""
        match command:
            case CellVerb.CONNECT:
                self._answer_connect()
            case MeasurementOrder():
                self._begin(command)
            case CellVerb.CLOSE:
                return False
            case _ if self._measurement is not None and self._measuring:
                self._pass_on(command, self._measurement)
            case _:
                pass
        return True

    def end(self) -> None:
        """Stand still, end the measurement, release the ports, say the rest."""
        if self._measuring:
            self._quietly(self._measurement and self._measurement.halt)
            if self._thread is not None:
                self._thread.join(END_S)
        for device in (self._motion, self._tracker):
            self._quietly(device and device.close)
        self._outbox.close(1.0)

    @property
    def _measuring(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _answer_connect(self) -> None:
        try:
            if not self._measuring:
                self._connect()
        except (DeviceError, TruepathError, TypeError, ValueError) as error:
            refusal = ConnectRefused(type(error).__name__, str(error))
            self._outbox.report(refusal)
            self._state(CellState.FAILED, str(error))
            return
        self._outbox.report(Connected(dict(self._identities)))

    def _connect(self) -> None:
        self._state(CellState.CONNECTING)
        self._identities = {}
        config, tracker, motion = self._config, self._tracker, self._motion
        if tracker is None or motion is None:
            make_tracker = load(TRACKERS, config.tracker_driver)
            make_motion = load(CONTROLLERS, config.motion_driver)
            tracker = make_tracker(**config.tracker_options)
            motion = make_motion(**config.motion_options)
        self._tracker, self._motion = tracker, motion
        self._identities = {"tracker": tracker.connect(), "motion": motion.connect()}
        self._state(CellState.READY)

    def _begin(self, order: MeasurementOrder) -> None:
        if self._measuring:
            text = "a measurement is under way"
            self._fault("busy", text, "wait for its end, or abort it")
        elif self._tracker is None or self._motion is None or not self._identities:
            text = "tracker and controller are not connected"
            self._fault("not-connected", text, "connect first")
            self._state(CellState.FAILED, text)
            self._outbox.report(RunClosed("", CellState.FAILED))
        else:
            self._measurement = Measurement(
                order,
                self._tracker,
                self._motion,
                self._identities,
                self._outbox.report,
                EngineSettings(
                    timeouts=self._config.timeouts,
                    allow_no_watchdog=self._config.allow_no_watchdog,
                ),
            )
            self._thread = threading.Thread(target=self._measurement.run, name="engine")
            self._thread.start()

    def _pass_on(self, command: MeasurementCommand, measurement: Measurement) -> None:
        try:
            measurement.obey(command)
        except DeviceError as error:
            # The engine insists on the command, and notices the lost link.
            log.warning("%s did not reach the controller: %s", command, error)
            self._outbox.report(classify_fault(error).event)

    def _state(self, state: CellState, text: str = "") -> None:
        self._outbox.report(StateChanged(state, text))

    def _fault(self, code: str, text: str, action: str) -> None:
        self._outbox.report(FaultReported(code, text, action))

    def _quietly(self, step: Callable[[], Any] | None) -> None:
        if step is None:
            return
        try:
            step()
        except DeviceError as error:
            log.warning("on the way out: %s", error)


_LATEST_ONLY = (LivePoints, MeasurementProgress)
MAX_BLOCKS = 100


class Outbox:
    """A thread that sends, so that nobody else ever waits for the parent.

    While the parent is slow, only the latest LivePoints and MeasurementProgress wait
    and about ten seconds of blocks. Every other event is kept, in order, however many:
    a state or a fault is never dropped.
    """

    def __init__(self, link: Connection) -> None:
        self._link = link
        self._waiting: deque[CellEvent] = deque()
        self._changed = threading.Condition()
        self._closing = False
        self.dropped_blocks = 0
        self._thread = threading.Thread(target=self._send, name="outbox", daemon=True)
        self._thread.start()

    def report(self, event: CellEvent) -> None:
        """Send an event as soon as the parent takes it. Any thread; never waits."""
        with self._changed:
            blocks = sum(isinstance(e, BlockRecorded) for e in self._waiting)
            if isinstance(event, BlockRecorded) and blocks >= MAX_BLOCKS:
                self.dropped_blocks += 1
                return
            if isinstance(event, _LATEST_ONLY):
                kind = type(event)
                self._waiting = deque(e for e in self._waiting if type(e) is not kind)
            self._waiting.append(event)
            self._changed.notify()

    def close(self, timeout_s: float) -> None:
        """Send what waits, then end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout_s)

    def _send(self) -> None:
        """Body of the thread. Ends with the parent, too."""
        while (event := self._next()) is not None:
            try:
                self._link.send(event)
            except OSError:
                return

    def _next(self) -> CellEvent | None:
        with self._changed:
            while not self._waiting and not self._closing:
                self._changed.wait()
            return self._waiting.popleft() if self._waiting else None
