"""Keeps one cell process alive; no other code talks to it.

Commands go through a queue. The cell thread runs them in order, within 50 ms; each is a
future. If a cell dies, its job is informed and another cell is started after a growing
pause. A new cell opens no port and moves nothing until it is requested to: the
machine's own watchdog has held the feed meanwhile.
"""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, suppress
from dataclasses import asdict, replace
from typing import Any

import structlog

from truepath.catalogue.errors import CellDown, DeviceSettings
from truepath.errors import MeasurementFailed, TruepathError
from truepath.machines.cell_counters import CellCounters
from truepath.machines.cell_status import (
    MOVING,
    NOT_READ,
    CellStatus,
    ControllerLevels,
    Devices,
    StreamStatus,
)
from truepath.measurement.messages import (
    BlockRecorded,
    CellEvent,
    CellState,
    CellVerb,
    ControllerRead,
    FaultReported,
    MeasurementOrder,
    SensorsTried,
    StateChanged,
    TemperaturesRead,
    TrackerTrial,
    TrackerTried,
)
from truepath.measurement.process.cell import Cell
from truepath.motion.configurations import Commanded
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError, NotHomed
from truepath_drivers.interfaces.records import TrackerSamples

CHUNK = 20
"""Samples that are handed over together: 40 ms of a typical stream."""
CHUNKS = 50
"""That wait for one listener, two seconds; the oldest are dropped."""


class SampleQueue:
    """Samples that wait for one listener; thread-safe.

    on_put : called after each put; returns at once
    dropped : samples so far that were not taken in time
    """

    def __init__(self, on_put: Callable[[], None]) -> None:
        self._on_put, self.dropped = on_put, 0
        self._lock = threading.Lock()
        self._waiting: deque[TrackerSamples] = deque()

    def put(self, chunk: TrackerSamples) -> None:
        """Drops the oldest chunk if the queue is full. Never waits."""
        with self._lock:
            if len(self._waiting) >= CHUNKS:
                self.dropped += len(self._waiting.popleft())
            self._waiting.append(chunk)
        self._on_put()

    def pop_oldest(self) -> tuple[TrackerSamples | None, int]:
        """The oldest chunk, None if there is none, and `dropped` before it."""
        with self._lock:
            chunk = self._waiting.popleft() if self._waiting else None
            return chunk, self.dropped


class SampleFeed:
    """Hands blocks to listeners, in the thread that publishes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queues: tuple[SampleQueue, ...] = ()

    def subscribe(self, on_put: Callable[[], None]) -> SampleQueue:
        """A queue that fills from now on."""
        queue = SampleQueue(on_put)
        with self._lock:
            self._queues += (queue,)
        return queue

    def unsubscribe(self, queue: SampleQueue) -> None:
        """Stop filling a queue."""
        with self._lock:
            self._queues = tuple(one for one in self._queues if one is not queue)

    def publish(self, block: TrackerSamples) -> None:
        """Hand a block to every listener, in chunks. Returns at once."""
        queues = self._queues
        for begin in range(0, len(block), CHUNK) if queues else ():
            chunk = block.select(slice(begin, begin + CHUNK))
            for waiting in queues:
                waiting.put(chunk)


log = structlog.get_logger(__name__)

POLL_S = 0.05
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
LONG_LIFE_S = 60.0
CONNECT_TIMEOUT_S, END_TIMEOUT_S = 30.0, 10.0
READ_S, READ_SAMPLES = 0.2, 20  # of a tracker at rest, the longer of both
BEAT_S = 0.2  # by which the cell knows that a stop would reach it

Command = Callable[[Cell], Any]
EventHandler = Callable[[CellEvent | None], None]
"""Receives each event, None when the cell has died; must return at once."""


class CellSupervisor:
    """One cell process, from the start of the service to its end.

    make : a new cell, not yet started
    first_pause_s : before another cell is started
    status : the cell's last known state, for any thread
    controller : its last reading at rest; None before and after that
    counters : counts of all its measurements so far
    sensors : how thermometers were read when they were last connected
    stream : state of beam, stream and temperatures from their events
    samples : recorded samples, for listeners
    """

    def __init__(
        self, make: Callable[[], Cell], *, first_pause_s: float = FIRST_PAUSE_S
    ) -> None:
        self._make, self._first_pause_s = make, first_pause_s
        self._commands: queue.SimpleQueue[tuple[Command, Future[Any]]]
        self._commands = queue.SimpleQueue()
        self._on_event: EventHandler | None = None
        self.status = CellStatus()
        self.controller: ControllerLevels | None = None
        self.sensors = SensorsTried()
        self.counters, self.stream = CellCounters(), StreamStatus()
        self.samples = SampleFeed()
        self._closing, self._must_kill = threading.Event(), threading.Event()
        self._thread = threading.Thread(
            target=self._run, name="cell-supervisor", daemon=True
        )

    def read_standstill(self) -> bool | None:
        """Whether the controller has just reported that it has stopped.

        One that only holds has not: its program continues on release. None if unknown:
        during a measurement only its end reports it. Reads no device.
        """
        return self.describe_standstill()[0]

    def describe_standstill(self) -> tuple[bool | None, str]:
        """`read_standstill`, and what it means in a sentence."""
        read = self.controller
        if self.status.state in MOVING or read is None:
            return None, NOT_READ
        return read.is_still, read.describe_standstill()

    def start(self) -> None:
        """Start the thread, which starts the first cell."""
        self._thread.start()

    def connect(self) -> Devices:
        """Open the ports, unless in a measurement; the result identifies the devices.

        Raises DeviceError, DeviceSettings, CellDown.
        """
        with self.counters.time_command("connect"):
            return self._request(self._connect)

    def try_tracker(self, rate_hz: float) -> TrackerTried | None:
        """Read the tracker's stream for a moment; None in a measurement.

        Raises as `connect`.
        """

        def listen(cell: Cell) -> TrackerTried | None:
            if self._on_event is not None:
                return None
            self._connect(cell)
            return cell.try_tracker(TrackerTrial(rate_hz))

        return self._request(listen)

    def monitor_tracker_at_rest(self, rate_hz: float, *, aims: bool) -> None:
        """Update `stream` with beam and samples while nothing is measured.

        aims : the measurement points the beam itself. Raises CellDown.
        """

        def read_at_rest(cell: Cell) -> None:
            if self._on_event is None and self.status.connected:
                self._monitor_at_rest(cell, rate_hz, aims=aims)

        self._request(read_at_rest)

    def begin(
        self,
        order: MeasurementOrder,
        on_event: EventHandler,
        unless: Callable[[], bool],
    ) -> bool:
        """Begin a measurement; False if it was cancelled before the cell was called."""

        def begin(cell: Cell) -> bool:
            if unless():
                return False
            self._on_event = on_event
            self.counters.begin_measurement()
            cell.begin(order)
            return True

        with self.counters.time_command("begin"):
            return self._request(begin, kill_if_late=True)

    def ignore_events(self) -> None:
        """Stop passing on the events of the measurement."""
        self._on_event = None

    def send(self, verb: CellVerb) -> Future[None]:
        """Does not wait."""
        if self.status.state in MOVING:
            self.counters.expect_answer(verb)
        return self._put(lambda cell: cell.send(verb))

    def extend(self, part: Commanded) -> Future[None]:
        """Request to continue with a further part. Does not wait."""
        return self._put(lambda cell: cell.extend(part))

    def kill(self) -> None:
        """Another cell process replaces it."""
        self._must_kill.set()

    def close(self) -> None:
        """End the cell. The cell holds the feed of a moving machine before it ends."""
        self._closing.set()
        if self._thread.is_alive():
            host_clock.join(self._thread, END_TIMEOUT_S)

    def _request(self, command: Command, *, kill_if_late: bool = False) -> Any:
        try:
            return host_clock.result(self._put(command), CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            if kill_if_late:
                self.kill()
            raise CellDown("the cell process does not answer; see the log") from error

    def _put(self, command: Command) -> Future[Any]:
        future: Future[Any] = Future()
        if self._closing.is_set():
            future.set_exception(CellDown("the service is ending"))
        else:
            self._commands.put((command, future))
        return future

    def _pop_commands(self) -> Iterator[tuple[Command, Future[Any]]]:
        with suppress(queue.Empty):
            while True:
                yield self._commands.get_nowait()

    def _reject_commands(self, text: str) -> None:
        for _, future in self._pop_commands():
            future.set_exception(CellDown(text))

    def _run(self) -> None:
        pause_s = self._first_pause_s
        while not self._closing.is_set():
            begun = host_clock.now_s()
            self._run_one_cell()
            if self._closing.is_set():
                break
            has_lived_long = host_clock.now_s() - begun > LONG_LIFE_S
            pause_s = self._first_pause_s if has_lived_long else pause_s
            self._wait(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        self._reject_commands("the service is ending")

    def _run_one_cell(self) -> None:
        try:
            cell = self._make()
            cell.start()
        except Exception as error:
            log.exception("the cell process does not start")
            self._go_down(f"the cell process does not start: {error}")
            return
        self._must_kill.clear()
        self._set_status("disconnected")
        try:
            with closing(cell):
                self._serve(cell)
                if self._must_kill.is_set():
                    cell.kill()  # closing it in order would wait once more
        except Exception:  # else no cell would start again, and jobs would wait
            log.exception("the cell process is given up", state=self.status.state)
        self._go_down("the cell process has ended; it is started again")

    def _serve(self, cell: Cell) -> None:
        beat_s = 0.0
        while not self._closing.is_set() and not self._must_kill.is_set():
            for command, future in self._pop_commands():
                try:
                    future.set_result(command(cell))
                except Exception as error:
                    future.set_exception(error)
            if host_clock.now_s() - beat_s > BEAT_S and cell.alive:
                beat_s = host_clock.now_s()
                with suppress(MeasurementFailed):  # it has just died: seen below
                    cell.send(CellVerb.BEAT)
            alive = cell.alive
            events = cell.poll(POLL_S)
            for event in events:
                self._handle(event)
            if not alive and not events:
                log.error("the cell process has died", state=self.status.state)
                return

    def _handle(self, event: CellEvent) -> None:
        self.counters.count(event)
        self.stream.follow(event)
        match event:
            case StateChanged(state):
                self._follow_state(state)
            case BlockRecorded(block=TrackerSamples() as block):
                self.samples.publish(block)
            case FaultReported(text=text):
                self.status = replace(self.status, text=text)
            case ControllerRead(status, text, axes):
                now_s = host_clock.now_s()
                self.controller = ControllerLevels(status, text, now_s, axes)
                return
            case SensorsTried():
                self.sensors = event
                return
            case TemperaturesRead():
                return
        if self._on_event is not None:
            self._on_event(event)

    def _follow_state(self, state: CellState) -> None:
        if state in MOVING:
            self.controller = None  # a measurement reads it; that is old afterwards
        is_well = state in MOVING or state is CellState.READY
        text = "" if is_well else self.status.text
        devices = {} if state is CellState.FAULTED else self.status.devices
        self._set_status(str(state), text, devices)

    def _set_status(
        self, state: str, text: str = "", devices: Devices | None = None
    ) -> None:
        self.status = CellStatus(state, text, self.status.restarts, devices or {})

    def _connect(self, cell: Cell) -> Devices:
        if self._on_event is not None:
            return self.status.devices
        self._set_status("connecting")
        try:
            found = cell.connect()
            for event in cell.poll(0.0):
                self._handle(event)
        except MeasurementFailed as error:
            raise CellDown(str(error)) from error
        except TruepathError as error:
            self._set_status("disconnected", str(error))
            raise DeviceSettings(str(error)) from error
        except Exception as error:
            self._set_status("disconnected", str(error))
            raise
        devices = {name: asdict(identity) for name, identity in found.items()}
        self._set_status("ready", devices=devices)
        return devices

    def _monitor_at_rest(self, cell: Cell, rate_hz: float, *, aims: bool) -> None:
        try:
            duration_s = max(READ_S, READ_SAMPLES / rate_hz)
            trial = TrackerTrial(rate_hz, duration_s, streams_only=True)
            self.stream.record_trial(cell.try_tracker(trial), rate_hz, aims=aims)
        except NotHomed:
            log.debug("the tracker is heard once the measurement has homed it")
        except DeviceError as error:
            self.stream.record_failure(str(error))
        except MeasurementFailed as error:
            raise CellDown(str(error)) from error

    def _go_down(self, text: str) -> None:
        self.status = CellStatus("down", text, self.status.restarts + 1)
        self.controller = None
        on_event, self._on_event = self._on_event, None
        if on_event is not None:
            on_event(None)
        self._reject_commands(text)

    def _wait(self, pause_s: float) -> None:
        deadline = host_clock.now_s() + pause_s
        while (left_s := deadline - host_clock.now_s()) > 0:
            if host_clock.wait(self._closing, min(left_s, POLL_S)):
                return
            self._reject_commands(self.status.text)
