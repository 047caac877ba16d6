"""The parent's handle of a cell process.

Verbs are sent and acknowledged by events; only `start`, `connect` and `close` wait. One
thread at a time uses a handle.
"""

from __future__ import annotations

import logging
import signal
from typing import TypeVar

from truepath.child_process import ChildProcess
from truepath.errors import MeasurementFailed, TruepathError
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.messages import (
    CellCommand,
    CellConfig,
    CellEvent,
    CellState,
    CellVerb,
    Connected,
    ConnectRefused,
    FaultReported,
    MeasurementOrder,
    StateChanged,
    TrackerTrial,
    TrackerTried,
)
from truepath.measurement.process.cell_process import STALLED_S, run_cell
from truepath.motion.configurations import Commanded
from truepath.motion.workspace import check_travel
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import Identity

log = logging.getLogger(__name__)

CONNECT_S = 20.0
CLOSE_S = 30.0
FORCE_S = 5.0


_FAMILIES: dict[str, type[Exception]] = {
    family.__name__: family for family in (DeviceError, *DeviceError.__subclasses__())
}

_ANSWERS = Connected | ConnectRefused | TrackerTried
Answer = TypeVar("Answer", Connected, TrackerTried)


class Cell:
    """One cell process, from `start` to `close`."""

    def __init__(self, config: CellConfig) -> None:
        # The cell itself ends with its parent, for it has to hold the feed first.
        self._process = ChildProcess("cell", run_cell, config, ends_with_parent=False)
        self._drivers = f"{config.tracker_driver}, {config.motion_driver}"
        self._events: list[CellEvent] = []
        self._machine: Machine | None = None  # of the current order
        self._is_death_reported = self._closed = False

    @property
    def alive(self) -> bool:
        """Whether the process is alive."""
        return not self._closed and self._process.alive

    @property
    def process_id(self) -> int | None:
        """None before `start`."""
        return self._process.process_id

    def start(self) -> None:
        """Start the process."""
        self._process.start()

    def connect(self) -> dict[str, Identity]:
        """Connect `tracker` and `motion`; their identities by these names.

        Raises a DeviceError, or MeasurementFailed if the cell does not answer.
        """
        return dict(self._request(CellVerb.CONNECT, Connected).devices)

    def try_tracker(self, trial: TrackerTrial) -> TrackerTried:
        """Let the connected tracker measure shortly. Raises as `connect`."""
        return self._request(trial, TrackerTried)

    def _request(self, command: CellCommand, answer: type[Answer]) -> Answer:
        self.send(command)
        deadline_s = host_clock.now_s() + CONNECT_S
        while (left_s := deadline_s - host_clock.now_s()) > 0:
            received = iter(self._receive(left_s))
            for event in received:
                if isinstance(event, (answer, ConnectRefused)):
                    self._events.extend(received)  # what came with it counts too
                if isinstance(event, answer):
                    return event
                if isinstance(event, ConnectRefused):
                    raise _FAMILIES.get(event.family, TruepathError)(event.text)
                self._events.append(event)
            if not self.alive:
                raise MeasurementFailed("the cell process has died while connecting")
        raise MeasurementFailed(f"the cell process did not answer in {CONNECT_S:g} s")

    def begin(self, order: MeasurementOrder) -> None:
        """Begin a measurement. Raises OutOfTravel before anything is sent."""
        check_travel(order.machine, order.commanded)
        self._machine = order.machine
        self.send(order)

    def extend(self, part: Commanded) -> None:
        """Send a further part. Raises OutOfTravel before anything is sent."""
        if self._machine is None:
            raise MeasurementFailed("no measurement is under way; begin one first")
        check_travel(self._machine, part)
        self.send(part)

    def send(self, command: CellCommand) -> None:
        """Raises MeasurementFailed if the process has died."""
        if not self.alive:
            raise MeasurementFailed("the cell process is not alive; start another")
        try:
            self._process.link.send(command)
        except OSError as error:
            raise MeasurementFailed("the cell process has died") from error

    def poll(self, timeout_s: float) -> list[CellEvent]:
        """Events since the last call; waits at most this long for a first one.

        The death of the process is reported once, as a fault `cell-died` and the state
        `faulted`.
        """
        events, self._events = self._events, []
        events += self._receive(0.0 if events else timeout_s)
        if not events and self.process_id and not self._closed and not self.alive:
            events += self._report_death()
        return [e for e in events if not isinstance(e, _ANSWERS)]

    def kill(self) -> None:
        """End the process at once; the machine's watchdog holds the feed."""
        self._process.kill()

    def close(self) -> None:
        """Stop all motion, then end the process, if need be by force. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self.process_id is not None:
            self._end_process()
        self._process.close()

    def _end_process(self) -> None:
        if self._process.alive:
            try:
                self._process.link.send(CellVerb.CLOSE)
            except OSError:
                log.warning("the cell does not listen any more")
        deadline_s = host_clock.now_s() + CLOSE_S
        while self._process.alive and host_clock.now_s() < deadline_s:
            self._events += self._receive(0.05)  # it may wait for us to listen
            self._process.join(0.05)
        if self._process.alive:
            log.error("the cell process does not end; it is ended by force")
            self._process.terminate()
            self._process.join(FORCE_S)

    def _receive(self, timeout_s: float) -> list[CellEvent]:
        events: list[CellEvent] = []
        try:
            while self._process.link.poll(0.0 if events else timeout_s):
                events.append(self._process.link.recv())
        except (EOFError, OSError):
            # The process has ended, or is about to: `alive` will report it.
            self._process.join(timeout_s)
        return events

    def _report_death(self) -> list[CellEvent]:
        if self._is_death_reported:
            return []
        self._is_death_reported = True
        text = f"the cell process has died (exit code {self._process.exit_code})"
        if self._process.exit_code == -signal.SIGALRM:
            text = (
                f"one of the drivers {self._drivers} let nothing else run for "
                f"{STALLED_S} s; the cell process was ended"
            )
        action = "the machine's watchdog holds the feed; look at it, then start again"
        return [
            FaultReported("cell-died", text, action),
            StateChanged(CellState.FAULTED, text),
        ]
