"""A connected LinuxCNC, used by one thread at a time."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

from truepath_drivers import host_clock
from truepath_drivers.cnc.linuxcnc.links import RshLink, WatchdogLink, WatchdogState
from truepath_drivers.cnc.linuxcnc.machine import LinuxCncAxes, parse_travel, read_ini
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    MotionFault,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import MotionState

log = logging.getLogger(__name__)

_DONE_S = 2.0
_POLL_S = 0.02
_UNITS = "MM"
TIP_FOLLOWED = (
    "coordinates are not the positions of the axes: the tool tip is followed (RTCP); "
    "switch that off, or name the blocks that do as prologue"
)


class LinuxCncSession:
    """linuxcncrsh and the watchdog as one device. The caller locks.

    machine : axes and travel, None before `open` and after `close`

    A lost connection is opened again by the next request, until `close`.
    """

    def __init__(
        self, rsh: RshLink, watchdog: WatchdogLink | None, ini_file: str, travel: str
    ) -> None:
        self._rsh, self._watchdog = rsh, watchdog
        self._ini_file, self._travel = ini_file, travel
        self.machine: LinuxCncAxes | None = None
        self._was_at_rest = False

    @property
    def name(self) -> str:
        return self._rsh.name

    @property
    def version(self) -> str:
        return self._rsh.version

    @property
    def has_watchdog(self) -> bool:
        return self._watchdog is not None

    def open(self) -> None:
        """Connect and read the axes. Nothing is switched or moved."""
        if self.machine is not None and self._rsh.is_open:
            return
        self.close()
        self._rsh.open()
        try:
            units = self._rsh.read("user_linear_units").upper()
            if units != _UNITS:
                raise WrongDevice(
                    f"{self.name}: LinuxCNC counts in {units}; this driver drives "
                    "machines with LINEAR_UNITS = mm"
                )
            machine = self._find_machine()
            if self._watchdog is not None:
                self._watchdog.open()
                if self._rsh.read("program_status").upper() == "IDLE":
                    self._watchdog.send("disarm")
        except BaseException:
            self.close()
            raise
        self.machine = machine

    def close(self) -> None:
        self.machine = None
        self._was_at_rest = False
        self._rsh.close()
        if self._watchdog is not None:
            self._watchdog.close()

    def poll(self) -> Reading:
        machine = self._reopen()
        tripped, dead = False, ""
        if self._watchdog is not None:
            tripped = self._watchdog.send("state") is WatchdogState.TRIPPED
            dead = self._watchdog.list_dead() if tripped else ""
        reading = read_machine(
            self._rsh, machine, is_tripped=tripped, was_at_rest=self._was_at_rest
        )
        self._was_at_rest = reading.is_at_rest
        return replace(reading, dead=dead)

    def is_running(self) -> bool:
        self._reopen()
        return self._rsh.read("program_status").upper() == "RUNNING"

    def pop_errors(self) -> list[str]:
        self._reopen()
        return self._rsh.pop_errors()

    def command(self, what: str) -> None:
        """Send a `set`. Raises Refused if LinuxCNC rejects it."""
        self._reopen()
        if self._rsh.order(what):
            return
        if self._rsh.read("enable").upper() != "ON":
            raise Refused(
                f"{self.name} does not take '{what}': another client of linuxcncrsh "
                "has the command; end it, then connect again"
            )
        errors = "; ".join(self._rsh.pop_errors()) or "not in this state"
        raise Refused(f"{self.name} does not take '{what}': {errors}")

    def force(self, what: str) -> None:
        """Send a `set` that must succeed, taking the command from any other client."""
        self._reopen()
        if not self._rsh.order(what):
            self._rsh.enable()
            if not self._rsh.order(what):
                log.warning("%s does not take '%s'", self.name, what)

    def enter_mode(self, mode: str) -> None:
        """Confirm a mode. Raises Refused, also where another client has the command."""
        if not self.reads("mode", mode) or not self.reads("enable", "on"):
            self.command_and_confirm(f"mode {mode}", lambda: self.reads("mode", mode))

    def command_and_confirm(self, what: str, is_done: Callable[[], bool]) -> None:
        """Send a `set` and wait for its effect. Raises Refused, MotionFault."""
        self.command(what)
        deadline_s = host_clock.now_s() + _DONE_S
        while not is_done():
            if host_clock.now_s() > deadline_s:
                errors = "; ".join(self._rsh.pop_errors()) or "it gives no reason"
                raise Refused(f"{self.name} has not done '{what}': {errors}")
            host_clock.sleep_s(_POLL_S)

    def reads(self, what: str, value: str) -> bool:
        return self._rsh.read(what).upper() == value.upper()

    def execute_blocks(self, blocks: tuple[str, ...]) -> None:
        """Execute blocks one after another that move nothing."""
        for block in blocks:
            self.command_and_confirm(f"mdi {block}", lambda: not self.is_running())

    def require_joint_coordinates(self) -> None:
        """Raise Refused where coordinates differ from the joints: RTCP is on."""
        if differs_from_joints(self._rsh, self._reopen()):
            raise Refused(f"{self.name}: {TIP_FOLLOWED}")

    def open_program(self, file: FilePath) -> None:
        """Open a program. Raises Refused if another one is open afterwards."""
        errors = self._try_to_open(file)
        if errors:
            # The interpreter may still have the one before open, which an abort closes.
            self.command("abort")
            self._rsh.pop_errors()
            errors = self._try_to_open(file)
        if errors:
            raise Refused(
                f"{self.name} does not open {file}: {'; '.join(errors)}; check "
                "program_folder and remote_folder"
            )

    def _try_to_open(self, file: FilePath) -> list[str]:
        self.command(f"open {file}")
        errors = self._rsh.pop_errors()
        is_open = self.holds_program(file)
        return errors or ([] if is_open else ["another program is open"])

    def holds_program(self, file: FilePath) -> bool:
        return self._rsh.read("program") == str(file)

    def beat(self) -> None:
        self._reopen()
        if self._watchdog is not None:
            self._watchdog.send("beat")

    def arm(self) -> None:
        """Arm the watchdog before a motion begins or resumes."""
        self._was_at_rest = False
        if self._watchdog is not None:
            state = self._watchdog.send("arm")
            if state is not WatchdogState.ARMED:
                raise MotionFault(
                    f"{self.name}: the watchdog is {state} after it was armed; "
                    "check truepath.hal"
                )

    def disarm(self) -> None:
        """Disarm the watchdog: no motion of ours is active. Never raises."""
        if self._watchdog is not None:
            with contextlib.suppress(DeviceError):
                self._watchdog.send("disarm")

    def _reopen(self) -> LinuxCncAxes:
        if self.machine is None:
            raise ConnectionLost(f"{self.name} is not connected; connect first")
        if not self._rsh.is_open:
            log.warning("%s: connecting again", self.name)
            self._rsh.open()
        return self.machine

    def _find_machine(self) -> LinuxCncAxes:
        if self._travel:
            return parse_travel(self._travel)
        if self._ini_file:
            return read_ini(FilePath(self._ini_file))
        told = FilePath(self._rsh.read("inifile"))
        if not told.is_absolute():
            raise Refused(
                f"{self.name} does not tell the folder of its INI file ({told}); name "
                "a copy as ini_file, or give travel = 'X 0 500, Y 0 400, Z -300 0'"
            )
        return read_ini(told)


# Longer than the typical cycle of LinuxCNC's task, after which its status is new.
_FRESH_S = 0.025
_LOOKS = 3  # that agree: the task may have been late for one
_STILL = 1e-6  # mm or deg between two looks
_SAME = 0.01  # mm or deg between a coordinate and its joint


@dataclass(frozen=True, slots=True)
class Reading:
    """One reading of the machine.

    unable : why it cannot be moved, None if it can
    is_busy, is_paused : of the interpreter, for any client's motion
    is_tripped : the watchdog inhibits the feed
    is_at_rest : nothing moves; a held or ended motion may still be braking
    line : of the program's file, from 1
    follows_tip : coordinates are not the positions of the axes (RTCP), after `position`
        was read
    referenced : every joint is homed
    dead : names of LinuxCNC's stopped processes, if the watchdog reports them
    """

    unable: MotionState | None
    is_busy: bool
    is_paused: bool
    is_tripped: bool
    is_at_rest: bool
    line: int
    position: tuple[float, ...]
    override: float
    follows_tip: bool
    referenced: bool
    dead: str = ""

    @property
    def has_ended(self) -> bool:
        return self.is_at_rest and not self.is_busy and not self.is_paused


def read_machine(
    rsh: RshLink, machine: LinuxCncAxes, *, is_tripped: bool, was_at_rest: bool
) -> Reading:
    """One reading; two where the machine may be braking.

    was_at_rest : it was at rest at the last reading after its last motion
    """
    status = rsh.read("program_status").upper()
    is_driven = status == "RUNNING" and not is_tripped
    position = read_position(rsh, machine)
    is_at_rest = not is_driven and (was_at_rest or _stays(rsh, machine, position))
    return Reading(
        _find_unable_state(rsh, machine),
        status == "RUNNING",
        status == "PAUSED",
        is_tripped,
        is_at_rest,
        int(_numbers(rsh.read("program_line"))[0]),
        read_position(rsh, machine),
        _numbers(rsh.read("feed_override"))[0] / 100.0,
        differs_from_joints(rsh, machine),
        _is_referenced(rsh, machine),
    )


def _stays(rsh: RshLink, machine: LinuxCncAxes, position: tuple[float, ...]) -> bool:
    for _ in range(_LOOKS - 1):
        host_clock.sleep_s(_FRESH_S)
        pairs = zip(read_position(rsh, machine), position, strict=True)
        if any(abs(now - before) > _STILL for now, before in pairs):
            return False
    return True


def read_position(rsh: RshLink, machine: LinuxCncAxes) -> tuple[float, ...]:
    """Positions of the joints that move the axes, mm or deg."""
    joints = _numbers(rsh.read("joint_pos"))
    return tuple(joints[joint] for joint in machine.joints)


def differs_from_joints(rsh: RshLink, machine: LinuxCncAxes) -> bool:
    """Whether coordinates differ from those of the joints: RTCP is on.

    True only after several readings: an axis may have reversed during one.
    """
    for look in range(_LOOKS):
        if look:
            host_clock.sleep_s(_FRESH_S)
        if not _differ_now(rsh, machine):
            return False
    return True


def _differ_now(rsh: RshLink, machine: LinuxCncAxes) -> bool:
    before = read_position(rsh, machine)
    world = _numbers(rsh.read("abs_act_pos"))
    after = read_position(rsh, machine)
    return any(
        not min(ends) - _SAME <= world["XYZABC".index(axis)] <= max(ends) + _SAME
        for axis, *ends in zip(machine.axes, before, after, strict=True)
    )


def _find_unable_state(rsh: RshLink, machine: LinuxCncAxes) -> MotionState | None:
    if rsh.read("estop").upper() == "ON":
        return MotionState.ESTOP
    if rsh.read("machine").upper() != "ON":
        return MotionState.NOT_READY
    return None if _is_referenced(rsh, machine) else MotionState.UNHOMED


def _is_referenced(rsh: RshLink, machine: LinuxCncAxes) -> bool:
    homed = rsh.read("joint_homed").upper().split()
    return "NO" not in homed[: machine.joint_count]


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()] or [0.0]
    except ValueError as error:
        raise ConnectionLost(f"linuxcncrsh answers {text!r}, no numbers") from error
