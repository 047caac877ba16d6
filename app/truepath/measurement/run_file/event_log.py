"""Events of a measurement, for the Run and for the service."""

from __future__ import annotations

import contextlib

from truepath.errors import MeasurementFailed
from truepath.measurement.faults import Fault
from truepath.measurement.messages import ReportEvent
from truepath.measurement.run_file.recorder import Recorder


class EventLog:
    """Records events in the Run and reports faults to the service. For any thread."""

    def __init__(self, recorder: Recorder, report: ReportEvent) -> None:
        self._recorder, self._report = recorder, report

    def record(self, kind: str, text: str) -> None:
        """Record an event. Never raises: the recorder keeps its failure."""
        with contextlib.suppress(MeasurementFailed):
            self._recorder.event(kind, text)

    def report_fault(self, fault: Fault) -> None:
        """Report and record a fault that the measurement may survive."""
        self.record(fault.code, fault.text)
        self._report(fault.event)
