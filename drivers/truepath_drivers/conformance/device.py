"""Requirements on every device: construction, connection, identity, closing."""

from __future__ import annotations

from collections.abc import Callable

from truepath_drivers.conformance.checking import (
    NotConforming,
    holdings,
    require,
    soon,
    wait_until,
)
from truepath_drivers.interfaces.device import Device
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import Identity

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
