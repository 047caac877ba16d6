"""Inside of a cell process: it owns the devices and measures, and computes nothing.

Its main thread executes commands of the parent at once; a measurement has a separate
thread. The process ends with its parent, holding the feed first.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from truepath.device_options import make_device
from truepath.driver_border import find_stuck
from truepath.errors import TruepathError
from truepath.files.bundle.sensor_gate import ChannelGate
from truepath.files.environment import choose_refraction
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.faults import classify_fault
from truepath.measurement.messages import (
    BlockRecorded,
    CellCommand,
    CellConfig,
    CellEvent,
    CellState,
    CellVerb,
    Connected,
    ConnectRefused,
    ControllerRead,
    FaultReported,
    LivePoints,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    SensorsTried,
    StateChanged,
    TemperaturesRead,
    TrackerTrial,
)
from truepath.measurement.monitors.environment_reader import SensorPlausibility
from truepath.measurement.monitors.stream_reader import try_tracker
from truepath.measurement.time_limits import EngineSettings
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError, Refused
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.thermometers import Thermometers
from truepath_drivers.interfaces.tracker import AnyTracker

log = logging.getLogger(__name__)

LOOK_S = 0.25
CONTROLLER_S, AWAY_S = 1.0, 5.0  # between two readings at rest, and where it is away
THERMOMETERS_S, THERMOMETERS_AWAY_S = 10.0, 60.0
SERVICE_S = 1.5  # without a beat of the service, and the feed is held
END_S = 20.0
_SOONER_S = 1.0  # than the engine, the border names the driver
STALLED_S = 15  # in which no thread of the process has run
ORPHAN_S, EXIT_S = 1.5, 5.0  # for the rest, after the end of the parent or of all


def run_cell(config: CellConfig, link: Connection) -> None:
    """Run a cell until its parent closes it or is gone."""
    signal.signal(signal.SIGTERM, _exit_on_signal)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    try:
        serve(link, config, () if parent is None else (parent.sentinel,))
    finally:
        _exit_within(EXIT_S)  # a thread of a driver may not end


def _watch(parent: BaseProcess) -> None:
    """A driver may let no other thread run: then the kernel ends the process."""
    while parent.is_alive():
        signal.alarm(STALLED_S)
        parent.join(1.0)
    _exit_within(ORPHAN_S)


def _exit_within(limit_s: float) -> None:
    timer = threading.Timer(limit_s, os._exit, (1,))
    timer.daemon = True
    timer.start()


def serve(link: Connection, config: CellConfig, lifelines: tuple[int, ...]) -> None:
    """Execute commands from `link` until `close`, its end, or a ready life line."""
    cell = _CellServer(config, Outbox(link))
    parent_id = os.getppid()
    try:
        while True:
            ready = connection.wait([link, *lifelines], LOOK_S)
            if any(line in ready for line in lifelines) or os.getppid() != parent_id:
                log.error("the parent process is gone; the feed is held")
                return
            if link not in ready:
                cell.check_service()
            elif not cell.obey(link.recv()):
                return
            if cell.is_spoilt:
                log.error("a call of a driver does not end; the process ends for it")
                return
            cell.poll_controller()
            cell.poll_thermometers()
    except (EOFError, OSError):
        log.error("the link to the parent is gone; the feed is held")
    finally:
        cell.end()


def _exit_on_signal(_signal: int, _frame: FrameType | None) -> None:
    raise SystemExit(0)


class _CellServer:
    """One thread only."""

    def __init__(self, config: CellConfig, outbox: Outbox) -> None:
        self._config, self._outbox = config, outbox
        self._tracker: AnyTracker | None = None
        self._motion: MotionController | None = None
        self._thermometers: Thermometers | None = None
        self._identities: dict[str, Identity] = {}
        self._measurement: Measurement | None = None
        self._thread: threading.Thread | None = None
        self._beat_s: float | None = None  # of the service, the last one
        self._checked_s = 0.0
        self._controller_s = 0.0  # when it is read again
        self._thermometers_s = 0.0  # likewise
        self._checks: dict[str, SensorPlausibility] = {}
        self._has_tried = False  # to connect or to measure, of late

    @property
    def is_spoilt(self) -> bool:
        """True after a driver call that does not end: another process has to replace
        this one. The caller that connects or measures has the reply.
        """
        tried = self._has_tried and not self._measuring
        return tried and bool(find_stuck(self._tracker, self._motion))

    def poll_controller(self) -> None:
        now_s = host_clock.now_s()
        if self._motion is None or not self._identities or self._measuring:
            return
        if now_s < self._controller_s:
            return
        try:
            status = self._motion.status()
            read = ControllerRead(status, axes=self._motion.axes)
        except DeviceError as error:
            read = ControllerRead(None, str(error))
        pause_s = CONTROLLER_S if read.status else AWAY_S
        self._controller_s = host_clock.now_s() + pause_s
        self._outbox.report(read)

    def poll_thermometers(self) -> None:
        """Not during a measurement and shortly after, which has its own reader. A
        reader that hangs in its driver is not waited for: it has ended by the next
        look.
        """
        now_s = host_clock.now_s()
        if self._measuring:
            self._thermometers_s = now_s + THERMOMETERS_S
        if self._thermometers is None or "thermometers" not in self._identities:
            return
        if now_s < self._thermometers_s:
            return
        try:
            readings = self._thermometers.read()
        except DeviceError as error:
            log.warning("thermometers: %s", error)
            readings = ()
        shown: dict[str, float] = {}
        for one in readings:
            if one.channel.endswith("_degC"):
                shown[one.channel], _ = self._checks[one.channel].assess(one)
        is_away = not any(math.isfinite(value) for value in shown.values())
        pause_s = THERMOMETERS_AWAY_S if is_away else THERMOMETERS_S
        self._thermometers_s = host_clock.now_s() + pause_s
        self._outbox.report(TemperaturesRead(shown))

    def check_service(self) -> None:
        """Time in which this process was suspended does not count as silence of the
        service: it counts from the first look after it.
        """
        if self._beat_s is None:
            return
        now_s = host_clock.now_s()
        if now_s - self._checked_s > 2.0 * LOOK_S:
            self._beat_s = now_s
        self._checked_s = now_s
        if now_s - self._beat_s > SERVICE_S and self._measurement and self._measuring:
            self._carry_out(self._measurement.miss_service, "hold")

    def obey(self, command: CellCommand) -> bool:
        """False for a request to end."""
        match command:
            case CellVerb.CONNECT:
                self._answer_connect()
            case TrackerTrial():
                self._answer_trial(command)
            case MeasurementOrder():
                self._begin(command)
            case CellVerb.CLOSE:
                return False
            case CellVerb.BEAT:
                self._beat_s = self._checked_s = host_clock.now_s()
            case _ if self._measurement is not None and self._measuring:
                order = partial(self._measurement.obey, command)
                self._carry_out(order, str(command))
            case _:
                pass
        return True

    def end(self) -> None:
        if self._measuring:
            self._quietly(self._measurement and self._measurement.halt)
            if self._thread is not None:
                host_clock.join(self._thread, END_S)
        for device in (self._motion, self._tracker, self._thermometers):
            self._quietly(device and device.close)
        self._outbox.close(1.0)

    @property
    def _measuring(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _answer_connect(self) -> None:
        self._has_tried = True
        try:
            if not self._measuring:
                self._connect()
        except (DeviceError, TruepathError, TypeError, ValueError) as error:
            refusal = ConnectRefused(type(error).__name__, str(error))
            self._outbox.report(refusal)
            self._state(CellState.FAILED, str(error))
            return
        self._outbox.report(Connected(dict(self._identities)))

    def _answer_trial(self, trial: TrackerTrial) -> None:
        try:
            if self._measuring or self._tracker is None or not self._identities:
                raise Refused("the tracker is not connected, or it is measuring")
            self._outbox.report(try_tracker(self._tracker, trial))
        except DeviceError as error:
            self._outbox.report(ConnectRefused(type(error).__name__, str(error)))

    def _connect(self) -> None:
        self._state(CellState.CONNECTING)
        self._identities = {}
        config, tracker, motion = self._config, self._tracker, self._motion
        if tracker is None or motion is None:
            limits_s = {"measure": config.timeouts.point_s - _SOONER_S}
            tracker = make_device(
                "tracker", config.tracker_driver, config.tracker_options, limits_s
            )
            motion = make_device("motion", config.motion_driver, config.motion_options)
            if config.thermometer_driver:
                self._thermometers = make_device(
                    "thermometer", config.thermometer_driver, config.thermometer_options
                )
        self._tracker, self._motion = tracker, motion
        self._identities = {"tracker": tracker.connect(), "motion": motion.connect()}
        choose_refraction(tracker.capabilities, config.light)  # refuses what is twice
        self._connect_thermometers()
        self._controller_s = 0.0
        self._state(CellState.READY)

    def _connect_thermometers(self) -> None:
        if self._thermometers is not None:
            refused = ""
            try:
                self._identities["thermometers"] = self._thermometers.connect()
                gates: dict[str, ChannelGate] = {}
                channels = self._thermometers.channels
                self._checks = {
                    c.name: SensorPlausibility(c, None, gates) for c in channels
                }
            except DeviceError as error:
                refused = str(error)
                log.warning("thermometers: %s", error)
            self._outbox.report(SensorsTried(self._thermometers.tries, refused))

    def _begin(self, order: MeasurementOrder) -> None:
        if self._measuring:
            text, action = "a measurement is under way", "wait for its end, or abort it"
            self._outbox.report(FaultReported("busy", text, action))
        elif self._tracker is None or self._motion is None or not self._identities:
            text = "tracker and controller are not connected"
            self._reject(FaultReported("not-connected", text, "connect first"))
        else:
            self._has_tried = True
            try:
                self._measurement = Measurement(
                    order,
                    self._tracker,
                    self._motion,
                    self._identities,
                    self._outbox.report,
                    EngineSettings(
                        timeouts=self._config.timeouts,
                        allow_no_watchdog=self._config.allow_no_watchdog,
                        light=self._config.light,
                    ),
                    self._thermometers,
                )
            except DeviceError as error:
                self._reject(classify_fault(error).event)
                return
            self._thread = threading.Thread(target=self._measurement.run, name="engine")
            self._thread.start()

    def _reject(self, fault: FaultReported) -> None:
        self._outbox.report(fault)
        self._state(CellState.FAILED, fault.text)
        self._outbox.report(RunClosed("", CellState.FAILED))

    def _carry_out(self, step: Callable[[], None], name: str) -> None:
        try:
            step()
        except DeviceError as error:
            # The engine insists on the command, and notices the lost link.
            log.warning("%s did not reach the controller: %s", name, error)
            self._outbox.report(classify_fault(error).event)

    def _state(self, state: CellState, text: str = "") -> None:
        self._outbox.report(StateChanged(state, text))

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
    """A thread that sends, so that no other waits for the parent.

    While the parent is slow, only the latest LivePoints and MeasurementProgress wait
    and about ten seconds of blocks. Every other event is kept, in order, without limit:
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
        """Send pending events, then end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        host_clock.join(self._thread, timeout_s)

    def _send(self) -> None:
        while (event := self._next()) is not None:
            try:
                self._link.send(event)
            except OSError:
                return

    def _next(self) -> CellEvent | None:
        with self._changed:
            host_clock.wait_for(
                self._changed, lambda: bool(self._waiting) or self._closing
            )
            return self._waiting.popleft() if self._waiting else None
