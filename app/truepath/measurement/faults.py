"""Reasons for which a measurement ends early."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from truepath.errors import MeasurementFailed, TruepathError
from truepath.measurement.messages import FaultReported
from truepath_drivers.interfaces.errors import (
    BeamLost,
    ConnectionLost,
    DeviceBusy,
    DeviceError,
    DeviceTimeout,
    DriverFault,
    MotionFault,
    OutOfTravel,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import UNABLE, MotionStatus


class Aborted(MeasurementFailed):
    """An operator requested the end."""


class Fault(MeasurementFailed):
    """Error with a code and a remedy.

    code : for programs; text : description; action : remedy
    latched : an operator has to check the machine before anything continues
    """

    def __init__(
        self, code: str, text: str, action: str, *, latched: bool = False
    ) -> None:
        self.code, self.text, self.action, self.latched = code, text, action, latched
        super().__init__(f"{text}; {action}")

    @property
    def event(self) -> FaultReported:
        """The fault as the cell reports it."""
        return FaultReported(self.code, self.text, self.action)


_FAMILIES: tuple[tuple[type[DeviceError], str, str, bool], ...] = (
    (OutOfTravel, "out-of-travel", "shorten the plan or check the work offset", False),
    (Refused, "refused", "check rate, feed and mode of the device", False),
    (WrongDevice, "wrong-device", "check the port in the settings", False),
    (BeamLost, "beam-lost", "lock the beam on the reflector, then go on", True),
    (MotionFault, "motion-alarm", "clear the alarm at the machine", True),
    (ConnectionLost, "link-lost", "put that right, then connect again", True),
    (DeviceBusy, "control-busy", "see what keeps it busy, then connect again", True),
    (DeviceTimeout, "no-answer", "put that right, then connect again", True),
    (DriverFault, "driver", "connect again; if it comes back, replace it", True),
    (DeviceError, "device", "look at the device, then connect again", True),
)


def classify_fault(error: BaseException) -> Fault:
    """The fault that corresponds to an error of a device or of the service."""
    if isinstance(error, Fault):
        return error
    for family, code, action, latched in _FAMILIES:
        if isinstance(error, family):
            return Fault(code, str(error), action, latched=latched)
    if isinstance(error, TruepathError):
        return Fault("failed", str(error), "correct this, then begin again")
    return Fault(
        "internal",
        f"{type(error).__name__}: {error}",
        "this is a defect of the service; the log has the details",
        latched=True,
    )


SILENT = Fault(
    "tracker-silent",
    "no sample has come for half a second; the feed is held",
    "nothing: it goes on by itself when the stream is back within seconds",
)
POINTS_ONLY = Fault(
    "points-only",
    "this tracker measures standing targets, point by point, and the plan is a path",
    "plan for standstill points, or use a tracker that streams",
)
NO_TIMES = Fault(
    "no-times",
    "the tracker's samples bear the time of their arrival, and the plan is a path: a "
    "late sample would be an error along the line",
    "let the stream carry a time or a counter, or plan for standstill points",
)
DAMAGED = Fault(
    "stream-damaged",
    "more than 1 % of the tracker's samples are bad or lost; the feed is held",
    "nothing: it goes on by itself and drives the line again; look at the cable",
)
STAYS_DAMAGED = Fault(
    "stream-damaged",
    "too many of the tracker's samples stay bad or lost",
    "check cable, shielding and baud rate of the tracker, then measure again",
    latched=True,
)
SLOW_DISK = Fault(
    "slow-disk",
    "the disk cannot keep up; the feed is held until it has",
    "nothing: it goes on by itself when the disk has caught up within seconds; use a "
    "local disk",
)
DISK_STAYS_SLOW = Fault(
    "disk-stays-slow",
    "the disk has not caught up within 10 s; the feed stays held",
    "look at the machine, then press Resume; use a local disk",
)
SERVICE_SILENT = Fault(
    "service-silent",
    "the service has stood still, so that nobody could stop the machine by it; the "
    "feed is held",
    "look at the computer's load, then press Resume",
)
UNSTOPPED = Fault(
    "stop-unconfirmed",
    "the machine moves on although the rest of its path was called off",
    "press feed hold at the machine",
    latched=True,
)
UNMOVED = Fault(
    "not-moving",
    "the machine says that it runs, and has not moved for a while",
    "look at the feed override and at the panel of the machine; it goes on from there",
)
STALLED = Fault(
    "feed-override",
    "the feed override is 0 %: the machine says that it runs, and stands",
    "turn it to 100 % at the machine; it goes on from there",
)
BEAM_LOST = Fault(
    "beam-lost",
    "the tracker has lost the reflector; the feed is held",
    "lock the beam on the reflector, then press Resume",
)
HOMED = Fault(
    "tracker-homed",
    "the tracker was not initialised; it has been sent to its reference",
    "nothing; where the beam is on no target now, lock it on the reflector",
)
NO_BEAM = Fault(
    "not-resumed",
    "the tracker sends no valid samples or damaged ones, the machine stays held",
    "lock the beam on the reflector, look at the cable, then press Resume",
)
AIR_UNKNOWN = Fault(
    "air-unknown",
    "the tracker does not correct for the air, and temperature and pressure of the air "
    "are not measured: usual air is taken, where the tracker's light is known",
    "set thermometers with air_degC and pressure_hPa; state the site's altitude",
)
NO_WATCHDOG = Fault(
    "no-watchdog",
    "the controller has no watchdog: it would move on if the service died",
    "give it one; allow_no_watchdog is for a driver that says of itself that it stops "
    "where it is not asked",
)
MOTION_BUSY = Fault(
    "motion-busy",
    "the controller runs a program, or somebody holds one at the panel",
    "let it end, or end or reset it at the panel",
)
STOP_NOT_CONFIRMED = Fault(
    "stop-unconfirmed",
    "the controller was told to stop and does not say that it stands",
    "stop the machine at its emergency stop",
    latched=True,
)
STILL_HELD = Fault(
    "resume-unconfirmed",
    "the controller keeps holding",
    "release feed hold and door at the machine, then press Resume",
)


def make_beam_fault(text: str) -> Fault:
    """Lost beam, with a specific text."""
    return Fault(BEAM_LOST.code, text, BEAM_LOST.action)


def make_override_fault(override: float) -> Fault:
    """Feeds differ from the plan; at 0 % the machine does not move.

    override : 1 is 100 %
    """
    if override == 0.0:
        return STALLED
    return Fault(
        "feed-override",
        f"the feed override is {100 * override:.0f} %: feeds are not those of the plan",
        "set it to 100 % at the machine; the measurement goes on meanwhile",
    )


def make_target_fault(name: str, misfit_mm: float) -> Fault:
    """A point does not belong to the expected target."""
    return Fault(
        "wrong-target",
        f"the point is not that of target {name}: it lies {misfit_mm:.1f} mm from "
        "where the points before have it; another target is measured, or was before",
        f"lock the beam on {name}, look at the targets in the machine file, then "
        "press Resume",
    )


def make_late_fault(error: DeviceError) -> Fault:
    """The last valid status of the controller is too old."""
    busy = isinstance(error, DeviceBusy)
    what = "says that it is busy" if busy else "has sent no valid status in time"
    return Fault(
        "control-busy" if busy else "control-late",
        f"the controller {what}; the feed is held: {error}",
        "nothing: it goes on by itself when the controller answers within seconds",
    )


def make_held_fault(reason: str, late: Fault | None = None) -> Fault:
    """The machine is held without a request of the service.

    late : why its watchdog got no beats
    """
    text = f"the feed is held at the machine: {reason}"
    return Fault(
        late.code if late else "held-at-machine",
        f"{text}; {late.text}" if late else text,
        "look why, then release it there or press Resume",
    )


def make_ended_early_fault(
    axes: Sequence[str], status: MotionStatus, goal: Iterable[float]
) -> Fault:
    """The machine stopped short of its goal."""
    there = ", ".join(f"{value:.3f}" for value in goal)
    return Fault(
        "ended-early",
        f"the controller is {status.state} at {_format_position(axes, status)} "
        f"(row {status.line + 1}), not at {there}",
        "check which program ran at the machine",
        latched=True,
    )


def make_runs_on_fault(axes: Sequence[str], status: MotionStatus) -> Fault:
    """The machine moved on after the end of its path."""
    return Fault(
        "runs-on",
        "the machine has moved on from the end of its path to "
        f"{_format_position(axes, status)}; the controller says that it is "
        f"{status.state}",
        "press feed hold at the machine, and check which program runs there",
        latched=True,
    )


def _format_position(axes: Sequence[str], status: MotionStatus) -> str:
    here = zip(axes, status.position, strict=True)
    return ", ".join(f"{axis} {value:.3f}" for axis, value in here)


def make_unable_fault(status: MotionStatus, *, latched: bool) -> Fault:
    """The machine cannot be moved: its state and alarm give the reason."""
    why = UNABLE[status.state]
    said = status.alarm.strip()
    text = f"{why.text}: {said}" if said and said != str(why) else why.text
    action = f"{why.remedy}, then measure again"
    return Fault(f"motion-{status.state}", text, action, latched=latched)


def make_silence_fault(after_s: float) -> Fault:
    """The stream has been silent for too long."""
    return Fault(
        "tracker-silent",
        f"no sample has come for {after_s:g} s",
        "check the tracker and its cable, then measure again",
        latched=True,
    )


def make_position_fault(doubt: str) -> Fault:
    """The controller's positions are implausible."""
    return Fault(
        "position-implausible",
        f"the controller's positions are not to be believed: {doubt}",
        "look at the control, its link and its position display, then press Resume",
    )


def make_frozen(moved_mm: float) -> Fault:
    """The tracker's position is constant while its target moves."""
    return Fault(
        "tracker-frozen",
        f"the tracker shows the same place, to the last digit, while the target has "
        f"moved {moved_mm:.1f} mm",
        "look at the tracker and its software, then press Resume",
    )


def make_disagreement_fault(by_tracker_mm: float, by_axes_mm: float) -> Fault:
    """Target displacements differ between tracker and controller."""
    return Fault(
        "tracker-disagrees",
        f"the target has gone {by_tracker_mm:.0f} mm by the tracker and "
        f"{by_axes_mm:.0f} mm by the controller",
        "look which reflector the tracker follows, and where the axes are, then press "
        "Resume",
    )
