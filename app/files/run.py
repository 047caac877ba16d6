"""A Run as science sees it: what was commanded, what was recorded. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from app.kinematics.machine import Machine
from app.motion.configurations import Configurations
from drivers.interfaces.records import (
    AxisSamples,
    Path,
    TemperatureSamples,
    TrackerSamples,
)


@dataclass(frozen=True, slots=True)
class DirectMeasurement:
    """One error measured directly, in one direction of approach, to compare with.

    position_mm, value : (n,), value in `unit`; direction `+` or `-`
    """

    error: str
    direction: str
    unit: str
    position_mm: np.ndarray
    value: np.ndarray


@dataclass(frozen=True, slots=True)
class RunEvent:
    """Something that happened during a Run, by the host's monotonic clock."""

    mono_ns: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Run:
    """One measurement, whole or as far as it got."""

    name: str
    machine: Machine
    commanded: Path | Configurations
    tracker: TrackerSamples
    temperature: TemperatureSamples | None = None
    axis_samples: AxisSamples | None = None
    reference: tuple[DirectMeasurement, ...] = ()
    events: tuple[RunEvent, ...] = ()
    provenance: dict[str, str] = field(default_factory=dict)

    @property
    def mode(self) -> str:
        """`otf` for a streamed path, `standstill` for points."""
        return "otf" if isinstance(self.commanded, Path) else "standstill"
