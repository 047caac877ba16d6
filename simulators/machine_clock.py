"""The clock of the simulated machine: the host's monotonic clock, sped up."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MachineClock:
    """Machine seconds since an epoch; the same in every process of the host."""

    epoch_ns: int
    speed: float

    def now_s(self) -> float:
        """Return machine seconds."""
        return (time.monotonic_ns() - self.epoch_ns) * 1e-9 * self.speed
