"""Measurements that run in threads of a test."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tests.measurement.conftest import Journal

from truepath.files.bundle.run import Run
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.messages import (
    CellVerb,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.time_limits import EngineSettings
from truepath_drivers import host_clock
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.tracker import AnyTracker

Begin = Callable[[AnyTracker, MeasurementOrder, EngineSettings], "RunningMeasurement"]


class RunningMeasurement:
    """A measurement under way, and the Run that it leaves."""

    def __init__(self, measurement: Measurement, journal: Journal) -> None:
        self.measurement, self.journal = measurement, journal
        self.thread = threading.Thread(target=measurement.run)
        self.thread.start()

    def wait_for_progress(self, is_reached: Callable[[float], bool]) -> None:
        """Wait until the lines or points that are done are as asked."""
        reports = self.journal.of
        self.journal.wait(
            lambda: any(is_reached(p.done) for p in reports(MeasurementProgress)[-1:])
        )

    def pause_and_resume(self) -> None:
        self.measurement.obey(CellVerb.PAUSE)
        self.journal.wait(lambda: self.journal.states[-1] == "paused")
        self.measurement.obey(CellVerb.RESUME)
        self.journal.wait(lambda: self.journal.states[-1] == "running")

    def wait_for_run(self) -> Run:
        """Wait for the end; return the Run."""
        self.journal.wait(lambda: bool(self.journal.of(RunClosed)))
        host_clock.join(self.thread, 5.0)
        return open_run(self.journal.of(RunClosed)[-1].run_file)


@contextmanager
def run_measurements(motion: MotionController, journal: Journal) -> Iterator[Begin]:
    """Begin measurements on a controller; those under way at the end are aborted."""
    begun: list[RunningMeasurement] = []

    def begin(
        tracker: AnyTracker, order: MeasurementOrder, settings: EngineSettings
    ) -> RunningMeasurement:
        devices = {"tracker": tracker.connect(), "motion": motion.connect()}
        measurement = Measurement(
            order, tracker, motion, devices, journal.report, settings
        )
        begun.append(RunningMeasurement(measurement, journal))
        return begun[-1]

    yield begin
    for one in begun:
        if one.thread.is_alive():
            one.measurement.obey(CellVerb.ABORT)
            host_clock.join(one.thread, 5.0)
