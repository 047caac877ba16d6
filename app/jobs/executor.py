"""Where science jobs compute: a port, and its adapter of processes on this computer.

A lane is one spawned process that computes one task at a time. A task that is cancelled
has its process killed and the lane is made anew: no task can refuse to end, and none
disturbs another. Lanes are niced, so that the 500 Hz reader of the cell goes first, and
their linear algebra runs on one thread: threads of several processes only fight over
the cores (measured: 11.1 s against 0.58 s for the same work).
"""

from __future__ import annotations

import os
import signal
import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from typing import Any

import structlog

from app.jobs.errors import Aborted, TaskFailed, WorkerDied
from app.progress import Progress

log = structlog.get_logger(__name__)

Task = Callable[..., Any]
"""A function of a module, called as `task(*arguments, on_progress=…)` in a lane."""

BELOW_THE_CELL = 10
_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


class Computation(ABC):
    """A task under way."""

    @abstractmethod
    def result(self) -> Any:
        """Wait for the value; raises TaskFailed, Aborted, or WorkerDied."""

    @abstractmethod
    def cancel(self) -> None:
        """End it now, whatever it does. Idempotent, any thread."""


class Executor(ABC):
    """Computes tasks elsewhere."""

    @abstractmethod
    def submit(
        self,
        task: Task,
        *arguments: object,
        on_progress: Progress,
        started: Callable[[], None],
    ) -> Computation:
        """Begin a task as soon as there is room for it; `started` is called then."""

    @abstractmethod
    def close(self) -> None:
        """Cancel what runs and release everything."""


def limit_threads() -> None:
    """Give linear algebra one thread in every process started from now on."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")


class ProcessLanes(Executor):
    """Spawned processes on this computer.

    lanes : tasks that compute at one time; further ones wait in line
    prepare : function of a module, called once in every new process
    """

    def __init__(
        self, lanes: int = 1, prepare: Callable[[], None] | None = None
    ) -> None:
        limit_threads()
        self._free = [_Lane(prepare) for _ in range(lanes)]
        self._lanes = tuple(self._free)
        self._changed = threading.Condition()
        self._closed = False

    def submit(
        self,
        task: Task,
        *arguments: object,
        on_progress: Progress,
        started: Callable[[], None],
    ) -> Computation:
        """Begin a task as soon as a lane is free."""
        return _Waiting(self, task, arguments, on_progress, started)

    def warm(self) -> None:
        """Start the processes now, not with the first task. Does not wait for them."""
        for lane in self._lanes:
            threading.Thread(target=lane.warm, name="warm-lane").start()

    def close(self) -> None:
        """Kill what runs and end every lane."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for lane in self._lanes:
            lane.close()

    def take(self, cancelled: threading.Event) -> _Lane:
        """Wait for a free lane. Raises Aborted if cancelled first."""
        with self._changed:
            while not self._free and not cancelled.is_set() and not self._closed:
                self._changed.wait()
            if cancelled.is_set() or self._closed:
                raise Aborted("cancelled before it began")
            return self._free.pop()

    def give_back(self, lane: _Lane) -> None:
        """Let the next task in line begin."""
        with self._changed:
            self._free.append(lane)
            self._changed.notify_all()

    def wake(self) -> None:
        """Let those who wait look whether they are cancelled."""
        with self._changed:
            self._changed.notify_all()


class _Waiting(Computation):
    """A task that waits for a lane, then computes; driven by the thread of `result`."""

    def __init__(
        self,
        lanes: ProcessLanes,
        task: Task,
        arguments: tuple[object, ...],
        on_progress: Progress,
        started: Callable[[], None],
    ) -> None:
        self._lanes, self._task, self._arguments = lanes, task, arguments
        self._on_progress, self._started = on_progress, started
        self._cancelled = threading.Event()
        self._lane: _Lane | None = None

    def result(self) -> Any:
        lane = self._lane = self._lanes.take(self._cancelled)
        try:
            self._started()
            return lane.compute(
                self._task, self._arguments, self._on_progress, self._cancelled
            )
        finally:
            self._lane = None
            self._lanes.give_back(lane)

    def cancel(self) -> None:
        self._cancelled.set()
        self._lanes.wake()
        if (lane := self._lane) is not None:
            lane.kill()


class _Lane:
    """One process and the pipe on which it reports."""

    def __init__(self, prepare: Callable[[], None] | None) -> None:
        self._prepare = prepare
        self._busy = False
        self._lock = threading.Lock()
        self._link: _Link | None = None
        self._closed = False

    def compute(
        self,
        task: Task,
        arguments: tuple[object, ...],
        on_progress: Progress,
        cancelled: threading.Event,
    ) -> Any:
        """Run a task in the process, made first if there is none."""
        link = self._open()
        self._busy = True
        try:
            future = _submitted(link.pool, task, arguments)
            if cancelled.is_set():
                self.kill()
            _relay(link.reports, future, on_progress)
            return future.result()
        except BrokenProcessPool as error:
            self.kill()
            if cancelled.is_set() or self._closed:
                raise Aborted("the computation was cancelled") from error
            raise WorkerDied(
                "the computing process ended without an answer: killed, or out of "
                "memory; run the job again"
            ) from error
        finally:
            self._busy = False

    def warm(self) -> None:
        """Start the process, if none runs."""
        with suppress(Aborted, BrokenProcessPool):
            self._open()

    def kill(self) -> None:
        """End the process, whatever it does; the next task gets a new one."""
        with self._lock:
            link, self._link = self._link, None
        if link is not None:
            link.kill()

    def close(self) -> None:
        """End the process for good: politely where it is idle."""
        self._closed = True
        with self._lock:
            link = self._link
            if link is not None and link.is_idle and not self._busy:
                self._link = None
                link.pool.shutdown()
        self.kill()

    def _open(self) -> _Link:
        with self._lock:
            if self._closed:
                raise Aborted("the service is ending")
            if self._link is None:
                self._link = _Link.opened(self._prepare)
            return self._link


@dataclass(frozen=True, slots=True)
class _Link:
    """A pool of one process, where it reports, and who it is."""

    pool: ProcessPoolExecutor
    reports: Connection
    process_id: int
    prepared: Future[None] | None

    @classmethod
    def opened(cls, prepare: Callable[[], None] | None) -> _Link:
        context = get_context("spawn")
        reports, send = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(
            1, mp_context=context, initializer=_enter_lane, initargs=(send,)
        )
        with send:  # ours; the process has its own end
            process_id = pool.submit(os.getpid).result()
        prepared = None if prepare is None else pool.submit(prepare)
        return cls(pool, reports, process_id, prepared)

    @property
    def is_idle(self) -> bool:
        """Whether the process has finished its imports."""
        return self.prepared is None or self.prepared.done()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self.process_id, signal.SIGKILL)
        # `reports` may be in use by the thread of the task; it ends with its last user.
        self.pool.shutdown(wait=True, cancel_futures=True)


def _submitted(
    pool: ProcessPoolExecutor, task: Task, arguments: tuple[object, ...]
) -> Future[Any]:
    try:
        return pool.submit(_in_lane, task, arguments)
    except RuntimeError as error:  # killed between being taken and being given work
        raise BrokenProcessPool(str(error)) from error


def _relay(reports: Connection, future: Future[Any], on_progress: Progress) -> None:
    """Pass on what the process reports until its task has ended."""
    try:
        while not future.done() or reports.poll():
            if reports.poll(0.05):
                fraction, stage = reports.recv()
                on_progress(fraction, stage)
    except (EOFError, OSError):
        log.debug("a lane stopped reporting")


_reports: Connection | None = None


def _enter_lane(reports: Connection) -> None:
    """Prepare a process: end with its parent, step behind the cell, ignore Ctrl+C."""
    global _reports
    _reports = reports
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(BELOW_THE_CELL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _in_lane(task: Task, arguments: tuple[object, ...]) -> Any:
    try:
        return task(*arguments, on_progress=_report)
    except Exception as error:
        # Not every error can be packed and unpacked again; its name and text can.
        trace = traceback.format_exc()
        raise TaskFailed(type(error).__name__, str(error), trace) from None


def _report(fraction: float, stage: str) -> None:
    if _reports is not None:
        with suppress(OSError):
            _reports.send((fraction, stage))
