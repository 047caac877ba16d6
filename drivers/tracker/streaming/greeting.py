"""Who answers at a port: a device that speaks GST/1, something else, or nothing."""

from __future__ import annotations

from truepath.drivers.interfaces.errors import (
    DeviceError,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath.drivers.tracker.streaming.command_link import CommandLink
from truepath.drivers.tracker.streaming.messages import VERSION, DeviceInfo, Hello
from truepath.drivers.tracker.streaming.receiver import Receiver


def greet(
    link: CommandLink, receiver: Receiver, port_name: str, serial_number: str
) -> DeviceInfo:
    """Return what the device says of itself.

    serial_number : that it must have; any if empty

    Raises WrongDevice if it is another one or none of this kind, DeviceTimeout or
    ConnectionLost if nothing answers.
    """
    try:
        info = link.ask(receiver, Hello).detail
    except DeviceTimeout as error:
        raise _explain_silence(receiver, port_name, error) from None
    except Refused as error:
        raise WrongDevice(f"{error}; the device speaks another version") from error
    if not isinstance(info, DeviceInfo) or info.version != VERSION:
        raise WrongDevice(
            f"{port_name}: the device does not speak GST/{VERSION} ({info}); "
            "update the device or the driver"
        )
    if serial_number not in ("", info.serial_number):
        raise WrongDevice(
            f"{port_name}: instrument {info.serial_number} answers, "
            f"{serial_number} is configured; check which cable is where"
        )
    return info


def _explain_silence(
    receiver: Receiver, port_name: str, error: DeviceTimeout
) -> DeviceError:
    """Tell silence from bytes that are not ours."""
    if receiver.echoes:
        return WrongDevice(
            f"{port_name}: our own bytes come back; a loop-back plug, "
            "or a terminal that echoes"
        )
    if receiver.bytes_received and not receiver.frames.frames:
        return WrongDevice(
            f"{port_name}: something answers, but not in GST/1 frames; "
            "check that this is the tracker's port, and its baud rate"
        )
    return error
