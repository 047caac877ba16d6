"""Laser trackers that stream positions of one reflector, or measure point by point.

A driver derives from `Tracker` or `PolledTracker`, and from those of the small classes
below that its instrument can do as well. Who uses one asks with `isinstance`.
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
        """What it can do, known after `connect`."""
        return TrackerCapabilities()

    @abstractmethod
    def start(self, rate_hz: float) -> None:
        """Begin to stream. Idempotent at the same rate.

        Raises Refused if the device cannot do that rate, NotHomed if it has to be homed
        first, DeviceTimeout if it is silent.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> TrackerSamples:
        """Return all since the last call, waiting at most `timeout_s` for a first one.

        An empty block means silence. Never holds a sample whose check did not match.
        Raises ConnectionLost if the link has gone.
        """

    @abstractmethod
    def stop(self) -> None:
        """End the stream. Idempotent, any thread, any state."""

    @property
    @abstractmethod
    def health(self) -> LinkHealth:
        """Counts since `connect`."""


class PolledTracker(Device):
    """Measures a target that stands still, each time it is asked to."""

    interface_version: ClassVar[int] = 1

    @property
    @abstractmethod
    def capabilities(self) -> TrackerCapabilities:
        """What it can do, known after `connect`; `streams` is false."""

    @abstractmethod
    def measure(self, dwell_s: float) -> PointMeasurement:
        """Measure for so long, one shot at the least; return the mean.

        A shot that began before the call never counts. Raises BeamLost if there is no
        target, Refused for a dwell that is no time or after `stop`, DeviceTimeout,
        ConnectionLost. After an error the next call begins anew.
        """

    @abstractmethod
    def stop(self) -> None:
        """End a measurement under way. Idempotent, any thread, any state."""


class ByteLink(ABC):
    """Beside its verbs, a device hands out what it received, before any decoding.

    A Run keeps these bytes as a second stream, so that it can be decoded again when a
    codec is corrected. A driver opts in by deriving from this as well.
    """

    @abstractmethod
    def take_link_bytes(self) -> bytes:
        """Return the bytes received since the last call, in order.

        Called at least every second while a stream runs, and after each point. A
        driver keeps a bounded number of bytes for it and drops the oldest.
        """


class EventSource(ABC):
    """Tells what happens at the instrument: a beam that is lost, a warning."""

    @abstractmethod
    def take_events(self) -> tuple[TrackerEvent, ...]:
        """Return the events since the last call, in order. Any thread."""


class TurningTracker:
    """Turns by itself, which takes a while."""

    @property
    def verb_limit_s(self) -> float:
        """The longest that one of the verbs may take, by how the driver is set up.

        The driver gives up by then, with an error that says why.
        """
        return 30.0


class TargetFinder(TurningTracker, ABC):
    """Points its beam and finds a target by itself."""

    @abstractmethod
    def home(self) -> None:
        """Go to the instrument's own reference or home, and initialise there."""

    @abstractmethod
    def aim(self, azimuth_rad: float, elevation_rad: float) -> None:
        """Point the beam in the tracker's frame. Raises Refused."""

    @abstractmethod
    def search(self) -> None:
        """Find and lock on a target near the beam. Raises BeamLost if there is none."""


class TargetChoice(TurningTracker, ABC):
    """Knows several targets by their names, and which of them it measures."""

    @abstractmethod
    def select_target(self, name: str) -> None:
        """Measure this one from now on.

        Raises Refused if it is not known, NotOffered if this device cannot choose,
        NotHomed if it has to be homed first, BeamLost if it is not seen.
        """


class AirExchange(ABC):
    """Takes the air for its own refraction, and tells which it uses."""

    @abstractmethod
    def push_air(self, air: Air) -> None:
        """Hand over the air; raises Refused if it is not what comes back."""

    @abstractmethod
    def read_air(self) -> Air:
        """Return the air that is in use."""


AnyTracker = Tracker | PolledTracker
