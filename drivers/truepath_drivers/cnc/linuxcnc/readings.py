"""Readings of the machine by linuxcncrsh, and the state that they indicate."""

from __future__ import annotations

from dataclasses import dataclass

from truepath_drivers import host_clock
from truepath_drivers.cnc.linuxcnc.machine import LinuxCncAxes
from truepath_drivers.cnc.linuxcnc.rsh import RshLink
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.interfaces.records import MotionState

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
    stands : nothing moves; a held or ended motion may still be braking
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
    stands: bool
    line: int
    position: tuple[float, ...]
    override: float
    follows_tip: bool
    referenced: bool
    dead: str = ""

    @property
    def has_ended(self) -> bool:
        """Whether nothing moves, runs or is paused."""
        return self.stands and not self.is_busy and not self.is_paused


def read_machine(
    rsh: RshLink, machine: LinuxCncAxes, *, is_tripped: bool, was_standing: bool
) -> Reading:
    """One reading; two where the machine may be braking.

    was_standing : it was at rest at the last reading after its last motion
    """
    status = rsh.read("program_status").upper()
    is_driven = status == "RUNNING" and not is_tripped
    position = read_position(rsh, machine)
    stands = not is_driven and (was_standing or _stays(rsh, machine, position))
    return Reading(
        _find_hindrance(rsh, machine),
        status == "RUNNING",
        status == "PAUSED",
        is_tripped,
        stands,
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
        if not _lie_apart(rsh, machine):
            return False
    return True


def _lie_apart(rsh: RshLink, machine: LinuxCncAxes) -> bool:
    before = read_position(rsh, machine)
    world = _numbers(rsh.read("abs_act_pos"))
    after = read_position(rsh, machine)
    return any(
        not min(ends) - _SAME <= world["XYZABC".index(axis)] <= max(ends) + _SAME
        for axis, *ends in zip(machine.axes, before, after, strict=True)
    )


def _find_hindrance(rsh: RshLink, machine: LinuxCncAxes) -> MotionState | None:
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
