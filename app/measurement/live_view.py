"""Thins the recorded stream for the eye. Never the record itself."""

from __future__ import annotations

import numpy as np

from app.measurement.messages import LivePoints, ReportEvent
from drivers.interfaces.records import TrackerSamples

SPACING_S = 0.1


class LiveView:
    """Reports points some 0.1 s apart (device's clock) as blocks are committed."""

    def __init__(self, report: ReportEvent) -> None:
        self._report = report
        self._last_slot = -np.inf
        self.axes: tuple[float, ...] = ()

    def show(self, samples: TrackerSamples) -> None:
        """Report the points of a block that has been written."""
        time_s = samples.device_time_s
        slot = np.floor(time_s / SPACING_S)
        valid = samples.status == 0
        _, first = np.unique(slot[valid], return_index=True)
        chosen = np.flatnonzero(valid)[first]
        chosen = chosen[slot[chosen] > self._last_slot]
        if not len(chosen):
            return
        self._last_slot = float(slot[chosen[-1]])
        points = np.round(samples.position_mm[chosen], 4).tolist()
        self._report(LivePoints(points, list(self.axes), float(time_s[-1])))
