"""Families of device errors. A text says what happened, why, and what to do."""

from __future__ import annotations


class DeviceError(Exception):
    """Anything a device or its link did wrong."""


class ConnectionLost(DeviceError):
    """The link is gone: cable, power, port in use, or no such port."""


class DeviceTimeout(DeviceError):
    """The device did not answer in its time."""


class DeviceBusy(DeviceTimeout):
    """The device answers that it has no time now."""


class WrongDevice(DeviceError):
    """Something else answers on the port."""


class Refused(DeviceError):
    """The device understood and said no."""

    def __init__(self, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.code = code


class OutOfTravel(DeviceError):
    """A position beyond the travel of an axis, refused before the first byte."""


class MotionFault(DeviceError):
    """The controller is in alarm, or did not do what it was told."""


class BeamLost(DeviceError):
    """The tracker has lost its reflector."""


class NotHomed(Refused):
    """The instrument has to be homed before it does this."""


class NotOffered(Refused):
    """The device does not have this verb at all."""


class DriverFault(DeviceError):
    """The driver itself did not answer in time, failed, or answered nonsense."""
