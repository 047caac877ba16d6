"""Parts of checks: requirements, time limits, resources of a process."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError


@dataclass(frozen=True, slots=True)
class Terms:
    """Parameters and time limits of the checks.

    rate_hz : of streams
    patience_s : tolerance beyond a requested timeout, for the scheduler of a busy
        computer
    motion_s : longest motion of a few mm
    watchdog_s : limit within which a watchdog without beats holds the feed
    """

    rate_hz: float = 500.0
    patience_s: float = 1.0
    motion_s: float = 30.0
    watchdog_s: float = 5.0


_USUAL = Terms()
TERMS: ContextVar[Terms] = ContextVar("TERMS", default=_USUAL)


@contextmanager
def on_terms(**terms: float) -> Iterator[None]:
    """Run checks with other terms: `with on_terms(rate_hz=100.0): check(make)`."""
    token = TERMS.set(Terms(**terms))
    try:
        yield
    finally:
        TERMS.reset(token)


class NotConforming(AssertionError):
    """A driver violates a requirement of `truepath_drivers.interfaces`."""


def require(kept: bool, otherwise: str) -> None:
    """Raise NotConforming with the text `otherwise` unless `kept`."""
    if not kept:
        raise NotConforming(otherwise)


def expect(family: type[DeviceError], verb: Callable[[], object]) -> None:
    """Require that a verb raises an error of a family."""
    try:
        verb()
    except family:
        return
    except DeviceError as error:
        raise NotConforming(f"{error!r} came in place of {family.__name__}") from error
    raise NotConforming(f"{family.__name__} did not come")


@contextmanager
def soon(doing: str, limit_s: float) -> Iterator[None]:
    """Require that the block ends within `limit_s` and the tolerance."""
    begin_s = host_clock.now_s()
    yield
    took_s = host_clock.now_s() - begin_s
    require(took_s <= limit_s + TERMS.get().patience_s, f"{doing} took {took_s:.2f} s")


@contextmanager
def running(verb: Callable[[], None]) -> Iterator[None]:
    """Run a verb in another thread during the block."""
    thread = threading.Thread(target=verb)
    thread.start()
    yield
    thread.join()


def wait_until(condition: Callable[[], bool], otherwise: str) -> None:
    """Wait for a condition, at most `patience_s`."""
    deadline_s = host_clock.now_s() + TERMS.get().patience_s
    while not condition():
        require(host_clock.now_s() < deadline_s, otherwise)
        host_clock.sleep_s(0.01)


def holdings() -> set[str]:
    """Threads and open files of this process, by name and number."""
    holdings = {f"thread {thread.ident}" for thread in threading.enumerate()}
    if os.path.isdir("/proc/self/fd"):
        holdings |= {f"file {number}" for number in _open_files()}
    return holdings


def _open_files() -> list[str]:
    """Excludes the descriptor of the listing itself."""
    return [n for n in os.listdir("/proc/self/fd") if os.path.exists(f"/dev/fd/{n}")]
