"""Child processes: the one module that starts, limits, signals, logs and ends them.

Every child is spawned, never forked, and
- runs linear algebra on one thread unless the user has set another number;
- ignores Ctrl+C, which a terminal sends to every process: the parent decides;
- has its own name, such as `truepath-cell`, in lists of processes;
- sends its log records to the log of its parent;
- does not outlive its parent.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import structlog

from truepath.errors import WorkerDied
from truepath.progress import Progress
from truepath.service_log import read_log_settings, receive_log, send_log
from truepath.thread_limits import choose_thread_limits

log = structlog.get_logger(__name__)

BACKGROUND_NICENESS = 10
"""Of processes that compute: the reader of the tracker's port has priority."""
_END_S, _LAST_S = 5.0, 3.0
_LONGEST_NAME = 15  # that Linux keeps
_SPAWN = get_context("spawn")
_ENVIRONMENT = threading.Lock()


class ChildProcess:
    """One child process, from `start` to `close`.

    name : of the process, in the log
    run : its body, a function of a module, called with the further arguments and then
        `link`
    niceness : added to that of the parent
    ends_with_parent : the process is killed with its parent; else it detects the end
        itself
    link : the parent's end of the pipe whose other end the child has
    """

    def __init__(
        self,
        name: str,
        run: Callable[..., None],
        *arguments: object,
        niceness: int = 0,
        ends_with_parent: bool = True,
    ) -> None:
        self.link, self._child_link = _SPAWN.Pipe()
        self._records, self._child_records = _SPAWN.Pipe(duplex=False)
        setup = (niceness, ends_with_parent, self._child_records)
        self._process: BaseProcess = _SPAWN.Process(
            target=_run_child,
            args=(setup, read_log_settings(), run, (*arguments, self._child_link)),
            name=name,
        )
        self._log = threading.Thread(
            target=receive_log,
            args=(self._records,),
            name=f"log-of-{name}",
            daemon=True,
        )
        self._is_closed = False

    @property
    def alive(self) -> bool:
        """Whether the process is alive."""
        return not self._is_closed and self._process.is_alive()

    @property
    def process_id(self) -> int | None:
        """None before `start`."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it is alive; negative for a signal."""
        return self._process.exitcode

    def start(self) -> None:
        """Start process and log thread."""
        with _child_environment():
            self._process.start()
        self._log.start()
        self._child_link.close()
        self._child_records.close()
        self._exit = Finalize(None, self._end_at_exit, exitpriority=10)

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the process, at most `timeout_s`."""
        self._process.join(timeout_s)

    def terminate(self) -> None:
        """Request the end of the process: SIGTERM."""
        if self.alive:
            self._process.terminate()

    def kill(self) -> None:
        """End the process at once: SIGKILL. Idempotent."""
        if self.alive:
            self._process.kill()

    def _end_at_exit(self) -> None:
        """By force: nothing would end the process afterwards."""
        self.terminate()
        self._process.join(_LAST_S)
        self.kill()

    def close(self) -> None:
        """Release the process, ended by force if it is still alive. Idempotent."""
        if self._is_closed:
            return
        if self.process_id is not None:
            self.kill()
            self._process.join(_END_S)
            self._log.join(_END_S)
            self._exit.cancel()
        else:
            self._records.close()
        self._is_closed = True
        for end in (self.link, self._child_link, self._child_records):
            end.close()


@contextmanager
def _child_environment() -> Iterator[None]:
    """Children spawned in the block use one thread and never receive Ctrl+C. Both hold
    from the first instruction: NumPy reads the variables at its import, and the mask of
    signals is inherited.
    """
    before_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    with _ENVIRONMENT:
        added = choose_thread_limits()
        os.environ.update(added)
        try:
            yield
        finally:
            for name in added:
                del os.environ[name]
            signal.pthread_sigmask(signal.SIG_SETMASK, before_mask)


def _run_child(
    setup: tuple[int, bool, Connection],
    log_settings: tuple[int, bool],
    run: Callable[..., None],
    arguments: tuple[object, ...],
) -> None:
    niceness, ends_with_parent, records = setup
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _show_name(current_process().name)
    os.nice(niceness)
    if ends_with_parent:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    with send_log(records, log_settings):
        run(*arguments)


def _show_name(name: str) -> None:
    with suppress(OSError):
        Path("/proc/self/comm").write_text(f"truepath-{name}"[:_LONGEST_NAME])


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@dataclass(frozen=True, slots=True)
class Answer:
    """Sent by the process: the value of the call, or its error."""

    value: Any = None
    error: Exception | None = None


class WorkerProcess:
    """A child process that computes one call after another.

    `call` belongs to one thread at a time, `kill` to any.

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
        """Value of a function; raises its error, or WorkerDied.

        on_progress : passed to the function if given; an error of it is logged
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
        """End the process. Idempotent, any thread."""
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
