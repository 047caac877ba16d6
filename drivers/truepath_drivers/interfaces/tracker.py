"""Laser trackers that stream positions of one reflector, or measure point by point.

A driver derives from `Tracker` or `PolledTracker`, and from those of the small classes
below that its instrument supports. Callers test with `isinstance`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from truepath_drivers.interfaces.device import Device
from truepath_drivers.interfaces.records import LinkHealth, TrackerSamples
from truepath_drivers.interfaces.tracker_records import (
    Air,
    PointMeasurement,
    TrackerCapabilities,
    TrackerEvent,
)


class Tracker(Device):
    """Streams samples stamped by its own counter and clock."""

    interface_version: ClassVar[int] = 1

    @property
    def capabilities(self) -> TrackerCapabilities:
        """Known after `connect`."""
        return TrackerCapabilities()

    @abstractmethod
    def start(self, rate_hz: float) -> None:
        """Begin to stream. Idempotent at the same rate.

        Raises Refused if the device cannot do that rate, NotHomed if it has to be homed
        first, DeviceTimeout if it is silent.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> TrackerSamples:
        """All samples since the last call; a first one within `timeout_s`.

        An empty block means silence. Never holds a sample whose checksum did not match.
        Raises ConnectionLost if the link is lost.
        """

    @abstractmethod
    def stop(self) -> None:
        """End the stream. Idempotent, any thread, any state."""

    @property
    def health(self) -> LinkHealth:
        """Damage since `connect`: none where the link shows a driver none."""
        return LinkHealth()


class PolledTracker(Device):
    """Measures a target at rest, once per request."""

    interface_version: ClassVar[int] = 1

    @property
    @abstractmethod
    def capabilities(self) -> TrackerCapabilities:
        """Known after `connect`; `streams` is false."""

    @abstractmethod
    def measure(self, dwell_s: float) -> PointMeasurement:
        """Mean of the shots in this time, at least one.

        A shot that began before the call never counts. Raises BeamLost if there is no
        target, Refused for an invalid dwell or after `stop`, DeviceTimeout,
        ConnectionLost. After an error the next call starts over.
        """

    @abstractmethod
    def stop(self) -> None:
        """End an active measurement. Idempotent, any thread, any state."""


class ByteLink(ABC):
    """Access to the received bytes of a device, before any decoding.

    A Run keeps these bytes as a second stream, so that it can be decoded again when a
    codec is corrected. A driver opts in by deriving from this as well.
    """

    @abstractmethod
    def take_link_bytes(self) -> bytes:
        """Bytes received since the last call, in order.

        Called at least every second while a stream runs, and after each point. A driver
        keeps a bounded number of bytes for it and drops the oldest.
        """


class EventSource(ABC):
    """Reports events of the device: a lost beam, a warning, a row at no one feed."""

    @abstractmethod
    def take_events(self) -> tuple[TrackerEvent, ...]:
        """Events since the last call, in order. Any thread."""


class TurningTracker:
    """Motorised: its verbs take a while."""

    @property
    def verb_limit_s(self) -> float:
        """Longest time of one of the verbs, by the options of the driver.

        The driver raises by then, with an error that gives the reason.
        """
        return 30.0


class TargetFinder(TurningTracker, ABC):
    """Points its beam and finds a target automatically."""

    @abstractmethod
    def home(self) -> None:
        """Move to the instrument's own reference or home, and initialise there."""

    @abstractmethod
    def aim(self, azimuth_rad: float, elevation_rad: float) -> None:
        """Point the beam in the tracker's frame. Raises Refused."""

    @abstractmethod
    def search(self) -> None:
        """Find and lock on a target near the beam. Raises BeamLost if there is none."""


class TargetChoice(TurningTracker, ABC):
    """Measures one of several targets, chosen by name."""

    @abstractmethod
    def select_target(self, name: str) -> None:
        """Measure this target from now on.

        Raises Refused if it is not known, NotOffered if this device cannot choose,
        NotHomed if it has to be homed first, BeamLost if it is not seen.
        """


class AirExchange(ABC):
    """Accepts the air for its own refraction, and reports the air in use."""

    @abstractmethod
    def push_air(self, air: Air) -> None:
        """Set the air; raises Refused if the readback differs."""

    @abstractmethod
    def read_air(self) -> Air:
        """The air that is in use."""


AnyTracker = Tracker | PolledTracker
