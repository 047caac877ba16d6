"""The clock and all waiting of this process.

A module and no argument: nothing that waits could be tested with half of its parts on
another clock. Tests replace these functions by a simulated clock, on which a wait of
ten seconds takes no time; so import the module, never its functions. A timeout of None
waits for ever.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def now_s() -> float:
    """Monotonic clock."""
    return time.monotonic()


def now_ns() -> int:
    """Monotonic clock."""
    return time.monotonic_ns()


def wall_s() -> float:
    """Unix time of this computer."""
    return time.time()


def wall_ns() -> int:
    """Unix time of this computer."""
    return time.time_ns()


def sleep_s(duration_s: float) -> None:
    """Suspend the thread."""
    time.sleep(duration_s)


def wait(event: threading.Event, timeout_s: float | None = None) -> bool:
    """Wait until the event is set; false after the timeout."""
    return event.wait(timeout_s)


def wait_for(
    condition: threading.Condition,
    is_so: Callable[[], bool],
    timeout_s: float | None = None,
) -> bool:
    """Wait, the condition held, until `is_so`; false after the timeout."""
    return condition.wait_for(is_so, timeout_s)


def get(
    source: queue.Queue[T] | queue.SimpleQueue[T], timeout_s: float | None = None
) -> T:
    """Next item of a queue. Raises queue.Empty after the timeout."""
    return source.get(timeout=timeout_s)


def put(target: queue.Queue[T], item: T, timeout_s: float | None = None) -> None:
    """Add to a queue. Raises queue.Full after the timeout."""
    target.put(item, timeout=timeout_s)


def join(thread: threading.Thread, timeout_s: float | None = None) -> None:
    """Wait for the end of a thread; the caller checks whether it has ended."""
    thread.join(timeout_s)


def result(future: Future[T], timeout_s: float | None = None) -> T:
    """Result of a call. Raises TimeoutError, or the error of the call."""
    return future.result(timeout_s)
