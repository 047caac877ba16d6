"""One order from beginning to end: what is checked, done, recorded, told."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from app.errors import MeasurementFailed
from app.measurement.control import Control
from app.measurement.faults import Aborted, Fault, fault_of
from app.measurement.limits import Limits
from app.measurement.live_view import LiveView
from app.measurement.messages import (
    BlockRecorded,
    CellState,
    MeasurementOrder,
    ReportEvent,
    RunClosed,
    StateChanged,
)
from app.measurement.on_the_fly import stream_path
from app.measurement.parts import More, extended
from app.measurement.progress import schedule_of
from app.measurement.recorder import ClosedRun, Committed, Recorder
from app.measurement.run_file import RunHeader
from app.measurement.session import Session
from app.measurement.step_through import step_through
from app.measurement.watch import Watch
from app.motion.configurations import Commanded, Configurations
from app.motion.paths import check_travel
from drivers.interfaces.errors import DeviceError
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import Identity, MotionState, Path, TrackerSamples
from drivers.interfaces.tracker import Tracker

log = logging.getLogger(__name__)

STOP_S = 3.0


class Measurement:
    """One order on connected devices. `run` belongs to one thread, verbs to any.

    limits : how long it waits for what; clock : by which it waits, monotonic
    """

    def __init__(
        self,
        order: MeasurementOrder,
        tracker: Tracker,
        motion: MotionController,
        devices: Mapping[str, Identity],
        report: ReportEvent,
        *,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._order, self._tracker, self._motion = order, tracker, motion
        self._devices, self._report, self._limits = dict(devices), report, limits
        self._clock = clock
        self._control = Control(self._state_changed)
        self._watch: Watch | None = None
        self._session: Session | None = None
        self._recorder: Recorder | None = None
        self._halted = False

    def pause(self) -> None:
        """Feed hold, now."""
        if self._session is not None:
            self._session.pause()

    def resume(self) -> None:
        """Go on."""
        if self._session is not None:
            self._session.resume()

    def conclude(self) -> None:
        """Finish the line or point under way, leave out the rest, end in order."""
        if self._session is not None:
            self._session.conclude()

    def extend(self, part: Commanded) -> None:
        """Go on with a further part once the machine stands at the end of the last."""
        if self._session is not None:
            self._session.extend(part)

    def abort(self) -> None:
        """Stop and forget the path, whatever is going on.

        Raises DeviceError if the controller is out of reach; its watchdog holds then.
        """
        self._control.aborted.set()
        self._motion.abort()

    def halt(self) -> None:
        """Hold the feed and end the measurement: the service goes away."""
        self._halted = True
        self._control.aborted.set()
        self._motion.hold()

    def run(self) -> None:
        """Measure. Never raises: how it ended is told by the last two events."""
        self._state_changed(CellState.RUNNING, self._order.run_name)
        state, text = CellState.FINISHED, "all rows have been driven"
        try:
            self._measure()
            if self._session is not None and self._session.is_concluding:
                text = "ended early: enough is known"
        except Aborted as error:
            state, text = CellState.ABORTED, str(error)
            self._stop(self._motion.hold if self._halted else self._motion.abort)
        except Exception as error:
            fault = fault_of(error)
            if fault.code == "internal":
                log.exception("run %s: defect while measuring", self._order.run_name)
            state = CellState.FAULTED if fault.latched else CellState.FAILED
            text = str(fault)
            with contextlib.suppress(DeviceError):
                self._hold_if_ours()
            self._tell(fault)
            self._stop(self._motion.hold)
        closed = self._close(state, text)
        self._control.end(state, text)
        file = str(closed.file) if closed.file.exists() else ""
        self._report(
            RunClosed(file, closed.samples, closed.lost_samples, closed.sha256, state)
        )

    def _measure(self) -> None:
        order = self._order
        check_travel(order.machine, order.commanded)
        status = self._motion.status()
        if status.state is MotionState.RUNNING:
            raise Fault(
                "motion-busy",
                "the controller already runs something else",
                "let it end or stop it at the machine",
                latched=False,
            )
        self._motion.abort()  # what it still holds of an earlier order must not go on
        commanded = arranged(order.commanded, self._motion.axes, status.position)
        view = LiveView(self._report)
        header = RunHeader(
            order.run_name,
            order.machine,
            order.commanded,
            order.rate_hz,
            self._devices,
            self._motion.axes,
        )
        self._recorder = Recorder(
            FilePath(order.run_file),
            header,
            committed=self._shown_by(view),
            reserve_bytes=order.reserve_bytes,
        )
        self._watch = Watch(
            self._tracker,
            self._motion,
            self._recorder,
            self._control,
            view,
            self._report,
            schedule_of(order.commanded, order.feed_mm_min),
            limits=self._limits,
            clock=self._clock,
        )
        self._session = Session(
            self._watch, self._motion, self._recorder, self._control, self._report
        )
        rate_hz, feed = order.rate_hz, order.feed_mm_min
        more = self._more(self._session, status.position)
        if isinstance(commanded, Path):
            stream_path(self._session, commanded, more, rate_hz=rate_hz, feed=feed)
        else:
            step_through(self._session, commanded, more, rate_hz=rate_hz, feed=feed)

    def _more(self, session: Session, stand: tuple[float, ...]) -> More:
        """Return what waits for further parts, checks them and writes them down."""
        order, commanded = self._order, self._order.commanded

        def more() -> Commanded | None:
            nonlocal commanded
            part = session.wait_for_part() if order.grows else None
            if part is None:
                return None
            check_travel(order.machine, part)
            commanded = extended(commanded, part)
            session.add_rows(commanded, schedule_of(commanded, order.feed_mm_min))
            return arranged(part, self._motion.axes, stand)

        return more

    def _shown_by(self, view: LiveView) -> Committed:
        """Return what is told committed blocks: the eye, and the live estimate."""

        def show(samples: TrackerSamples) -> None:
            view.show(samples)
            if self._order.live:
                self._report(BlockRecorded(samples))

        return show

    def _hold_if_ours(self) -> None:
        if self._session is not None:
            self._motion.hold()

    def _stop(self, verb: Callable[[], None]) -> None:
        """Bring the machine to a stand if it moves by our order; wait a little."""
        if self._session is None:
            return
        deadline_s = time.monotonic() + STOP_S
        while time.monotonic() < deadline_s:
            with contextlib.suppress(DeviceError):
                verb()
                if self._motion.status().state is not MotionState.RUNNING:
                    return
            time.sleep(0.05)

    def _close(self, state: CellState, text: str) -> ClosedRun:
        if self._watch is not None:
            self._watch.end_stream()
        if self._recorder is None:
            return ClosedRun(FilePath(self._order.run_file), "", 0, 0)
        self._note("outcome", f"{state}: {text}")
        closed = self._recorder.close(str(state))
        self._recorder = None
        if closed.failure:
            action = "keep the file; what was committed can be read"
            self._tell(Fault("storage", closed.failure, action, latched=False))
        return closed

    def _tell(self, fault: Fault) -> None:
        self._report(fault.event)
        self._note(fault.code, fault.text)

    def _state_changed(self, state: CellState, text: str) -> None:
        self._note("state", f"{state}: {text}" if text else str(state))
        self._report(StateChanged(state, text))

    def _note(self, kind: str, text: str) -> None:
        if self._recorder is not None:
            with contextlib.suppress(MeasurementFailed):
                self._recorder.event(kind, text)


def arranged(
    commanded: Path | Configurations, axes: tuple[str, ...], stand: tuple[float, ...]
) -> Path | Configurations:
    """Return the rows in the axis order of a controller.

    Axes that the plan does not name stay where they stand. Raises Fault if the plan
    names an axis that the controller has not got.
    """
    missing = [name for name in commanded.axes if name not in axes]
    if missing:
        raise Fault(
            "wrong-device",
            f"the controller has axes {', '.join(axes)}, none is {missing[0]}",
            "check the machine file and the controller",
            latched=False,
        )
    position: NDArray[np.float64] = np.tile(np.array(stand, float), (len(commanded), 1))
    for column, name in enumerate(commanded.axes):
        position[:, axes.index(name)] = commanded.position[:, column]
    return replace(commanded, axes=axes, position=position)
