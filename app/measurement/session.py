"""The steps that every measurement is made of, and the watch kept during each.

All waiting of a measurement happens in `tick`: ten times a second it feeds the
controller's watchdog, reads the controller, judges the stream and the disk, and obeys
the operator. An engine that hangs therefore feeds nothing, and the machine holds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.errors import MeasurementFailed
from app.measurement.control import Control, HoldReason
from app.measurement.faults import Aborted, Fault, fault_of
from app.measurement.live_view import LiveView
from app.measurement.orders import CellState, Report
from app.measurement.progress import Schedule
from app.measurement.pump import Pump
from app.measurement.recorder import Recorder
from app.measurement.stream_watch import Patience, StreamWatch, Verdict
from drivers.interfaces.errors import ConnectionLost, DeviceError, DeviceTimeout
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import AxisSamples, MotionState, MotionStatus, Path
from drivers.interfaces.tracker import Tracker

_STANDS = frozenset(
    {
        MotionState.IDLE,
        MotionState.READY,
        MotionState.FINISHED,
        MotionState.ABORTED,
    }
)


@dataclass(frozen=True, slots=True)
class Limits:
    """Times of the host in seconds where nothing else is said.

    confirm_s : a hold, a cycle start or a resume is confirmed by then
    link_s : the controller may be out of reach for so long
    lead_s : stream before the first and after the last motion, tracker's clock
    settle_s : between the end of a move and the dwell at a point, tracker's clock
    arrival : how far from a commanded position an axis may stand, mm or deg
    """

    poll_s: float = 0.1
    confirm_s: float = 5.0
    link_s: float = 2.0
    first_sample_s: float = 5.0
    lead_s: float = 1.0
    settle_s: float = 0.3
    arrival: float = 0.02
    progress_s: float = 0.2
    axes_rows: int = 10
    patience: Patience = field(default_factory=Patience)


class Session:
    """One measurement under way, as its engine sees it.

    `pause` and `resume` may be called by any thread; everything else belongs to the
    thread of the engine.
    """

    def __init__(
        self,
        tracker: Tracker,
        motion: MotionController,
        recorder: Recorder,
        control: Control,
        view: LiveView,
        report: Report,
        schedule: Schedule,
        *,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.motion, self.limits, self.stage = motion, limits or Limits(), "preparing"
        self._tracker, self._recorder, self._control = tracker, recorder, control
        self._view, self._report, self._schedule = view, report, schedule
        self._clock = clock
        self._watch = StreamWatch(self.limits.patience, clock())
        self._pump: Pump | None = None
        self._row = 0
        self._finished = False
        self._position: tuple[float, ...] = ()
        self._axis_rows: list[tuple[float, ...]] = []
        self._begun_s = self._active_since_s = clock()
        self._active_s = 0.0
        self._told_s = -np.inf
        self._unreached_s: float | None = None
        self._resume_by_s: float | None = None
        self._hold_by_s: float | None = None

    # What an engine does.

    def approach(self, position: NDArray[np.float64], feed_mm_min: float) -> None:
        """Move straight to a position and wait there."""
        self.checkpoint()
        self.motion.move_to(tuple(float(v) for v in position), feed_mm_min)
        self.wait_motion(position)

    def open_stream(self, rate_hz: float) -> None:
        """Start the tracker's stream and record `lead_s` of it before any motion."""
        self._watch = StreamWatch(self.limits.patience, self._clock())
        self._pump = Pump(self._tracker, self._recorder, self._watch)
        self._pump.start(rate_hz)
        deadline_s = self._clock() + self.limits.first_sample_s
        while not self._watch.has_valid:
            if self._clock() > deadline_s:
                raise self._no_stream()
            self.tick()
        self.record_for(self.limits.lead_s)

    def run_path(self, path: Path) -> None:
        """Start the loaded path and follow it to its end."""
        self.checkpoint()
        self.stage = "measuring"
        self._begun_s = self._active_since_s = self._clock()
        self._active_s = 0.0
        self._recorder.event("start", "cycle start")
        self.motion.start()
        self.wait_motion(path.position[-1])

    def wait_motion(self, goal: NDArray[np.float64]) -> None:
        """Wait until the machine stands where it was sent.

        Raises Fault if it stands elsewhere: the motion ended early.
        """
        grace_by_s = self._clock() + self.limits.confirm_s
        while True:
            status = self.tick()
            if status is None or status.state not in _STANDS or self._control.standing:
                if status is not None and status.state is MotionState.RUNNING:
                    grace_by_s = self._clock() + 10 * self.limits.poll_s
                continue
            away = np.abs(np.array(status.position) - goal)
            if (away <= self.limits.arrival).all():
                return
            if status.state is MotionState.ABORTED or self._clock() > grace_by_s:
                raise self._ended_early(status, goal)

    def record_for(self, device_s: float) -> None:
        """Stand and let the stream run for so long on the tracker's clock.

        After a pause it starts over: what came before may lack the beam.
        """
        begin_s = self._device_s()
        while self._device_s() - begin_s < device_s:
            self.tick()
            if self._control.standing:
                self.checkpoint()
                begin_s = self._device_s()

    def checkpoint(self) -> None:
        """Stand here for as long as the operator wishes."""
        self.tick()
        while self._control.standing:
            self.tick()

    def begin_row(self, row: int) -> None:
        """Note that the machine is sent to this row now."""
        self.stage, self._row = "measuring", row

    def point_done(self, row: int) -> None:
        """Write down that a standstill point has been measured."""
        self._recorder.event("point", f"row {row + 1} until {self._device_s():.6f} s")

    def finish(self) -> None:
        """Record `lead_s` after the last motion."""
        self.stage, self._finished, self._told_s = "closing", True, -np.inf
        begin_s = self._device_s()
        while self._device_s() - begin_s < self.limits.lead_s:
            self.tick()

    def close_stream(self) -> None:
        """End the stream and hand over what waits. Idempotent, never raises."""
        if self._pump is not None:
            try:
                self._pump.stop()
            except DeviceError as error:
                self._note("tracker", str(error))
        with contextlib.suppress(MeasurementFailed):
            self._flush_axes()

    # What anybody may wish.

    def pause(self) -> None:
        """Feed hold, now. The state is `paused` once the controller confirms."""
        if self._control.hold(HoldReason.OPERATOR, "pause"):
            self.motion.hold()

    def resume(self) -> None:
        """Go on after a pause, a lost beam or a hold at the machine."""
        if self._watch.verdict(self._clock()) is not Verdict.GOOD and self._pump:
            self._tell(_NO_BEAM)
            return
        if self._control.release(*HoldReason, text="resume"):
            self.motion.resume()

    # The watch.

    def tick(self) -> MotionStatus | None:
        """Wait a tenth of a second and look at everything.

        Returns the controller's status, None if it did not answer this time. Raises
        Aborted, or Fault.
        """
        if self._control.aborted.wait(self.limits.poll_s):
            raise Aborted("aborted on request")
        self._check_disk()
        self._check_stream()
        status = self._read_motion()
        if status is not None:
            self._follow(status)
        self._tell_progress()
        return status

    def _check_disk(self) -> None:
        if self._recorder.failure or self._recorder.low_space:
            text = self._recorder.failure or "the disk is almost full"
            action = "free some space, then measure again"
            raise Fault("storage", text, action, latched=False)
        if self._recorder.strained:
            self._hold_for(HoldReason.DISK, _SLOW_DISK)
        elif self._recorder.relaxed and self._control.holds(HoldReason.DISK):
            self._go_on_after(HoldReason.DISK, "the disk has caught up")

    def _check_stream(self) -> None:
        if self._pump is None:
            return
        if self._pump.failure is not None:
            raise fault_of(self._pump.failure)
        verdict = self._watch.verdict(self._clock())
        if verdict is Verdict.DEAD:
            raise _silent(self.limits.patience.dead_s)
        if verdict is Verdict.SILENT:
            self._hold_for(HoldReason.SILENCE, _SILENT)
        elif verdict is Verdict.BEAM_LOST:
            self._hold_for(HoldReason.BEAM, _BEAM_LOST)
        elif self._control.holds(HoldReason.SILENCE):
            # Too short for anybody to have walked up to the machine: go on by itself.
            self._go_on_after(HoldReason.SILENCE, "the stream is back")

    def _hold_for(self, reason: HoldReason, fault: Fault) -> None:
        if self._control.hold(reason, fault.text):
            self._tell(fault)
            self._command(self.motion.hold)

    def _go_on_after(self, reason: HoldReason, text: str) -> None:
        self._note("stream" if reason is HoldReason.SILENCE else "storage", text)
        if self._control.release(reason, text=text):
            self._command(self.motion.resume)

    def _command(self, verb: Callable[[], None]) -> None:
        """Tell the controller. If it is out of reach, `tick` asks again and notices."""
        with contextlib.suppress(ConnectionLost, DeviceTimeout):
            verb()

    def _read_motion(self) -> MotionStatus | None:
        try:
            self.motion.beat()
            status = self.motion.status()
        except (ConnectionLost, DeviceTimeout) as error:
            now_s = self._clock()
            self._unreached_s = self._unreached_s or now_s
            if now_s - self._unreached_s > self.limits.link_s:
                raise fault_of(error) from error
            return None
        self._unreached_s = None
        self._position = self._view.axes = status.position
        self._axis_rows.append((self._clock(), *status.position))
        if len(self._axis_rows) >= self.limits.axes_rows:
            self._flush_axes()
        return status

    def _follow(self, status: MotionStatus) -> None:
        if status.state is MotionState.ALARM:
            action = "clear the alarm at the machine, then measure again"
            text = f"the controller is in alarm: {status.alarm or 'no text'}"
            raise Fault("motion-alarm", text, action, latched=True)
        if self._schedule.unit == "lines" and self.stage == "measuring":
            last = self._schedule.total
            self._row = min(max(self._row, status.line), last)
        before = self._control.state
        self._control.observe(status.state, status.hold_reason)
        self._count_active(before)
        if self._control.wants_hold and status.state is MotionState.RUNNING:
            self._insist_on_hold()
        else:
            self._hold_by_s = None
        self._insist_on_resume(status)

    def _insist_on_hold(self) -> None:
        self._command(self.motion.hold)
        self._hold_by_s = self._hold_by_s or self._clock() + self.limits.confirm_s
        if self._clock() > self._hold_by_s:
            raise Fault(
                "hold-unconfirmed",
                f"the machine moves {self.limits.confirm_s:g} s after a hold",
                "press feed hold at the machine",
                latched=True,
            )

    def _insist_on_resume(self, status: MotionStatus) -> None:
        if self._control.state is not CellState.RESUMING:
            self._resume_by_s = None
            return
        self._command(self.motion.resume)
        self._resume_by_s = self._resume_by_s or self._clock() + self.limits.confirm_s
        if self._clock() > self._resume_by_s:
            self._tell(_STILL_HELD)
            self._control.fall_back(f"still held: {status.hold_reason}")

    def _count_active(self, before: CellState) -> None:
        """Keep the time without pauses, which the pace is reckoned from."""
        now_s = self._clock()
        if before is CellState.RUNNING:
            self._active_s += now_s - self._active_since_s
        self._active_since_s = now_s

    def _flush_axes(self) -> None:
        if self._axis_rows:
            rows = np.array(self._axis_rows)
            self._axis_rows = []
            self._recorder.put_axes(
                AxisSamples(self.motion.axes, rows[:, 0], rows[:, 1:])
            )

    def _tell_progress(self) -> None:
        now_s = self._clock()
        if now_s - self._told_s < self.limits.progress_s:
            return
        self._told_s = now_s
        left_s = self._schedule.remaining_s(self._row, self._active_s)
        self._report(
            "progress",
            {
                "done": self._schedule.done(self._row, finished=self._finished),
                "total": self._schedule.total,
                "unit": self._schedule.unit,
                "stage": self.stage,
                "position": list(self._position),
                "samples": self._recorder.samples,
                "lost_samples": self._recorder.lost_samples,
                "crc_errors": self._tracker.health.crc_errors,
                "elapsed_s": round(now_s - self._begun_s, 3),
                "remaining_s": 0.0 if self._finished else round(left_s, 3),
            },
        )

    def _tell(self, fault: Fault) -> None:
        self._note(fault.code, fault.text)
        self._report(
            "fault", {"code": fault.code, "text": fault.text, "action": fault.action}
        )

    def _note(self, kind: str, text: str) -> None:
        with contextlib.suppress(MeasurementFailed):
            self._recorder.event(kind, text)

    def _device_s(self) -> float:
        return self._watch.device_time_s or 0.0

    def _no_stream(self) -> Fault:
        if self._watch.device_time_s is None:
            return _silent(self.limits.first_sample_s)
        return Fault(
            "beam-lost",
            "the tracker sends no valid sample",
            "lock the beam on the reflector, then measure again",
            latched=False,
        )

    def _ended_early(self, status: MotionStatus, goal: NDArray[np.float64]) -> Fault:
        here = ", ".join(
            f"{axis} {value:.3f}"
            for axis, value in zip(self.motion.axes, status.position, strict=True)
        )
        there = ", ".join(f"{value:.3f}" for value in goal)
        return Fault(
            "ended-early",
            f"the controller is {status.state} at {here} (row {status.line + 1}), "
            f"not at {there}",
            "check which program ran at the machine",
            latched=True,
        )


_SILENT = Fault(
    "tracker-silent",
    "no sample has come for half a second; the feed is held",
    "nothing: it goes on by itself when the stream is back within seconds",
    latched=False,
)
_SLOW_DISK = Fault(
    "slow-disk",
    "the disk cannot keep up; the feed is held until it has",
    "nothing: it goes on by itself; use a local disk",
    latched=False,
)
_BEAM_LOST = Fault(
    "beam-lost",
    "the tracker has lost the reflector; the feed is held",
    "lock the beam on the reflector, then press Resume",
    latched=False,
)
_NO_BEAM = Fault(
    "not-resumed",
    "the tracker sends no valid samples, the machine stays held",
    "lock the beam on the reflector, then press Resume",
    latched=False,
)
_STILL_HELD = Fault(
    "resume-unconfirmed",
    "the controller keeps holding",
    "release feed hold and door at the machine, then press Resume",
    latched=False,
)


def _silent(after_s: float) -> Fault:
    return Fault(
        "tracker-silent",
        f"no sample has come for {after_s:g} s",
        "check the tracker and its cable, then measure again",
        latched=True,
    )
