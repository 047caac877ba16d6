"""Requests to the tracker: its stream, its target, its points.

Each takes a while; the monitor runs meanwhile, so that the controller's watchdog is
fed. A request that fails holds the feed, is tried again, or ends the measurement.
"""

from __future__ import annotations

import contextlib

import numpy as np
from numpy.typing import NDArray

from truepath.driver_border import Call
from truepath.measurement.engine.measurement_monitor import MeasurementMonitor
from truepath.measurement.faults import (
    HOMED,
    POINTS_ONLY,
    Fault,
    classify_fault,
    make_beam_fault,
    make_silence_fault,
    make_target_fault,
)
from truepath.measurement.measurement_state import HoldReason
from truepath.measurement.monitors.stream_reader import StreamReader
from truepath.measurement.target import BOUND_MM, TargetCheck, TargetSearch
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    BeamLost,
    ConnectionLost,
    DeviceTimeout,
    NotHomed,
    NotOffered,
)
from truepath_drivers.interfaces.records import MotionState, MotionStatus, is_seen
from truepath_drivers.interfaces.tracker import (
    AnyTracker,
    ByteLink,
    PolledTracker,
    TargetChoice,
    TargetFinder,
    Tracker,
)
from truepath_drivers.interfaces.tracker_records import Clock, PointMeasurement

_JOIN_S = 5.0


class TrackerControl:
    """The tracker of one measurement. Belongs to the thread of the engine.

    targets : where there are several; search : where the tracker supports it
    """

    def __init__(
        self,
        tracker: AnyTracker,
        monitor: MeasurementMonitor,
        targets: TargetCheck | None = None,
        search: TargetSearch | None = None,
    ) -> None:
        self._tracker, self._monitor = tracker, monitor
        self._settings = monitor.settings
        self._targets, self._search = targets, search
        self._chooses, self._is_homed = True, False
        self._failures = 0  # of a polled tracker, one after another
        self._point_s = 0.0

    @property
    def is_polled(self) -> bool:
        """Whether the tracker measures point by point, without a stream."""
        return isinstance(self._tracker, PolledTracker)

    @property
    def stamps_arrival(self) -> bool:
        """Whether samples carry their time of arrival, too inaccurate in motion."""
        tracker = self._tracker
        return isinstance(tracker, Tracker) and tracker.capabilities.clock is Clock.HOST

    @property
    def can_choose(self) -> bool:
        """Whether the tracker can change its target, as far as known."""
        return self._chooses and isinstance(self._tracker, TargetChoice)

    @property
    def device_s(self) -> float:
        """The tracker's clock at its newest sample or point, 0 before the first."""
        return self._monitor.stream.device_time_s or self._point_s

    def begin_stream(self, rate_hz: float) -> None:
        """Start the stream; wait for its first valid sample, or raise Fault."""
        if isinstance(self._tracker, PolledTracker):
            raise POINTS_ONLY
        stream = StreamReader(
            self._tracker,
            self._monitor.recorder,
            self._settings.timeouts,
        )
        try:
            self._start(stream, rate_hz)
        finally:
            self._monitor.stream.watch(stream)  # which ends what has begun
        self._wait_for_sample(stream)

    def _start(self, stream: StreamReader, rate_hz: float) -> None:
        try:
            stream.start(rate_hz)
        except NotHomed as error:
            self._home(error)
            stream.start(rate_hz)

    def _wait_for_sample(self, stream: StreamReader) -> None:
        deadline_s = host_clock.now_s() + self._settings.first_sample_s
        while not stream.has_valid:
            if host_clock.now_s() > deadline_s:
                if stream.device_time_s is None:
                    raise make_silence_fault(self._settings.first_sample_s)
                text = "the tracker sends no valid sample"
                action = "lock the beam on the reflector, then measure again"
                raise Fault("beam-lost", text, action)
            self._monitor.tick()

    def select_target(self, name: str) -> bool:
        """Have the tracker change its target; true if it has.

        A tracker that cannot choose measures what it is aimed at: the check of its
        points requests another target where needed.
        """
        tracker = self._tracker
        if not (self._chooses and isinstance(tracker, TargetChoice)):
            return True
        failure = self._monitor.wait_for_tracker(
            lambda: tracker.select_target(name), tracker.verb_limit_s
        )
        if isinstance(failure, NotOffered):
            self._chooses = False
            self._monitor.events.record("target", str(failure))
        elif isinstance(failure, NotHomed):
            self._home(failure)
            return False
        elif failure is not None:
            self._handle_failure(failure)
            return False
        else:
            self._monitor.events.record("target", f"{name} was selected")
        return True

    def _home(self, error: NotHomed) -> None:
        """Not repeated; homing moves no machine."""
        tracker = self._tracker
        if self._is_homed or not isinstance(tracker, TargetFinder):
            raise classify_fault(error) from error
        self._is_homed = True
        failure = self._monitor.wait_for_tracker(tracker.home, tracker.verb_limit_s)
        if failure is not None:
            raise classify_fault(failure) from failure
        self._monitor.events.report_fault(HOMED)

    def holds_target(self, name: str, place_mm: NDArray[np.float64] | None) -> bool:
        """Whether a point belongs to this target; holds and reports if not.

        place_mm : newest position of the stream if None
        """
        if place_mm is None:
            place_mm = self._monitor.stream.place_mm
        if self._targets is None or not name or place_mm is None:
            return True
        here = self._monitor.position_by_axis
        misfit_mm = self._targets.measure_misfit(here, name, place_mm)
        if misfit_mm > BOUND_MM:
            fault = make_target_fault(name, misfit_mm)
            self._monitor.feed.hold(HoldReason.TARGET, fault)
        return misfit_mm <= BOUND_MM

    def measure_point(self, row: int, dwell_s: float, target: str = "") -> bool:
        """Measure a point at rest and record it.

        False if the machine moved, the feed is held, or the tracker was out of reach.
        Raises Fault once that was so too often.
        """
        tracker = self._tracker
        if not isinstance(tracker, PolledTracker):
            raise POINTS_ONLY
        late_s = host_clock.now_s() + dwell_s + self._settings.timeouts.point_s
        self._monitor.tick()
        here, stood = self._monitor.position, True
        reader = Call(lambda: tracker.measure(dwell_s))
        try:
            while stood and not reader.is_over:
                stood = self._is_at_rest(self._monitor.tick(), here)
                if host_clock.now_s() > late_s:
                    raise make_silence_fault(dwell_s + self._settings.timeouts.point_s)
        finally:
            tracker.stop()
            reader.await_end(_JOIN_S)
        if not stood or not self._is_at_rest(self._monitor.tick(), here):
            text = f"row {row + 1}: moved while it was measured"
            self._monitor.events.record("point", text)
            return False
        return self._record_point(reader, row, here, target)

    def _is_at_rest(self, status: MotionStatus | None, here: tuple[float, ...]) -> bool:
        is_running = status is not None and status.state is MotionState.RUNNING
        return not is_running and self._monitor.is_at(here)

    def _record_point(
        self, reader: Call, row: int, here: tuple[float, ...], target: str
    ) -> bool:
        if reader.failure is not None:
            self._handle_failure(reader.failure)
            return False
        point: PointMeasurement = reader.answer
        if not is_seen(point.position_mm).all():
            self._handle_failure(
                BeamLost("the tracker shows a place that no beam reaches")
            )
            return False
        if not self.holds_target(target, point.position_mm):
            return False
        axes = dict(zip(self._monitor.motion.axes, here, strict=True))
        good, fault = self._monitor.places.assess_point(axes, target, point.position_mm)
        if fault is not None:
            self._monitor.feed.hold(HoldReason.PLACE, fault)
        if not good:
            return False
        if self._search is not None:
            self._search.remember(axes, target, point.position_mm, is_still=True)
        tracker = self._tracker
        data = tracker.take_link_bytes() if isinstance(tracker, ByteLink) else b""
        self._monitor.recorder.put_point(row, point, data)
        self._failures, self._point_s = 0, point.time_s
        return True

    def _handle_failure(self, failure: BaseException) -> None:
        """Holds the feed for a lost beam; reconnects a lost link."""
        if isinstance(failure, BeamLost):
            self._monitor.feed.hold(HoldReason.BEAM, make_beam_fault(str(failure)))
            return
        self._failures += 1
        if (
            not isinstance(failure, ConnectionLost | DeviceTimeout)
            or self._failures > self._settings.point_tries
        ):
            raise classify_fault(failure) from failure
        self._monitor.events.record("tracker", str(failure))
        if isinstance(failure, ConnectionLost):
            with contextlib.suppress(ConnectionLost, DeviceTimeout):
                self._tracker.connect()
