"""Records of trackers besides samples: capabilities, points, air, events."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


class Clock(StrEnum):
    """Clock that stamps the measurements of a tracker."""

    DEVICE = "device"
    HOST = "host"  # as good as the scheduler: for points at standstill


@dataclass(frozen=True, slots=True)
class Light:
    """Light of a tracker that does not correct for the air.

    wavelength_nm : in vacuum
    is_group : modulated light (ADM, EDM); else fringes are counted (IFM)
    assumed_index : of refraction that its distances were computed with; 1 in vacuum
    """

    wavelength_nm: float
    is_group: bool = True
    assumed_index: float = 1.0

    def __post_init__(self) -> None:
        if not 300.0 <= self.wavelength_nm <= 1690.0:
            raise ValueError(f"wavelength_nm is {self.wavelength_nm}, not 300 to 1690")
        if not 1.0 <= self.assumed_index <= 1.001:
            raise ValueError(f"assumed_index is {self.assumed_index}, not 1 to 1.001")


@dataclass(frozen=True, slots=True)
class TrackerCapabilities:
    """Capabilities of an instrument, known after `connect`.

    streams : it sends samples continuously; else each point is requested
    max_rate_hz : highest rate of samples, or of shots at a point; 0 if not known
    distance : principle of the distance, `IFM`, `ADM` or `EDM`; empty if not known
    corrects_air : it applies the refraction of the air to its distances itself; None if
        not known
    light : of one that does not, where the driver knows it
    """

    streams: bool = True
    max_rate_hz: float = 0.0
    clock: Clock = Clock.DEVICE
    distance: str = ""
    corrects_air: bool | None = None
    light: Light | None = None


@dataclass(frozen=True, slots=True)
class Air:
    """The air along the beam; NaN where it is not known."""

    temperature_degc: float = np.nan
    pressure_hpa: float = np.nan
    humidity_percent: float = np.nan


@dataclass(frozen=True, slots=True)
class PointMeasurement:
    """The mean of some shots at a target at rest, in the tracker's frame.

    time_s : middle of the measurement, by the clock that the capabilities name
    position_mm : (3,) mean
    covariance_mm2 : (3, 3) of one shot about the mean; zero where that is not known
    count : shots in the mean
    air : as the instrument reports it; None if it does not
    quality : as the instrument reports it, 1 is best; NaN if it does not
    """

    time_s: float
    position_mm: NDArray[np.float64]
    covariance_mm2: NDArray[np.float64]
    count: int
    air: Air | None = None
    quality: float = np.nan

    @classmethod
    def average(
        cls,
        time_s: NDArray[np.float64],
        shots_mm: NDArray[np.float64],
        air: Air | None = None,
        quality: float = np.nan,
    ) -> PointMeasurement:
        """Mean and covariance of single shots, (n, 3)."""
        mean = shots_mm.mean(axis=0)
        away = shots_mm - mean
        square = away.T @ away / max(len(shots_mm) - 1, 1)
        middle_s = 0.5 * float(time_s[0] + time_s[-1])
        return cls(middle_s, mean, square, len(shots_mm), air, quality)


class TrackerEventKind(StrEnum):
    """Kind of an event at a tracker, or at a controller."""

    BEAM_LOST = "tracker-beam-lost"
    BEAM_LOCKED = "tracker-beam-locked"
    WARNING = "tracker-warning"
    UNEVEN = "motion-uneven"


@dataclass(frozen=True, slots=True)
class TrackerEvent:
    """An event at a tracker, or at a controller, as text.

    action : remedy for the operator; empty where none is needed
    """

    kind: TrackerEventKind
    text: str
    action: str = ""
