"""A clock on which time passes when every thread of this process waits for it.

Ten seconds of patience cost a moment, and time stands while anybody works. It takes the
place of the functions of `truepath_drivers.host_clock`; threads that were there before
it are left out. A thread that sleeps elsewhere (a lock, a socket) holds time for a
thirtieth of a second. What is waited for is asked of any thread, under the lock of the
clock: such a question takes no lock itself.
"""

import queue
import re
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from truepath_drivers import host_clock

_LOOK_S = 0.002  # real: for threads that end, or are blocked elsewhere
_ASLEEP_S = 0.03  # real: without having run once
_TASKS = Path("/proc/self/task")
_SWITCHES = re.compile(r"ctxt_switches:\t(\d+)")
_NAMES = ("now_s", "now_ns", "wall_s", "wall_ns", "sleep_s")
_NAMES += ("wait", "wait_for", "get", "put", "join", "result")


@dataclass(eq=False)
class _Wait:
    is_over: Callable[[], bool]
    until_s: float
    gate: threading.Lock = field(default_factory=threading.Lock)
    error: Exception | None = None


class SimulatedClock:
    """The functions of `host_clock`, on simulated time.

    time_s : a test may set it forward, as after a suspension of the computer
    wall_jump_s : by which the wall clock was set
    """

    def __init__(self):
        self.time_s = 1000.0
        self.wall_jump_s = 0.0
        self._lock = threading.RLock()
        self._waits = {}
        self._runs = {}
        self._before = set(threading.enumerate()) - {threading.current_thread()}
        self._is_closed = False
        self._ticker = threading.Thread(target=self._run, name="clock", daemon=True)
        self._ticker.start()

    def now_s(self):
        return self.time_s

    def now_ns(self):
        return round(self.time_s * 1e9)

    def wall_s(self):
        return 1_780_000_000.0 + self.time_s + self.wall_jump_s

    def wall_ns(self):
        return round(self.wall_s() * 1e9)

    def sleep_s(self, duration_s):
        self._wait(lambda: False, self.time_s + duration_s)

    def wait(self, event, timeout_s=None):
        return self._wait(event.is_set, self._end_s(timeout_s))

    def wait_for(self, condition, is_so, timeout_s=None):
        until_s = self._end_s(timeout_s)
        while not is_so() and self.time_s < until_s and not self._is_closed:
            condition.release()
            try:
                self._wait(is_so, until_s)
            finally:
                condition.acquire()
        return is_so()

    def get(self, source, timeout_s=None):
        return self._retry(lambda: not source.empty(), source.get_nowait, timeout_s)

    def put(self, target, item, timeout_s=None):
        put = partial(target.put_nowait, item)
        return self._retry(lambda: not target.full(), put, timeout_s)

    def _retry(self, is_possible, act, timeout_s):
        until_s = self._end_s(timeout_s)
        while True:
            self._wait(is_possible, until_s)
            try:
                return act()
            except (queue.Empty, queue.Full):
                if self.time_s >= until_s or self._is_closed:
                    raise

    def join(self, thread, timeout_s=None):
        until_s = self._end_s(timeout_s)
        if thread.ident not in self._waits:  # most calls are over at once
            thread.join(_LOOK_S)
        self._wait(lambda: not thread.is_alive(), until_s)

    def result(self, future, timeout_s=None):
        self._wait(future.done, self._end_s(timeout_s))
        return future.result(0.0)

    def close(self):
        """Let go of everybody who waits still."""
        with self._lock:
            self._is_closed = True
            self._wake()
        self._ticker.join()

    def _end_s(self, timeout_s):
        return float("inf") if timeout_s is None else self.time_s + timeout_s

    def _wait(self, is_over, until_s):
        wait = _Wait(is_over, until_s)
        with self._lock:
            if is_over() or self._is_closed:
                return is_over()
            wait.gate.acquire()
            self._waits[threading.get_ident()] = wait
            self._step()
        wait.gate.acquire()
        if wait.error is not None:
            raise wait.error
        return is_over()

    def _run(self):
        while not self._is_closed:
            time.sleep(_LOOK_S)
            with self._lock:
                self._step()

    def _step(self):
        """Wake who need not wait any more, and let time pass where nobody works."""
        if self._wake() or not self._waits or not self._is_still():
            return
        until_s = min(wait.until_s for wait in self._waits.values())
        if until_s < float("inf"):
            self.time_s = max(self.time_s, until_s)
            self._wake()

    def _wake(self):
        """Wake whose end has come; return how many those are."""
        over = [ident for ident, wait in self._waits.items() if self._ends(wait)]
        for ident in over:
            self._waits.pop(ident).gate.release()
        return len(over)

    def _ends(self, wait):
        if self._is_closed or wait.until_s <= self.time_s:
            return True
        try:
            return wait.is_over()
        except Exception as error:
            wait.error = error
            return True

    def _is_still(self):
        """Whether nobody works: all wait here, or sleep for long elsewhere."""
        left_out = self._before | {self._ticker}
        return all(
            thread in left_out or thread.ident in self._waits or self._sleeps(thread)
            for thread in threading.enumerate()
        )

    def _sleeps(self, thread):
        """Whether a thread was not on a processor for a while.

        One that waits for the interpreter or for a processor is, again and again.
        """
        if thread.ident is None or thread.ident == threading.get_ident():
            return False
        try:
            status = (_TASKS / str(thread.native_id) / "status").read_text()
        except OSError:
            return False
        runs, now_s = _SWITCHES.findall(status), time.monotonic()
        if "State:\tS" not in status:
            runs = []
        seen, since_s = self._runs.get(thread.ident, ([], now_s))
        if runs != seen or not runs:
            self._runs[thread.ident] = runs, now_s
            return False
        return now_s - since_s > _ASLEEP_S


@contextmanager
def simulated_clock():
    clock, before = SimulatedClock(), dict(vars(host_clock))
    try:
        for name in _NAMES:
            setattr(host_clock, name, getattr(clock, name))
        yield clock
    finally:
        for name in _NAMES:
            setattr(host_clock, name, before[name])
        clock.close()
