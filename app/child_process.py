"""Child processes: the one module that starts, limits, signals, logs and ends them.

Every child is spawned, never forked, and

- runs linear algebra on one thread where the user has set no other number;
- ignores Ctrl+C, which a terminal sends to every process: the parent decides;
- bears its name, `truepath-cell` say, where processes are listed;
- sends its log records to the log of its parent;
- does not outlive its parent.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path

from truepath.app.service_log import read_log_settings, receive_log, send_log
from truepath.app.thread_limits import choose_thread_limits

BACKGROUND_NICENESS = 10
"""Of processes that compute: the reader of the tracker's port goes first."""
_END_S, _LAST_S = 5.0, 3.0
_LONGEST_NAME = 15  # that Linux keeps
_SPAWN = get_context("spawn")
_ENVIRONMENT = threading.Lock()


class ChildProcess:
    """One child process, from `start` to `close`.

    name : of the process, in the log
    run : its body, a function of a module, called with what follows and then `link`
    niceness : how far its work stands behind that of other processes
    ends_with_parent : the process is ended where its parent is; else it notices by
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
        """Whether the process lives."""
        return not self._is_closed and self._process.is_alive()

    @property
    def process_id(self) -> int | None:
        """Identifier of the process, None before `start`."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """How the process has ended, None while it lives."""
        return self._process.exitcode

    def start(self) -> None:
        """Start the process."""
        with _child_environment():
            self._process.start()
        self._log.start()
        self._child_link.close()
        self._child_records.close()
        self._exit = Finalize(None, self._end_at_exit, exitpriority=10)

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the end of the process."""
        self._process.join(timeout_s)

    def terminate(self) -> None:
        """Ask the process to end: SIGTERM."""
        if self.alive:
            self._process.terminate()

    def kill(self) -> None:
        """End the process at once, whatever it does: SIGKILL. Idempotent."""
        if self.alive:
            self._process.kill()

    def _end_at_exit(self) -> None:
        """End it, however it resists: nobody would end it afterwards."""
        self.terminate()
        self._process.join(_LAST_S)
        self.kill()

    def close(self) -> None:
        """Release the process, ended by force where it still lives. Idempotent."""
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
    """Let a child that is spawned meanwhile use one thread and never receive Ctrl+C.

    Both hold from its first instruction: NumPy reads the variables at its import, and
    the mask of signals is inherited.
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
    """Body of every child."""
    niceness, ends_with_parent, records = setup
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _show_name(current_process().name)
    os.nice(niceness)
    if ends_with_parent:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    with send_log(records, log_settings):
        run(*arguments)


def _show_name(name: str) -> None:
    """Name this process in `ps` and `top`, where the system can."""
    with suppress(OSError):
        Path("/proc/self/comm").write_text(f"truepath-{name}"[:_LONGEST_NAME])


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
