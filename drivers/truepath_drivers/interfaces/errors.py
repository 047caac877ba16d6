"""Families of device errors. A text gives event, cause and remedy."""

from __future__ import annotations


class DeviceError(Exception):
    """Any fault of a device or its link."""


class ConnectionLost(DeviceError):
    """The link is lost: cable, power, port in use, or no such port."""


class DeviceTimeout(DeviceError):
    """The device did not answer in its time."""


class DeviceBusy(DeviceTimeout):
    """The device reports that it has no time now."""


class WrongDevice(DeviceError):
    """Another device answers on the port."""


class Refused(DeviceError):
    """The device understood and rejected the request."""

    def __init__(self, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.code = code


class OutOfTravel(DeviceError):
    """A position beyond the travel of an axis, rejected before the first byte."""


class MotionFault(DeviceError):
    """The controller is in alarm, or its motion differs from the command."""


class BeamLost(DeviceError):
    """The tracker has lost its reflector."""


class NotHomed(Refused):
    """The instrument has to be homed before it does this."""


class NotOffered(Refused):
    """The device does not have this verb at all."""


class DriverFault(DeviceError):
    """The driver itself did not answer in time, failed, or gave an invalid answer."""
