"""Thermometers, barometer and hygrometer: a group of named channels, read in turn.

A driver only reads: readings that are out of range or constant are detected by the
caller, in the same way for every driver.
"""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from truepath_drivers.interfaces.device import Device

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*_degC|pressure_hPa|humidity_percent")
_PLAUSIBLE: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "air_degC": (-10.0, 50.0),
        "degC": (-30.0, 90.0),
        "hPa": (600.0, 1100.0),
        "percent": (0.0, 100.0),
    }
)
_TINY = 1e-6  # no sensor resolves it; words in the wrong order look like this
STUCK_S = 900.0


@dataclass(frozen=True, slots=True)
class Channel:
    """One sensor of a group.

    name : a column of `environment.csv`: `<NAME>_degC`, `pressure_hPa` or
        `humidity_percent`; `X_degC` is the sensor of the scale of the axis X
    low, high : limits of a plausible reading; defaults by the unit
    stuck_s : a sensor whose reading is constant for so long is stuck; 0 where a coarse
        one may be constant
    """

    name: str
    low: float = math.nan
    high: float = math.nan
    stuck_s: float = STUCK_S

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(
                f"channel {self.name!r}: expected a name such as X_degC, air_degC, "
                "pressure_hPa or humidity_percent"
            )
        low, high = self.plausible
        if not low < high:
            raise ValueError(f"channel {self.name}: {low:g} is not below {high:g}")
        if not 0.0 <= self.stuck_s < math.inf:
            raise ValueError(f"channel {self.name}: stuck_s is {self.stuck_s:g}")

    @property
    def unit(self) -> str:
        """`degC`, `hPa` or `percent`."""
        return self.name.rpartition("_")[2]

    @property
    def plausible(self) -> tuple[float, float]:
        """Lowest and highest plausible reading."""
        low, high = _PLAUSIBLE.get(self.name, _PLAUSIBLE[self.unit])
        return (
            low if math.isnan(self.low) else self.low,
            high if math.isnan(self.high) else self.high,
        )

    def find_fault(self, value: float) -> str:
        """Why a single number is no valid reading; empty where it may be one."""
        low, high = self.plausible
        if 0.0 < abs(value) < _TINY:
            return (
                f"{value:g} {self.unit} is nearly 0, as of words in the wrong order or "
                "another register"
            )
        if low <= value <= high:
            return ""
        return f"{value:g} {self.unit} is not within {low:g} to {high:g}"


@dataclass(frozen=True, slots=True)
class Reading:
    """One reading of a channel.

    host_time_s : monotonic clock of this host, in the middle of the request
    value : in the unit of the channel; NaN where there is none
    fault : reason of a missing value; else empty
    """

    channel: str
    host_time_s: float
    value: float
    fault: str = ""


@dataclass(frozen=True, slots=True)
class ReadingTry:
    """What a channel shows when it is read in one of several ways.

    how : the way, as settings say it; value : None where it gives no number
    is_set : the way of the settings; is_likely : the one that seems right
    """

    channel: str
    how: str
    value: float | None
    is_set: bool
    is_likely: bool


class Thermometers(Device):
    """A group of channels behind one link. For one thread; `close` for any.

    tries : readings of `connect`, even Refused, by all the ways that it tried
    """

    interface_version: ClassVar[int] = 1
    tries: tuple[ReadingTry, ...] = ()

    @property
    @abstractmethod
    def channels(self) -> tuple[Channel, ...]:
        """The channels, each name once. Known before `connect`."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Shortest time between two readings of a channel, for the caller of `read`."""

    @abstractmethod
    def read(self) -> tuple[Reading, ...]:
        """Read the channels that are due, each once, in a bounded time.

        A channel that does not answer is included with its fault: one dead sensor does
        not affect the others. After a lost link the next call reopens it. Raises
        ConnectionLost only before `connect` and after `close`.
        """
