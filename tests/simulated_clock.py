"""A clock on which time passes when every thread of this process waits for it.

Ten seconds of patience cost a moment, and however busy the computer is nothing comes
late: time stands while anybody works. It takes the place of the functions of
`truepath_drivers.host_clock`; threads that were there before it are left out.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truepath_drivers import host_clock

_LOOK_S = 0.002  # real: for threads that end, or are blocked elsewhere
_STUCK_S = 0.03  # real: of a thread that sleeps elsewhere than here
_EPOCH_S = 1_780_000_000.0
_TASKS = Path("/proc/self/task")


@dataclass(eq=False)
class _Wait:
    is_over: Callable[[], bool]
    until_s: float
    gate: Any  # a lock, let go of at the end


class SimulatedClock:
    """The functions of `host_clock`, on simulated time."""

    def __init__(self) -> None:
        self.time_s = 1000.0
        self.wall_jump_s = 0.0
        self._waits: dict[int, _Wait] = {}
        self._lock = threading.Lock()
        self._before = set(threading.enumerate()) - {threading.current_thread()}
        self._is_over = False
        self._still: tuple[Any, float] = (None, 0.0)
        self._ticker = threading.Thread(target=self._run, name="clock", daemon=True)
        self._ticker.start()

    def now_s(self) -> float:
        return self.time_s

    def wall_s(self) -> float:
        return _EPOCH_S + self.time_s + self.wall_jump_s

    def sleep_s(self, duration_s: float) -> None:
        self._wait(lambda: False, duration_s)

    def wait(self, event: threading.Event, timeout_s: float | None = None) -> bool:
        return self._wait(event.is_set, timeout_s)

    def wait_for(
        self,
        condition: threading.Condition,
        is_so: Callable[[], bool],
        timeout_s: float | None = None,
    ) -> bool:
        until_s = self._end_s(timeout_s)
        while not is_so() and self.time_s < until_s:
            condition.release()
            try:
                self._wait(is_so, until_s - self.time_s)
            finally:
                condition.acquire()
        return is_so()

    def get(self, source: queue.Queue[Any], timeout_s: float | None = None) -> Any:
        until_s = self._end_s(timeout_s)
        while True:
            self._wait(lambda: not source.empty(), until_s - self.time_s)
            try:
                return source.get_nowait()
            except queue.Empty:
                if self.time_s >= until_s:
                    raise

    def join(self, thread: threading.Thread, timeout_s: float | None = None) -> None:
        end_s = self._end_s(timeout_s)
        while thread.is_alive() and self.time_s < end_s:
            if thread.ident in self._waits:
                self._wait(lambda: not thread.is_alive(), end_s - self.time_s)
            else:
                thread.join(_LOOK_S)  # it works

    def result(self, future: Any, timeout_s: float | None = None) -> Any:
        self._wait(future.done, timeout_s)
        return future.result(0.0)

    def close(self) -> None:
        """Let go of everybody who waits still."""
        self._is_over = True
        self._ticker.join()

    def _end_s(self, timeout_s: float | None) -> float:
        return float("inf") if timeout_s is None else self.time_s + timeout_s

    def _wait(self, is_over: Callable[[], bool], timeout_s: float | None) -> bool:
        if is_over():
            return True
        wait = _Wait(is_over, self._end_s(timeout_s), threading.Lock())
        wait.gate.acquire()
        with self._lock:
            self._waits[threading.get_ident()] = wait
        self._step()
        wait.gate.acquire()
        return is_over()

    def _run(self) -> None:
        while not self._is_over:
            time.sleep(_LOOK_S)
            self._step()
        self.time_s = float("inf")
        self._wake()

    def _step(self) -> None:
        """Wake who need not wait any more, and let time pass where nobody works."""
        if not self._wake() and self._is_still():
            self._advance()
            self._wake()

    def _wake(self) -> int:
        """Wake whose end has come; return how many those are."""
        with self._lock:
            over = [
                (ident, wait)
                for ident, wait in self._waits.items()
                if wait.until_s <= self.time_s or wait.is_over()
            ]
            for ident, wait in over:
                del self._waits[ident]
                wait.gate.release()
        return len(over)

    def _is_still(self) -> bool:
        """Whether nobody works: all wait here, or sleep for long elsewhere."""
        with self._lock:
            waiting = frozenset(self._waits)
        left_out = self._before | {self._ticker}
        others = [
            thread
            for thread in threading.enumerate()
            if thread not in left_out and thread.ident not in waiting
        ]
        if not others:
            return bool(waiting)
        seen = (waiting, frozenset(thread.ident for thread in others))
        if seen != self._still[0] or not all(map(_sleeps, others)):
            self._still = seen, time.monotonic()
        return bool(waiting) and time.monotonic() - self._still[1] > _STUCK_S

    def _advance(self) -> None:
        with self._lock:
            ends_s = [wait.until_s for wait in self._waits.values()]
        if ends_s and (until_s := min(ends_s)) < float("inf"):
            self.time_s = max(self.time_s, until_s)


def _sleeps(thread: threading.Thread) -> bool:
    try:
        stat = (_TASKS / str(thread.native_id) / "stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] == "S"


@contextmanager
def simulated_clock() -> Iterator[SimulatedClock]:
    """Put a simulated clock in the place of the computer's."""
    clock, before = SimulatedClock(), dict(vars(host_clock))
    names = ("now_s", "wall_s", "sleep_s", "wait", "wait_for", "get", "join", "result")
    try:
        for name in names:
            setattr(host_clock, name, getattr(clock, name))
        yield clock
    finally:
        clock.close()
        for name in names:
            setattr(host_clock, name, before[name])
