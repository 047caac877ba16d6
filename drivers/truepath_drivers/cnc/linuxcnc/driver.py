"""The driver of LinuxCNC, over linuxcncrsh."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.cnc.control import PriorityLock, wait_for_rest
from truepath_drivers.cnc.linuxcnc.links import RshLink, WatchdogLink
from truepath_drivers.cnc.linuxcnc.machine import LinuxCncAxes
from truepath_drivers.cnc.linuxcnc.program import (
    Program,
    store_program,
    write_move,
    write_program,
)
from truepath_drivers.cnc.linuxcnc.session import (
    TIP_FOLLOWED,
    LinuxCncSession,
    Reading,
)
from truepath_drivers.cnc.travel import (
    arrange_path,
    check_arcs,
    check_dwells,
    check_feeds,
    check_positions,
)
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    MotionFault,
    Refused,
)
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import (
    UNABLE,
    Identity,
    MotionState,
    MotionStatus,
    Path,
)
from truepath_drivers.transport.tcp_port import TcpPort

log = logging.getLogger(__name__)

_LEAST_FEED, _MOST_FEED = 0.01, 1e6
_LONGEST_DWELL_S = 1e6


class LinuxCncController(MotionController):
    """LinuxCNC, whose linuxcncrsh listens at `host` and `port`.

    program_folder : of the programs; LinuxCNC sees it under the same name, or as
        `remote_folder`
    ini_file : copy of its INI file; by default the one it names, if readable here
    travel : in place of an INI file, `X 0 500, Y 0 400, Z -300 0` in order of joints
    watchdog_port : where `truepath_watchdog.py` listens on that host, 0 without one
    password, enable_password : of linuxcncrsh
    prologue : blocks before each motion, separated by `;`, such as RTCP off
    reset_at_connect, home_at_connect : clear the emergency stop and switch the drives
        on; home unhomed joints. The machine may move

    Every verb may be called from any thread; `hold` and `abort` take precedence and
    take the command back from any other client of linuxcncrsh.
    """

    def __init__(
        self,
        *,
        host: str,
        port: int = 5007,
        program_folder: str = "",
        remote_folder: str = "",
        ini_file: str = "",
        travel: str = "",
        watchdog_port: int = 0,
        password: str = "EMC",  # noqa: S107, of every linuxcncrsh that is not told one
        enable_password: str = "EMCTOO",  # noqa: S107, likewise
        serial_number: str = "",
        prologue: str = "",
        reset_at_connect: bool = False,
        home_at_connect: bool = False,
        home_timeout_s: float = 120.0,
        reply_timeout_s: float = 1.0,
        poll_s: float = 0.05,
    ) -> None:
        rsh = RshLink(TcpPort(host, port), password, enable_password, reply_timeout_s)
        watchdog = (
            WatchdogLink(TcpPort(host, watchdog_port), reply_timeout_s)
            if watchdog_port
            else None
        )
        self._session = LinuxCncSession(rsh, watchdog, ini_file, travel)
        self._folder = FilePath(program_folder) if program_folder else None
        self._remote_folder = FilePath(remote_folder or program_folder)
        self._serial_number = serial_number
        self._prologue = tuple(b.strip() for b in prologue.split(";") if b.strip())
        self._at_connect = (reset_at_connect, home_at_connect)
        self._home_timeout_s, self._poll_s = home_timeout_s, poll_s
        self._lock = PriorityLock()
        self._motion = LinuxCncMotion(self._session, self._lock)

    @property
    def axes(self) -> tuple[str, ...]:
        return self._session.machine.axes if self._session.machine else ()

    @property
    def travel(self) -> tuple[tuple[float, float], ...]:
        return self._session.machine.travel if self._session.machine else ()

    def connect(self) -> Identity:
        """Open the link, read axes and travel; reset and home by the options."""
        with self._lock.hold():
            self._session.open()
            machine = self._require_machine()
        reset, home = self._at_connect
        if reset and self.status().state in (MotionState.ESTOP, MotionState.NOT_READY):
            self.reset()
        if home and self.status().state is MotionState.UNHOMED:
            self.home(self._home_timeout_s)
        return Identity(
            "LinuxCNC",
            machine.name or "LinuxCNC",
            self._serial_number,
            self._session.version,
            has_watchdog=self._session.has_watchdog,
            drives_arcs=True,
        )

    def status(self) -> MotionStatus:
        """Raises MotionFault, and aborts, where a motion differs from its rows."""
        with self._lock.hold():
            return self._motion.poll()

    def move_to(self, position: Sequence[float], feed_mm_min: float) -> None:
        """Start a straight move by MDI; returns once it has begun."""
        machine = self._require_machine()
        where = np.atleast_2d(np.asarray(position, np.float64))
        check_positions(machine.axes, machine.travel, where)
        check_feeds(np.array([feed_mm_min]), _LEAST_FEED, _MOST_FEED)
        move = write_move(machine.axes, where[0], feed_mm_min)
        aborts = self._motion.aborts
        with self._lock.hold():
            self._motion.prepare("mdi")
            self._session.execute_blocks(self._prologue)
            self._session.require_joint_coordinates()
        self._motion.begin(f"mdi {move.text}", move, aborts)

    def load(self, path: Path) -> None:
        """Write a path as a program, open it, and confirm that it is open."""
        machine = self._require_machine()
        path = arrange_path(path, machine.axes, drives_arcs=True)
        if not len(path):
            raise Refused("the path has no rows")
        check_positions(machine.axes, machine.travel, path.position)
        check_feeds(path.feed_mm_min, _LEAST_FEED, _MOST_FEED)
        check_dwells(path.dwell_s, _LONGEST_DWELL_S)
        check_arcs(path, machine.travel)
        program, aborts = write_program(path, self._prologue), self._motion.aborts
        store_program(program, self._folder)
        with self._lock.hold():
            self._motion.prepare("auto")
            self._session.open_program(self._remote_folder / program.name)
            if self._motion.aborts != aborts:
                raise Refused("aborted while the path was being loaded")
            self._motion.store(program)

    def start(self) -> None:
        self._require_machine()
        program, aborts = self._motion.loaded, self._motion.aborts
        if program is None:
            raise Refused("no path is loaded; load one")
        file = self._remote_folder / program.name
        with self._lock.hold():
            self._motion.prepare("auto")
            if not self._session.holds_program(file):
                self._session.open_program(file)  # a client has opened another
            if not self._prologue:
                self._session.require_joint_coordinates()
        self._motion.begin("run", program, aborts)

    def wait(self, timeout_s: float) -> MotionStatus:
        return wait_for_rest(
            self, self._session.name, self._motion.require_able, timeout_s, self._poll_s
        )

    def hold(self) -> None:
        """Feed hold. No action before the first connection."""
        if self._session.machine is None:
            return
        with self._lock.hold(urgent=True):
            self._motion.hold()

    def resume(self) -> None:
        """Resume after a hold by the service, the operator or the watchdog."""
        self._require_machine()
        with self._lock.hold():
            self._motion.resume()

    def abort(self) -> None:
        self._motion.aborts += 1
        if self._session.machine is None:
            return
        with self._lock.hold(urgent=True):
            self._motion.abort()

    def send_heartbeat(self) -> None:
        """Beat for the watchdog in HAL, where there is one."""
        self._require_machine()
        with self._lock.hold():
            self._session.beat()

    def reset(self) -> None:
        """Clear the emergency stop and switch the drives on."""
        self._require_machine()
        with self._lock.hold():
            self._session.command_and_confirm(
                "estop off", lambda: self._session.reads("estop", "off")
            )
            self._session.command_and_confirm(
                "machine on", lambda: self._session.reads("machine", "on")
            )

    def home(self, timeout_s: float) -> None:
        self._require_machine()
        with self._lock.hold():
            self._session.command("mode manual")
            self._session.pop_errors()
            self._session.command("home -1")
        deadline_s = host_clock.now_s() + timeout_s
        while (status := self.status()).state is MotionState.UNHOMED:
            with self._lock.hold():
                errors = self._session.pop_errors()
            if errors:
                raise MotionFault(f"{self._session.name} does not home: {errors[0]}")
            if host_clock.now_s() > deadline_s:
                raise DeviceTimeout(
                    f"{self._session.name}: not homed in {timeout_s:g} s"
                )
            host_clock.sleep_s(self._poll_s)
        self._motion.require_able(status)

    def limit_override(self, largest: float) -> None:
        self._require_machine()
        with self._lock.hold():
            if self._session.poll().override > largest:
                self._session.command(f"feed_override {100 * largest:.0f}")

    def close(self) -> None:
        try:
            if self._session.machine and self.status().state is MotionState.RUNNING:
                self.abort()
        except DeviceError as error:
            log.warning("%s closed without an answer: %s", self._session.name, error)
        with self._lock.hold(urgent=True):
            self._session.close()

    def _require_machine(self) -> LinuxCncAxes:
        if self._session.machine is None:
            raise ConnectionLost(
                f"{self._session.name} is not connected; connect first"
            )
        return self._session.machine


_BEGIN_S = 0.3  # in which a motion shows, or is refused
_BEGIN_POLL_S = 0.01


class LinuxCncMotion:
    """The active motion, or the last one. The caller locks.

    aborts : number of requests so far, by any thread
    """

    def __init__(self, session: LinuxCncSession, lock: PriorityLock) -> None:
        self._session, self._lock = session, lock
        self._memory = MotionMemory()
        self.aborts = 0

    @property
    def loaded(self) -> Program | None:
        return self._memory.loaded

    def store(self, program: Program) -> None:
        self._memory = MotionMemory(loaded=program, ended=MotionState.READY)

    def poll(self) -> MotionStatus:
        """Read the machine, and update the state of the motion.

        Raises MotionFault, and aborts, where a motion differs from its rows.
        """
        reading, machine = self._session.poll(), self._session.machine
        was_under_way = self._memory.is_under_way
        has_compensation = machine.has_compensation if machine else None
        status = replace(self._memory.assess(reading), compensation=has_compensation)
        if was_under_way and reading.follows_tip and self._memory.has_moved(reading):
            self.abort()
            raise MotionFault(f"{self._session.name}: {TIP_FOLLOWED}")
        if was_under_way and not self._memory.is_under_way:
            self._session.disarm()
            errors = self._session.pop_errors()
            self._memory.text = "; ".join(errors)
            for error in errors:
                log.warning("%s: %s", self._session.name, error)
            status = replace(status, alarm=status.alarm or self._memory.text)
        return status

    def prepare(self, mode: str) -> None:
        """Enter a mode with the machine ready and at rest."""
        status = self.poll()
        self.require_able(status)
        if status.state in (MotionState.RUNNING, MotionState.HELD):
            raise Refused(f"{self._session.name}: not in state {status.state}")
        self._session.pop_errors()
        self._session.enter_mode(mode)

    def begin(self, what: str, program: Program, aborts: int) -> None:
        """Start a motion, and confirm that it runs or has ended already. Locks."""
        with self._lock.hold():
            if self.aborts != aborts:
                raise Refused("aborted before it began")
            before = self._session.poll().position
            self._session.arm()
            try:
                self._session.command(what)
            except Refused:
                self._session.disarm()
                raise
            self._memory = self._memory.begin(program, before)
        deadline_s = host_clock.now_s() + _BEGIN_S
        while self.aborts == aborts and host_clock.now_s() < deadline_s:
            with self._lock.hold():
                reading, errors = self._session.poll(), self._session.pop_errors()
                if errors and self.aborts == aborts:
                    self._memory.executed, self._memory.is_under_way = None, False
                    self._session.disarm()
                    raise Refused(f"{self._session.name}: {'; '.join(errors)}")
                if self._memory.has_moved(reading) or reading.has_ended:
                    return
            host_clock.sleep_s(_BEGIN_POLL_S)

    def hold(self) -> None:
        if self._session.is_running():
            self._memory.is_held_by_us = True
            self._session.force("pause")

    def resume(self) -> None:
        if self.poll().state is not MotionState.HELD:
            return
        self._session.arm()
        self._memory.is_held_by_us = False
        if not self._session.is_running():  # after the watchdog alone it does
            self._session.command("resume")

    def abort(self) -> None:
        self._session.force("abort")
        self._memory = MotionMemory(ended=MotionState.ABORTED)
        self._session.disarm()

    def require_able(self, status: MotionStatus) -> None:
        if status.state in UNABLE:
            raise MotionFault(f"{self._session.name}: {UNABLE[status.state]}")


_ARRIVED = 1e-3  # mm or deg


@dataclass(slots=True)
class MotionMemory:
    """The loaded path and the motion that was begun last.

    ended : the state while nothing moves
    begin_position : axis positions before the motion
    text : message of LinuxCNC at the end of the motion
    """

    loaded: Program | None = None
    executed: Program | None = None
    ended: MotionState = MotionState.IDLE
    is_under_way: bool = False
    begin_position: tuple[float, ...] = ()
    is_held_by_us: bool = False
    line: int = 0
    text: str = ""

    def begin(self, program: Program, position: tuple[float, ...]) -> MotionMemory:
        """The memory at the begin of a motion from a position."""
        return MotionMemory(self.loaded, program, self.ended, True, position)

    def has_moved(self, reading: Reading) -> bool:
        pairs = zip(reading.position, self.begin_position, strict=True)
        return any(abs(now - then) > _ARRIVED for now, then in pairs)

    def is_at_goal(self, reading: Reading) -> bool:
        if self.executed is None:
            return False
        pairs = zip(reading.position, self.executed.goal, strict=True)
        return all(abs(now - goal) <= _ARRIVED for now, goal in pairs)

    def assess(self, reading: Reading) -> MotionStatus:
        """Status of a reading; stores the end of a motion."""
        moves = not reading.is_at_rest and reading.unable is None
        is_held = reading.is_paused or (reading.is_busy and reading.is_tripped)
        if self.executed is not None and (reading.is_busy or reading.is_paused):
            self.line = self.executed.find_row(reading.line)
        if self.is_under_way and not moves and not is_held:
            self.is_under_way = False
            arrived = reading.unable is None and self.is_at_goal(reading)
            self.ended = MotionState.FINISHED if arrived else MotionState.ABORTED
        state, text, reason = self.ended, self.text, ""
        if reading.unable is not None:
            state, text = reading.unable, self.text or str(UNABLE[reading.unable])
        elif moves:
            state = MotionState.RUNNING
        elif is_held:
            state, reason = MotionState.HELD, self._find_hold_reason(reading)
        return MotionStatus(
            state,
            reading.position,
            self.line,
            text,
            reason,
            reading.override,
            reading.referenced,
        )

    def _find_hold_reason(self, reading: Reading) -> str:
        if reading.is_tripped:
            told = f", because {reading.dead} of LinuxCNC does not run"
            return "watchdog" + (told if reading.dead else "")
        return "command" if self.is_held_by_us else "operator"
