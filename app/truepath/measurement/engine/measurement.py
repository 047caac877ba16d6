"""One measurement from beginning to end: checks, motion, recording, reports."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

from truepath.driver_border import find_stuck, list_origins
from truepath.errors import MeasurementFailed
from truepath.files.environment import (
    assumed_range_factor,
    choose_refraction,
    lacks_air,
)
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.engine.measurement_monitor import MeasurementMonitor
from truepath.measurement.engine.measurement_steps import (
    MeasurementSteps,
    PointSteps,
    arrange_axes,
)
from truepath.measurement.engine.path_steps import PathSteps
from truepath.measurement.engine.tracker_control import TrackerControl
from truepath.measurement.faults import (
    AIR_UNKNOWN,
    MOTION_BUSY,
    NO_WATCHDOG,
    STOP_NOT_CONFIRMED,
    Aborted,
    Fault,
    classify_fault,
    make_override_fault,
    make_position_fault,
    make_unable_fault,
)
from truepath.measurement.measurement_state import MeasurementState
from truepath.measurement.messages import (
    CellState,
    CellVerb,
    MeasurementCommand,
    MeasurementOrder,
    ReportEvent,
    RunClosed,
    StateChanged,
)
from truepath.measurement.monitors.environment_reader import (
    EnvironmentReader,
    list_groups,
    name_channels,
)
from truepath.measurement.monitors.plausibility import PointCheck, find_impossible
from truepath.measurement.progress import LiveView, schedule_rows
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.measurement.target import TargetCheck, TargetSearch
from truepath.measurement.time_limits import EngineSettings
from truepath.motion.workspace import check_travel
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceError, Refused
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import (
    UNABLE,
    Identity,
    MotionState,
    MotionStatus,
    Path,
)
from truepath_drivers.interfaces.thermometers import Thermometers
from truepath_drivers.interfaces.tracker import AnyTracker, TargetFinder

log = logging.getLogger(__name__)

STOP_S = 3.0
_SAME_OVERRIDE = 5e-4


class Measurement:
    """One order on connected devices. `run` is for one thread, all else for any."""

    def __init__(
        self,
        order: MeasurementOrder,
        tracker: AnyTracker,
        motion: MotionController,
        devices: Mapping[str, Identity],
        report: ReportEvent,
        settings: EngineSettings,
        thermometers: Thermometers | None = None,
    ) -> None:
        self._groups = list_groups(tracker, thermometers)
        self._environment: EnvironmentReader | None = None
        self._order, self._tracker, self._motion = order, tracker, motion
        self._devices, self._report, self._settings = dict(devices), report, settings
        self._plugins = list_origins(
            tracker=tracker, motion=motion, thermometers=thermometers
        )
        self._state = MeasurementState(self._report_state)
        self._monitor: MeasurementMonitor | None = None
        self._steps: MeasurementSteps | None = None
        self._recorder: Recorder | None = None
        self._is_halted = False

    def obey(self, command: MeasurementCommand) -> None:
        """Execute a command; before the first step only an abort has effect.

        Raises DeviceError if the controller is out of reach; its watchdog holds then.
        """
        if command is CellVerb.ABORT:
            self._state.aborted.set()
            self._motion.abort()
        elif self._steps is not None:
            self._steps.obey(command)

    def miss_service(self) -> None:
        """Hold the feed until an operator resumes, because the service is silent.

        Raises DeviceError as `obey`.
        """
        if self._steps is not None:
            self._steps.miss_service()

    def halt(self) -> None:
        """Hold the feed and end the measurement, because the service ends."""
        self._is_halted = True
        self._state.aborted.set()
        self._motion.hold()

    def run(self) -> None:
        """Measure. Never raises: the last two events report how it ended."""
        self._report_state(CellState.RUNNING, self._order.run_name)
        state, text = CellState.FINISHED, "all rows have been driven"
        has_stopped = True
        try:
            self._measure()
            if self._steps is not None and self._steps.is_concluding:
                text = "ended early: enough is known"
            elif self._steps is not None and self._steps.has_repeated:
                text += "; some twice, for what was lost meanwhile"
        except Aborted as error:
            state, text = CellState.ABORTED, str(error)
            verb = self._motion.hold if self._is_halted else self._motion.abort
            has_stopped = self._stop(verb)
        except Exception as error:
            fault = classify_fault(error)
            if fault.code == "internal":
                log.exception("run %s: defect while measuring", self._order.run_name)
            state = CellState.FAULTED if fault.latched else CellState.FAILED
            text = str(fault)
            with contextlib.suppress(DeviceError):
                if self._steps is not None:
                    self._motion.hold()
            self._report_fault(fault)
            has_stopped = self._stop(self._motion.hold)
        if not has_stopped and state is not CellState.FAULTED:
            self._report_fault(STOP_NOT_CONFIRMED)
            state, text = CellState.FAULTED, str(STOP_NOT_CONFIRMED)
        closed = self._close(state, text)
        self._state.end(state, text)
        self._report(closed)

    def _measure(self) -> None:
        order = self._order
        check_travel(order.machine, order.commanded)
        status = self._check_controller()
        self._motion.abort()  # the rest of an earlier order must not continue
        # Refuse a wrong axis before there is a Run.
        commanded = arrange_axes(order.commanded, self._motion.axes, status.position)
        header = self._make_header(status)
        view = LiveView(
            self._report,
            reports_blocks=order.live,
            range_scale=assumed_range_factor(
                header.refraction, header.channels, order.machine.altitude_m
            ),
        )
        self._recorder = Recorder(
            FilePath(order.run_file),
            header,
            on_recorded=view.show,
            reserve_bytes=order.reserve_bytes,
        )
        self._report_limits(header, status)
        self._environment = EnvironmentReader(
            self._groups,
            self._recorder,
            self._note_sensor,
            on_readings=view.show_readings,
            altitude_m=order.machine.altitude_m,
        )
        self._environment.start()
        search = self._make_search(order.machine)
        self._monitor = MeasurementMonitor(
            self._tracker,
            self._motion,
            self._recorder,
            self._state,
            view,
            self._report,
            schedule_rows(order.commanded, order.feed_mm_min),
            self._settings,
            PointCheck(
                order.machine, has_one_target=len(set(order.commanded.target)) <= 1
            ),
            search,
        )
        targets = TargetCheck(order.machine) if len(order.machine.targets) > 1 else None
        tracker = TrackerControl(self._tracker, self._monitor, targets, search)
        if isinstance(commanded, Path):
            self._steps = PathSteps(
                self._monitor, tracker, order, status.position, commanded
            )
        else:
            self._steps = PointSteps(
                self._monitor, tracker, order, status.position, commanded
            )
        self._steps.run()

    def _check_controller(self) -> MotionStatus:
        may_go = self._settings.allow_no_watchdog
        if not (self._is_watched or (may_go and self._devices["motion"].stops_unasked)):
            raise NO_WATCHDOG
        status = self._motion.status()
        if status.state in UNABLE:
            raise make_unable_fault(status, latched=False)
        if status.referenced is False:
            unhomed = replace(status, state=MotionState.UNHOMED)
            raise make_unable_fault(unhomed, latched=False)
        if status.is_busy:
            raise MOTION_BUSY
        here, again = status.position, self._motion.status().position
        doubt = find_impossible(self._motion, here)
        away = np.abs(np.subtract(here, again)).max()
        if not doubt and away > self._settings.arrival:
            doubt = f"they go from {here} to {again}, and nothing moves"
        if doubt:
            raise make_position_fault(doubt)
        return status

    @property
    def _is_watched(self) -> bool:
        return self._devices["motion"].has_watchdog

    def _make_header(self, status: MotionStatus) -> RunHeader:
        order = self._order
        return RunHeader(
            order.run_name,
            order.machine,
            order.commanded,
            order.rate_hz,
            self._devices,
            self._motion.axes,
            name_channels(self._groups),
            choose_refraction(self._tracker.capabilities, self._settings.light),
            order.job_id,
            order.machine_id,
            order.machine_version,
            status.compensation,
            order.active_tables,
            self._plugins,
        )

    def _report_limits(self, header: RunHeader, status: MotionStatus) -> None:
        if not self._is_watched:
            self._record_event(NO_WATCHDOG.code, NO_WATCHDOG.text)
        self._settle_override(status.override)
        if lacks_air(header.refraction, header.channels):
            self._report_fault(AIR_UNKNOWN)

    def _make_search(self, machine: Machine) -> TargetSearch | None:
        may_search = self._settings.timeouts.search_s > 0.0
        if not (may_search and isinstance(self._tracker, TargetFinder)):
            return None
        return TargetSearch(self._tracker, machine, self._settings)

    def _settle_override(self, override: float | None) -> None:
        if override is None or abs(override - 1.0) < _SAME_OVERRIDE:
            return
        if override > 1.0:
            with contextlib.suppress(Refused):
                self._motion.limit_override(1.0)
                text = f"lowered from {100 * override:.0f} % to 100 %"
                self._record_event("override", text)
                return
        self._report_fault(make_override_fault(override))

    def _stop(self, verb: Callable[[], None]) -> bool:
        """False if the machine is not known to be at rest. Its watchdog gets no beats
        meanwhile, so a controller that does not respond holds. After a driver call that
        hangs the state is unknown; the process ends soon.
        """
        if self._steps is None:
            return True
        deadline_s = host_clock.now_s() + STOP_S
        while host_clock.now_s() < deadline_s and not find_stuck(self._motion):
            with contextlib.suppress(DeviceError):
                verb()
                if self._motion.status().state is not MotionState.RUNNING:
                    return True
            host_clock.sleep_s(0.05)
        return False

    def _note_sensor(self, notice: Fault) -> None:
        self._record_event(notice.code, notice.text)
        if notice.action:
            self._report(notice.event)

    def _close(self, state: CellState, text: str) -> RunClosed:
        if self._environment is not None:
            self._environment.stop()
        if self._monitor is not None:
            self._monitor.end()
        if self._recorder is None:
            file = self._order.run_file  # of an earlier measurement, if it is there
            return RunClosed(file if FilePath(file).exists() else "", outcome=state)
        self._record_event("outcome", f"{state}: {text}")
        closed = self._recorder.close(state)
        self._recorder = None
        if closed.failure:
            action = "keep the file; what was committed can be read"
            self._report_fault(Fault("storage", closed.failure, action))
        return closed

    def _report_fault(self, fault: Fault) -> None:
        self._report(fault.event)
        self._record_event(fault.code, fault.text)

    def _report_state(self, state: CellState, text: str) -> None:
        self._record_event("state", f"{state}: {text}" if text else str(state))
        self._report(StateChanged(state, text))

    def _record_event(self, kind: str, text: str) -> None:
        if self._recorder is not None:
            with contextlib.suppress(MeasurementFailed):
                self._recorder.event(kind, text)
