"""Where science jobs compute: a port, and its adapter of processes on this computer.

A worker process computes one task at a time. When a task is cancelled, its process is
killed and replaced: no task can refuse to end, and none disturbs another. Worker
processes yield the processor to the 500 Hz reader of the cell.
"""

from __future__ import annotations

import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from app.child_process import BACKGROUND_NICENESS
from app.jobs.errors import Aborted, TaskFailed, WorkerDied
from app.jobs.worker_process import Call, WorkerProcess
from app.progress import Progress

Task = Callable[..., Any]
"""A function of a module, called as `task(*arguments, on_progress=…)` in a worker."""


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


class ProcessExecutor(Executor):
    """Worker processes on this computer.

    count : tasks that compute at one time; further ones wait in line
    prepare : function of a module, called once in every new process
    """

    def __init__(
        self, count: int = 1, prepare: Callable[[], None] | None = None
    ) -> None:
        self._workers = tuple(_Worker(prepare) for _ in range(count))
        self._free = list(self._workers)
        self._changed = threading.Condition()
        self._closed = False

    def submit(
        self,
        task: Task,
        *arguments: object,
        on_progress: Progress,
        started: Callable[[], None],
    ) -> Computation:
        """Begin a task as soon as a worker process is free."""
        return _WaitingTask(self, task, arguments, on_progress, started)

    def warm(self) -> None:
        """Start the processes now, not with the first task. Does not wait for them."""
        for worker in self._workers:
            worker.warm()

    def close(self) -> None:
        """Kill what runs and end every process."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for worker in self._workers:
            worker.close()

    def take(self, cancelled: threading.Event) -> _Worker:
        """Wait for a free worker. Raises Aborted if cancelled first."""
        with self._changed:
            while not self._free and not cancelled.is_set() and not self._closed:
                self._changed.wait()
            if cancelled.is_set() or self._closed:
                raise Aborted("cancelled before it began")
            return self._free.pop()

    def give_back(self, worker: _Worker) -> None:
        """Let the next task in line begin."""
        with self._changed:
            self._free.append(worker)
            self._changed.notify_all()

    def wake(self) -> None:
        """Let those who wait look whether they are cancelled."""
        with self._changed:
            self._changed.notify_all()


class _WaitingTask(Computation):
    """Waits for a worker, then computes; driven by the thread of `result`."""

    def __init__(
        self,
        executor: ProcessExecutor,
        task: Task,
        arguments: tuple[object, ...],
        on_progress: Progress,
        started: Callable[[], None],
    ) -> None:
        self._executor, self._started = executor, started
        self._on_progress = on_progress
        self._call = Call(_run_task, (task, arguments), reports_progress=True)
        self._cancelled = threading.Event()
        self._worker: _Worker | None = None

    def result(self) -> Any:
        worker = self._worker = self._executor.take(self._cancelled)
        try:
            self._started()
            return worker.compute(self._call, self._on_progress, self._cancelled)
        finally:
            self._worker = None
            self._executor.give_back(worker)

    def cancel(self) -> None:
        self._cancelled.set()
        self._executor.wake()
        if (worker := self._worker) is not None:
            worker.kill()


class _Worker:
    """One place to compute: a process, replaced when it has been killed."""

    def __init__(self, prepare: Callable[[], None] | None) -> None:
        self._prepare = prepare
        self._lock = threading.Lock()
        self._process: WorkerProcess | None = None
        self._is_busy = self._is_closed = False

    def compute(
        self, call: Call, on_progress: Progress, cancelled: threading.Event
    ) -> Any:
        """Run a task in the process, started first if there is none."""
        process = self._open(is_busy=True)
        is_whole = False
        try:
            if cancelled.is_set():
                process.kill()
            value = process.call(call, on_progress)
            is_whole = True
            return value
        except WorkerDied as error:
            if cancelled.is_set() or self._is_closed:
                raise Aborted("the computation was cancelled") from error
            raise
        except TaskFailed:
            is_whole = True
            raise
        finally:
            self._release(process, keep=is_whole)

    def warm(self) -> None:
        """Start the process, if none runs."""
        if not self._is_closed:
            self._open(is_busy=False)

    def kill(self) -> None:
        """End the process, whatever it does; the next task gets a new one."""
        with self._lock:
            if self._process is not None:
                self._process.kill()

    def close(self) -> None:
        """End the process for good."""
        with self._lock:
            self._is_closed = True
            process = self._process
            if self._is_busy and process is not None:
                process.kill()  # its thread closes it
            elif process is not None:
                process.close()

    def _open(self, *, is_busy: bool) -> WorkerProcess:
        with self._lock:
            if self._is_closed:
                raise Aborted("the service is ending")
            if self._process is None:
                self._process = WorkerProcess(
                    "worker", niceness=BACKGROUND_NICENESS, prepare=self._prepare
                )
            self._is_busy = self._is_busy or is_busy
            return self._process

    def _release(self, process: WorkerProcess, *, keep: bool) -> None:
        with self._lock:
            self._is_busy = False
            if not keep or self._is_closed:
                self._process = None
                process.close()


def _run_task(
    task: Task, arguments: tuple[object, ...], *, on_progress: Progress
) -> Any:
    try:
        return task(*arguments, on_progress=on_progress)
    except Exception as error:
        # Not every error can be packed and unpacked again; its name and text can.
        trace = traceback.format_exc()
        raise TaskFailed(type(error).__name__, str(error), trace) from None
