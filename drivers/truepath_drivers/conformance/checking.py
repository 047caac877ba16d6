"""Parts of checks, and requirements on every device: connection, identity, closing."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from truepath_drivers import host_clock
from truepath_drivers.interfaces.device import Device
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import Identity


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


_DEFAULT_TERMS = Terms()
TERMS: ContextVar[Terms] = ContextVar("TERMS", default=_DEFAULT_TERMS)


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


def expect(
    family: type[DeviceError], verb: Callable[[], object], doing: str = ""
) -> None:
    """Require that a verb raises an error of a family. doing : the verb in words"""
    wanted = f"{doing or verb.__name__}: expected {family.__name__}, found"
    try:
        verb()
    except family:
        return
    except DeviceError as error:
        raise NotConforming(f"{wanted} {error!r}") from error
    raise NotConforming(f"{wanted} no error")


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
        for number in os.listdir("/proc/self/fd"):
            if os.path.exists(f"/dev/fd/{number}"):  # not that of the listing itself
                holdings.add(f"file {number}")
    return holdings


MakeDevice = Callable[[], Device]
FURTHER = 5


def construction_opens_nothing(make: MakeDevice) -> None:
    """A driver that is only constructed holds no file, no socket and no thread."""
    before = holdings()
    device = make()
    require(holdings() <= before, "the constructor opened something")
    device.close()


def connect_tells_who_answers(make: MakeDevice) -> None:
    """`connect` returns an Identity with a model; the serial number may be empty."""
    with make() as device:
        identity = device.connect()
    require(isinstance(identity, Identity), f"connect returned {identity!r}")
    require(bool(identity.model), "the identity has no model")


def connect_twice_is_one_connection(make: MakeDevice) -> None:
    """Further calls of `connect` return the same identity and open nothing."""
    with make() as device:
        identity = device.connect()
        before = holdings()
        same = [device.connect() == identity for _ in range(FURTHER)]
        require(all(same), "the identity changed")
        # A peer in this process may only now open its end of the one connection.
        opened = len(holdings() - before)
        require(opened < FURTHER, "a second connect opened something")


def close_is_idempotent_and_leaves_nothing(make: MakeDevice) -> None:
    """`close` may come before `connect`, twice, and releases everything."""
    before = holdings()
    device = make()
    device.close()
    device.connect()
    device.close()
    device.close()
    wait_until(lambda: holdings() <= before, "close left a file or a thread behind")


def a_closed_device_connects_again(make: MakeDevice) -> None:
    """`connect` works again after `close`."""
    device = make()
    identities = []
    for _ in range(2):
        identities.append(device.connect())
        device.close()
    require(identities[0] == identities[1], "the identity changed")


def a_device_that_is_not_there_is_a_device_error(make_absent: MakeDevice) -> None:
    """`connect` to nothing ends soon, in a DeviceError with a text.

    make_absent : makes a driver for a port where nothing answers
    """
    device = make_absent()
    with soon("connect to an absent device", 3.0):
        try:
            device.connect()
        except DeviceError as error:
            require(bool(str(error)), "the error has no text")
        else:
            raise NotConforming("connect found a device that is not there")
    device.close()


DEVICE_CHECKS: tuple[Callable[[MakeDevice], None], ...] = (
    construction_opens_nothing,
    connect_tells_who_answers,
    connect_twice_is_one_connection,
    close_is_idempotent_and_leaves_nothing,
    a_closed_device_connects_again,
)
