"""Worker processes of analysis jobs.

A worker process computes one task at a time. When a task is cancelled, its process is
killed and replaced: no task can refuse to end, and none disturbs another. Worker
processes are niced below the 500 Hz reader of the cell.

Why not a pool of the standard library: it would leave the children of a killed process
waiting for ever and its semaphores behind. A worker process ends when its pipe does.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import structlog

from truepath.catalogue.errors import Aborted, TaskFailed
from truepath.child_process import BACKGROUND_NICENESS, WorkerProcess
from truepath.errors import BundleError, WorkerDied
from truepath.progress import Progress
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)

Task = Callable[..., Any]
"""A function of a module, called as `task(*arguments, on_progress=…)` in a worker."""


class ProcessExecutor:
    """Worker processes on this computer.

    count : concurrent tasks; further ones wait in line
    prepare : function of a module, called once in every new process
    """

    def __init__(
        self, count: int = 1, prepare: Callable[[], None] | None = None
    ) -> None:
        self.count, self._prepare = count, prepare
        self._changed = threading.Condition()
        self._free: list[WorkerProcess | None] = [None] * count  # None: not started
        self._busy: set[WorkerProcess] = set()
        self.is_closed = False

    def submit(
        self,
        task: Task,
        *arguments: object,
        on_progress: Progress,
        started: Callable[[], object],
    ) -> Computation:
        """Queue a task; `started` is called when a process is free."""
        call = partial(_run_task, task, *arguments)
        return Computation(self, call, on_progress, started)

    def warm(self) -> None:
        """Start the processes now, not with the first task. Does not wait for them."""
        with self._changed:
            if not self.is_closed:
                self._free = [process or self._start() for process in self._free]

    def close(self) -> None:
        """Kill active tasks and end every process."""
        with self._changed:
            self.is_closed = True
            self._changed.notify_all()
            for process in self._busy:
                process.kill()  # its thread closes it
            for process in filter(None, self._free):
                process.close()

    def acquire(self, cancelled: threading.Event) -> WorkerProcess:
        """Wait for a free process. Raises Aborted if cancelled first."""
        with self._changed:
            host_clock.wait_for(
                self._changed,
                lambda: bool(self._free) or cancelled.is_set() or self.is_closed,
            )
            if cancelled.is_set() or self.is_closed:
                raise Aborted("cancelled before it began")
            process = self._free[-1] or self._start()
            self._free.pop()
            self._busy.add(process)
            return process

    def give_back(self, process: WorkerProcess, *, keep: bool) -> None:
        """Let the next task in line begin, in a new process unless this one is kept."""
        with self._changed:
            keep = keep and not self.is_closed
            self._busy.remove(process)
            self._free.append(process if keep else None)
            self._changed.notify_all()
        if not keep:
            process.close()

    def wake(self) -> None:
        """Let waiting tasks check whether they are cancelled."""
        with self._changed:
            self._changed.notify_all()

    def _start(self) -> WorkerProcess:
        return WorkerProcess(
            "worker", niceness=BACKGROUND_NICENESS, prepare=self._prepare
        )


class Computing(Protocol):
    """Active computation in worker processes: one task, or many."""

    def result(self) -> Any:
        """Wait for the value. Raises Aborted once it is cancelled."""

    def cancel(self) -> None:
        """End it now. Idempotent, any thread."""


@dataclass(eq=False, slots=True)
class Computation:
    """One task, run by the thread that calls `result`."""

    executor: ProcessExecutor
    call: Callable[..., Any]
    on_progress: Progress
    started: Callable[[], object]
    _cancelled: threading.Event = field(default_factory=threading.Event, init=False)
    _process: WorkerProcess | None = field(default=None, init=False)

    def result(self) -> Any:
        """Wait for the value; raises TaskFailed, Aborted, or WorkerDied."""
        process = self._process = self.executor.acquire(self._cancelled)
        keep = True
        try:
            self.started()
            if self._cancelled.is_set():
                process.kill()
            keep = False
            value = process.call(self.call, self.on_progress)
            keep = True
            return value
        except TaskFailed:
            keep = True
            raise
        except WorkerDied as error:
            if self._cancelled.is_set() or self.executor.is_closed:
                raise Aborted("the computation was cancelled") from error
            raise
        finally:
            self._process = None
            self.executor.give_back(process, keep=keep)

    def cancel(self) -> None:
        """Kill its process. Idempotent, any thread."""
        self._cancelled.set()
        self.executor.wake()
        if (process := self._process) is not None:
            process.kill()


def _run_task(task: Task, *arguments: object, on_progress: Progress) -> Any:
    try:
        return task(*arguments, on_progress=on_progress)
    except Exception as error:
        # Not every error can be packed and unpacked again; its name and text can.
        trace = traceback.format_exc()
        raise TaskFailed(type(error).__name__, str(error), trace) from None


_SHOWN = 12  # digits of a digest


@dataclass(frozen=True, slots=True)
class OfUnchangedRuns:
    """A task that first compares each file with its SHA-256.

    Raises BundleError where one has been changed since it was catalogued.

    sha256 : of the catalogue, by file
    """

    task: Task
    sha256: Mapping[str, str]

    def __call__(self, *arguments: object, on_progress: Progress) -> Any:
        """Call the task, in the process that reads the files."""
        # Imported where it reads: an executor alone stays light.
        from truepath.measurement.run_file.run_file import hash_file

        for file, sha256 in self.sha256.items():
            if (now := hash_file(Path(file))) != sha256:
                raise BundleError(
                    f"has been changed since it was catalogued: its SHA-256 is now "
                    f"{now[:_SHOWN]}…, and was {sha256[:_SHOWN]}…",
                    file=Path(file).name,
                    remedy="put the file back from a backup, or upload the bundle as a "
                    "Run of its own",
                )
        return self.task(*arguments, on_progress=on_progress)
