"""Worker processes, where science jobs compute.

A worker process computes one task at a time. When a task is cancelled, its process is
killed and replaced: no task can refuse to end, and none disturbs another. Worker
processes yield the processor to the 500 Hz reader of the cell.

Why not a pool of the standard library: it would leave the children of a killed process
waiting for ever and its semaphores behind. A worker process ends when its pipe does.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Protocol

import structlog

from truepath.app.child_process import BACKGROUND_NICENESS, ChildProcess
from truepath.app.jobs.errors import Aborted, TaskFailed, WorkerDied
from truepath.app.progress import Progress

log = structlog.get_logger(__name__)

Task = Callable[..., Any]
"""A function of a module, called as `task(*arguments, on_progress=…)` in a worker."""

_END_S = 5.0


class ProcessExecutor:
    """Worker processes on this computer.

    count : tasks that compute at one time; further ones wait in line
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
        """Begin a task as soon as a process is free; `started` is called then."""
        call = partial(_run_task, task, *arguments)
        return Computation(self, call, on_progress, started)

    def warm(self) -> None:
        """Start the processes now, not with the first task. Does not wait for them."""
        with self._changed:
            if not self.is_closed:
                self._free = [process or self._start() for process in self._free]

    def close(self) -> None:
        """Kill what runs and end every process."""
        with self._changed:
            self.is_closed = True
            self._changed.notify_all()
            for process in self._busy:
                process.kill()  # its thread closes it
            for process in filter(None, self._free):
                process.close()

    def take(self, cancelled: threading.Event) -> WorkerProcess:
        """Wait for a free process. Raises Aborted if cancelled first."""
        with self._changed:
            while not (self._free or cancelled.is_set() or self.is_closed):
                self._changed.wait()
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
        """Let those who wait look whether they are cancelled."""
        with self._changed:
            self._changed.notify_all()

    def _start(self) -> WorkerProcess:
        return WorkerProcess(
            "worker", niceness=BACKGROUND_NICENESS, prepare=self._prepare
        )


class Computing(Protocol):
    """What is under way in worker processes: one task, or many."""

    def result(self) -> Any:
        """Wait for what comes of it. Raises Aborted once it is cancelled."""

    def cancel(self) -> None:
        """End it now. Idempotent, any thread."""


@dataclass(eq=False, slots=True)
class Computation:
    """A task under way, driven by the thread of `result`."""

    executor: ProcessExecutor
    call: Callable[..., Any]
    on_progress: Progress
    started: Callable[[], object]
    _cancelled: threading.Event = field(default_factory=threading.Event, init=False)
    _process: WorkerProcess | None = field(default=None, init=False)

    def result(self) -> Any:
        """Wait for the value; raises TaskFailed, Aborted, or WorkerDied."""
        process = self._process = self.executor.take(self._cancelled)
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
        """End it now, whatever it does. Idempotent, any thread."""
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


@dataclass(frozen=True, slots=True)
class Answer:
    """From the process: the value of the call, or what it has raised."""

    value: Any = None
    error: Exception | None = None


class WorkerProcess:
    """One process. `call` belongs to one thread at a time, `kill` to any.

    prepare : function of a module, called first
    """

    def __init__(
        self, name: str, *, niceness: int = 0, prepare: Callable[[], None] | None = None
    ) -> None:
        self._process = ChildProcess(name, _compute, prepare, niceness=niceness)
        self._process.start()
        self._is_busy = self._is_ready = False

    def call(
        self, function: Callable[..., Any], on_progress: Progress | None = None
    ) -> Any:
        """Return the value of a function, or raise what it raises, or WorkerDied.

        on_progress : passed to the function if given; what it raises is logged
        """
        self._is_busy = True
        try:
            answer = self._wait_for_answer(function, on_progress)
        except BaseException:
            self.kill()
            raise
        finally:
            self._is_busy = False
        if answer.error is not None:
            raise answer.error
        return answer.value

    def kill(self) -> None:
        """End the process, whatever it does. Idempotent, any thread."""
        self._process.kill()

    def close(self) -> None:
        """End the process for good: in order where it is idle."""
        is_idle = not self._is_busy and (self._is_ready or self._process.link.poll())
        if is_idle and self._process.alive:
            self._process.link.close()
            self._process.join(_END_S)
        self._process.close()

    def _wait_for_answer(
        self, function: Callable[..., Any], on_progress: Progress | None
    ) -> Answer:
        call = function, on_progress is not None
        self._exchange(lambda: self._process.link.send(call))
        while True:
            message = self._exchange(self._process.link.recv)
            self._is_ready = True
            match message:
                case (share, stage) if on_progress is not None:  # how far it is
                    try:
                        on_progress(share, stage)
                    except Exception as error:
                        log.warning("progress cannot be reported", error=repr(error))
                case Answer():
                    return message

    def _exchange(self, step: Callable[[], Any]) -> Any:
        try:
            return step()
        except (EOFError, OSError) as error:
            raise WorkerDied(
                "a computing process ended without an answer: killed, or out of "
                "memory; run it again, or with fewer workers"
            ) from error


def _compute(prepare: Callable[[], None] | None, link: Connection) -> None:
    """Body of the process: call what comes until nobody is there to ask."""
    if prepare is not None:
        try:
            prepare()
        except Exception:
            log.exception("the worker process is not prepared; tasks run all the same")
    with suppress(EOFError, OSError):
        link.send(None)  # it is prepared
        while True:
            answer = _answer(link)
            try:
                link.send(answer)
            except (TypeError, AttributeError, ValueError) as error:
                unsent = TypeError(f"the value cannot be sent: {error}")
                link.send(Answer(error=unsent))


def _answer(link: Connection) -> Answer:
    try:
        function, reports_progress = link.recv()
    except (EOFError, OSError):
        raise
    except Exception as error:  # what was sent cannot be imported here
        return Answer(error=error)
    if reports_progress:
        function = partial(function, on_progress=lambda *done: link.send(done))
    try:
        return Answer(function())
    except Exception as error:
        return Answer(error=error)
