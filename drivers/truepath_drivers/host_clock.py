"""The time of this computer: whoever measures a duration or waits asks it here.

It is the process's and no argument: nothing that waits could be tested with half of its
parts on another clock. Tests put a simulated one in the place of these functions, on
which ten seconds of patience cost none; so import the module, never its functions.
A timeout of None waits for ever.
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
    """Return monotonic seconds."""
    return time.monotonic()


def now_ns() -> int:
    """Return monotonic nanoseconds."""
    return time.monotonic_ns()


def wall_s() -> float:
    """Return seconds of the epoch, as this computer has them."""
    return time.time()


def wall_ns() -> int:
    """Return nanoseconds of the epoch, as this computer has them."""
    return time.time_ns()


def sleep_s(duration_s: float) -> None:
    """Let time pass."""
    time.sleep(duration_s)


def wait(event: threading.Event, timeout_s: float | None = None) -> bool:
    """Wait until the event is set; say whether it is."""
    return event.wait(timeout_s)


def wait_for(
    condition: threading.Condition,
    is_so: Callable[[], bool],
    timeout_s: float | None = None,
) -> bool:
    """Wait, the condition held, until something is so; say whether it is."""
    return condition.wait_for(is_so, timeout_s)


def get(
    source: queue.Queue[T] | queue.SimpleQueue[T], timeout_s: float | None = None
) -> T:
    """Take the next of a queue. Raises queue.Empty where there is none by then."""
    return source.get(timeout=timeout_s)


def put(target: queue.Queue[T], item: T, timeout_s: float | None = None) -> None:
    """Add to a queue. Raises queue.Full where there is no room by then."""
    target.put(item, timeout=timeout_s)


def join(thread: threading.Thread, timeout_s: float | None = None) -> None:
    """Wait for the end of a thread; whether it has ended is for the caller to ask."""
    thread.join(timeout_s)


def result(future: Future[T], timeout_s: float | None = None) -> T:
    """Wait for what a call gives. Raises TimeoutError, or what the call has raised."""
    return future.result(timeout_s)
