"""Keeps one cell process alive and is the only one to speak to it.

Verbs are put in a queue and done by the cell thread, in order, within 50 ms; each is a
future. A cell that dies is told to the job that uses it and made anew after a growing
pause. A new cell opens no port and moves nothing until it is asked to: the machine's
own watchdog has held the feed meanwhile.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

import structlog

from app.errors import MeasurementFailed, TruepathError
from app.jobs.errors import CellDown, DeviceSettings
from app.measurement.messages import (
    CellEvent,
    CellState,
    FaultReported,
    MeasurementOrder,
    StateChanged,
)
from app.motion.configurations import Commanded
from drivers.interfaces.records import Identity

log = structlog.get_logger(__name__)

POLL_S = 0.05
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 30.0
LIVED_WELL_S = 60.0
CONNECT_TIMEOUT_S = 30.0

_MOVING = frozenset(
    {CellState.RUNNING, CellState.PAUSING, CellState.PAUSED, CellState.RESUMING}
)


class CellHandle(Protocol):
    """What `app.measurement.cell.Cell` offers."""

    @property
    def alive(self) -> bool: ...  # noqa: D102 (the class says it)
    @property
    def process_id(self) -> int | None: ...  # noqa: D102
    def start(self) -> None: ...  # noqa: D102
    def connect(self) -> Mapping[str, Identity]: ...  # noqa: D102
    def begin(self, order: MeasurementOrder) -> None: ...  # noqa: D102
    def pause(self) -> None: ...  # noqa: D102
    def resume(self) -> None: ...  # noqa: D102
    def abort(self) -> None: ...  # noqa: D102
    def conclude(self) -> None: ...  # noqa: D102
    def extend(self, part: Commanded) -> None: ...  # noqa: D102
    def poll(self, timeout_s: float) -> list[CellEvent]: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


Deed = Callable[[CellHandle], Any]
Hear = Callable[[CellEvent | None], None]
"""Told every event of a measurement, and None when the cell has died."""


@dataclass(frozen=True, slots=True)
class CellStatus:
    """What the cell said last.

    state : starting, down, disconnected, connecting, ready, or as the cell names it
    """

    state: str = "starting"
    text: str = ""
    restarts: int = 0
    devices: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def connected(self) -> bool:
        """Whether tracker and controller have answered and nothing was lost since."""
        return bool(self.devices)


class CellSupervisor:
    """One cell process, from the start of the service to its end.

    make : returns a new cell, not yet started
    first_pause_s : before a cell that has died is made anew
    """

    def __init__(
        self, make: Callable[[], CellHandle], *, first_pause_s: float = FIRST_PAUSE_S
    ) -> None:
        self._make, self._first_pause_s = make, first_pause_s
        self._deeds: queue.SimpleQueue[tuple[Deed, Future[Any]]] = queue.SimpleQueue()
        self._hear: Hear | None = None
        self._status = CellStatus()
        self._closing = threading.Event()
        self._condemned = threading.Event()
        self._thread = threading.Thread(
            target=self._attend, name="cell-supervisor", daemon=True
        )

    @property
    def status(self) -> CellStatus:
        """What the cell said last. Never waits."""
        return self._status

    def start(self) -> None:
        """Make the first cell."""
        self._thread.start()

    def connect(self) -> Mapping[str, Mapping[str, str]]:
        """Open the ports and return who answers; in a measurement, who answered.

        Raises DeviceError, or CellDown if there is no cell or it does not answer.
        """
        future = self._put(self._connect)
        try:
            return future.result(CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            raise CellDown("the cell process does not answer; see the log") from error

    def begin(
        self, order: MeasurementOrder, hear: Hear, unless: Callable[[], bool]
    ) -> bool:
        """Begin a measurement; False if it was called off before the cell was asked.

        hear : told every event from now on by the cell thread; must return at once
        """

        def deed(cell: CellHandle) -> bool:
            if unless():
                return False
            self._hear = hear
            cell.begin(order)
            return True

        try:
            return self._put(deed).result(CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            self.condemn()
            raise CellDown("the cell process does not answer; see the log") from error

    def forget(self) -> None:
        """Tell the events of the measurement to nobody any more."""
        self._hear = None

    def pause(self) -> None:
        """Ask for a feed hold."""
        self._put(lambda cell: cell.pause())

    def resume(self) -> None:
        """Ask to go on after a hold."""
        self._put(lambda cell: cell.resume())

    def conclude(self) -> None:
        """Ask to finish the line under way and to leave out the rest."""
        self._put(lambda cell: cell.conclude())

    def extend(self, part: Commanded) -> Future[None]:
        """Ask to go on with a further part."""
        return self._put(lambda cell: cell.extend(part))

    def abort(self) -> Future[None]:
        """Ask to stop now and forget the path, whatever happens there."""
        return self._put(lambda cell: cell.abort())

    def condemn(self) -> None:
        """End the cell process without its consent; another takes its place."""
        self._condemned.set()

    def close(self, timeout_s: float = 10.0) -> None:
        """End the cell. What moves is held by the cell on its way out."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _put(self, deed: Deed) -> Future[Any]:
        future: Future[Any] = Future()
        if self._closing.is_set():
            future.set_exception(CellDown("the service is ending"))
        else:
            self._deeds.put((deed, future))
        return future

    def _attend(self) -> None:
        """Body of the cell thread."""
        pause_s = self._first_pause_s
        while not self._closing.is_set():
            begun = time.monotonic()
            self._live_through_one()
            if self._closing.is_set():
                break
            lived_well = time.monotonic() - begun > LIVED_WELL_S
            pause_s = self._first_pause_s if lived_well else pause_s
            self._wait(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        self._refuse_deeds("the service is ending")

    def _live_through_one(self) -> None:
        try:
            cell = self._make()
            cell.start()
        except Exception as error:
            log.exception("the cell process does not start")
            self._go_down(f"the cell process does not start: {error}")
            return
        self._condemned.clear()
        self._status = replace(self._status, state="disconnected", text="", devices={})
        try:
            self._serve(cell)
            if self._condemned.is_set() and cell.process_id is not None:
                # It has had its time; closing it politely would wait once more.
                os.kill(cell.process_id, signal.SIGKILL)
        finally:
            cell.close()
        self._go_down("the cell process has ended; it is started again")

    def _serve(self, cell: CellHandle) -> None:
        while not self._closing.is_set() and not self._condemned.is_set():
            self._do_deeds(cell)
            alive = cell.alive
            events = cell.poll(POLL_S)
            for event in events:
                self._take(event)
            if not alive and not events:
                log.error("the cell process has died", state=self._status.state)
                return

    def _take(self, event: CellEvent) -> None:
        match event:
            case StateChanged(state):
                self._note_state(state)
            case FaultReported(text=text):
                self._status = replace(self._status, text=text)
        if self._hear is not None:
            self._hear(event)

    def _note_state(self, state: CellState) -> None:
        text = "" if state in _MOVING or state is CellState.READY else self._status.text
        devices = {} if state is CellState.FAULTED else self._status.devices
        self._status = replace(
            self._status, state=str(state), text=text, devices=devices
        )

    def _connect(self, cell: CellHandle) -> Mapping[str, Mapping[str, str]]:
        if self._hear is not None:
            return self._status.devices
        self._status = replace(self._status, state="connecting", text="", devices={})
        try:
            found = cell.connect()
        except MeasurementFailed as error:
            raise CellDown(str(error)) from error
        except TruepathError as error:
            self._note_disconnected(error)
            raise DeviceSettings(str(error)) from error
        except Exception as error:
            self._note_disconnected(error)
            raise
        devices = {name: asdict(identity) for name, identity in found.items()}
        self._status = replace(self._status, state="ready", text="", devices=devices)
        return devices

    def _note_disconnected(self, error: Exception) -> None:
        state = "disconnected"
        self._status = replace(self._status, state=state, text=str(error))

    def _do_deeds(self, cell: CellHandle) -> None:
        while True:
            try:
                deed, future = self._deeds.get_nowait()
            except queue.Empty:
                return
            try:
                future.set_result(deed(cell))
            except Exception as error:
                future.set_exception(error)

    def _go_down(self, text: str) -> None:
        restarts = self._status.restarts + 1
        self._status = CellStatus("down", text, restarts)
        hear, self._hear = self._hear, None
        if hear is not None:
            hear(None)
        self._refuse_deeds(text)

    def _refuse_deeds(self, text: str) -> None:
        while True:
            try:
                _, future = self._deeds.get_nowait()
            except queue.Empty:
                return
            future.set_exception(CellDown(text))

    def _wait(self, pause_s: float) -> None:
        deadline = time.monotonic() + pause_s
        while (left_s := deadline - time.monotonic()) > 0:
            if self._closing.wait(min(left_s, POLL_S)):
                return
            self._refuse_deeds(self._status.text)
