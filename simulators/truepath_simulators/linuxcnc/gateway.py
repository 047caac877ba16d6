"""The register map in front of a real LinuxCNC: a Modbus TCP server next to it.

Runs in the namespaces of `rig`, by the project's Python with LinuxCNC's module:
`python -m truepath_simulators.linuxcnc.gateway ORDERS`. Registers and verbs are those
of the simulated CNC; planner, limits, kinematics and positions are LinuxCNC's. While it
moves, the watchdog in HAL monitors this program, and this program its master.
"""

from __future__ import annotations

import importlib
import json
import select
import sys
import time
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from truepath_drivers.cnc.linuxcnc import program as nc
from truepath_drivers.cnc.linuxcnc.links import WatchdogLink
from truepath_drivers.cnc.modbus.registers import (
    DRIVES_ARCS,
    TELLS_OVERRIDE,
    TELLS_REFERENCED,
    HoldReason,
    Result,
)
from truepath_drivers.interfaces.records import UNABLE, Arc, MotionState, Path
from truepath_drivers.transport.tcp_port import TcpPort
from truepath_simulators.cnc.cnc_controller import Controller
from truepath_simulators.cnc.cnc_registers import Clocks, CncRegisters
from truepath_simulators.cnc.modbus import ModbusTcpPort, answer
from truepath_simulators.linuxcnc.rig import GATEWAY_PORT, WATCHDOG_PORT
from truepath_simulators.machine_file import MachineFile, parse_machine
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Arc as DrivenArc
from truepath_simulators.motion.program import Program
from truepath_simulators.processes import AwakeClock

_MODULES = "/usr/lib/python3/dist-packages"
_PERIOD_S = 0.005
_LATE_S = 0.1
_BEGIN_S = 0.1  # in which a motion shows in LinuxCNC's status
_ARRIVED = 1e-3  # mm or deg


class LinuxCncController(Controller):
    """LinuxCNC's task as the controller behind the registers."""

    model = "LinuxCNC"
    features = TELLS_OVERRIDE | TELLS_REFERENCED | DRIVES_ARCS

    def __init__(self, machine: MachineFile, folder: FilePath) -> None:
        super().__init__(machine, Limits(), lambda _: None, 0.0)
        cnc: Any = importlib.import_module("linuxcnc")  # Debian's
        self._cnc, self._errors = cnc, cnc.error_channel()
        self._stat, self._command = cnc.stat(), cnc.command()
        self._watchdog = WatchdogLink(TcpPort("127.0.0.1", WATCHDOG_PORT), 1.0)
        self._watchdog.open()
        self._folder = folder
        self._driven: nc.Program | None = None
        self._begun_s = 0.0
        self._wanted, self._reason = MotionState.FINISHED, HoldReason.NONE
        self.update(time.monotonic())

    def update(self, now_s: float) -> None:
        """Read LinuxCNC's state: hindrances, and the end of a motion."""
        self._stat.poll()
        self.is_referenced = all(self._stat.homed[: len(self.machine.axes)])
        hindrance = self._find_unable_state()
        if hindrance is not None:
            self.state, self.path = hindrance, None
        elif self.state in UNABLE:
            self.state = MotionState.IDLE
        elif self.state is MotionState.RUNNING and now_s > self._begun_s + _BEGIN_S:
            self._detect_end()
        if self.state is MotionState.RUNNING:
            self._watchdog.send("beat")

    @property
    def has_moved(self) -> bool:
        return self._driven is not None

    def position(self, now_s: float) -> np.ndarray:
        return np.array(self._stat.joint_actual_position[: len(self.machine.axes)])

    def feed_mm_min(self, now_s: float) -> float:
        """Present speed of the planner."""
        return 60.0 * self._stat.current_vel

    def line(self, now_s: float) -> int:
        """Row of the line on which LinuxCNC moves."""
        if self._runs_path and self._driven is not None and self._is_busy():
            self._line = self._driven.find_row(self._stat.motion_line)
        return self._line

    def move_to(self, row: Program, now_s: float) -> None:
        self._runs_path, self._line = False, 0
        feed_mm_min = 60.0 * float(row.feed_mm_s[0])
        program = nc.write_move(self.machine.axis_names, row.position[0], feed_mm_min)
        self._begin(program, self._cnc.MODE_MDI)
        self._command.mdi(program.text)

    def start(self, now_s: float) -> Result:
        """Write the path as a program and run it."""
        if self.path is None:
            return Result.NO_PATH
        feed_mm_min = 60.0 * self.path.feed_mm_s
        names = self.machine.axis_names
        arcs = tuple(
            None if one is None else _name_arc(one, names) for one in self.path.arc
        )
        rows = Path(names, self.path.position, feed_mm_min, self.path.dwell_s, arc=arcs)
        program = nc.write_program(rows, ())
        nc.store_program(program, self._folder)
        self._runs_path, self._line = True, 0
        self._begin(program, self._cnc.MODE_AUTO)
        self._command.program_open(str(self._folder / program.name))
        self._command.auto(self._cnc.AUTO_RUN, 0)
        return Result.DONE

    def hold(self, reason: HoldReason, now_s: float) -> None:
        """Pause; held once the axes stand."""
        if self.state is MotionState.RUNNING and self._wanted is MotionState.FINISHED:
            self._wanted, self._reason = MotionState.HELD, reason
            self._command.auto(self._cnc.AUTO_PAUSE)

    def resume(self, now_s: float) -> None:
        if self.state is MotionState.HELD or self._wanted is MotionState.HELD:
            self._drive(self._driven)
            self._command.auto(self._cnc.AUTO_RESUME)

    def abort(self, now_s: float) -> None:
        """Stop and remove the path."""
        if self.state in UNABLE:
            return
        self.path = None
        self._command.abort()
        self._wanted, self._reason = MotionState.ABORTED, HoldReason.NONE
        if self.state is not MotionState.RUNNING:
            self.state, self.hold_reason = MotionState.ABORTED, HoldReason.NONE

    def enable(self) -> None:
        """Clear the emergency stop, switch the drives on; home unhomed joints."""
        if self.state is MotionState.UNHOMED:
            self._command.mode(self._cnc.MODE_MANUAL)
            self._command.home(-1)
        else:
            self._command.state(self._cnc.STATE_ESTOP_RESET)
            self._command.state(self._cnc.STATE_ON)
        self._command.wait_complete(_BEGIN_S)
        self.update(time.monotonic())

    @property
    def feed_override(self) -> float:
        return self._stat.feedrate

    def override(self, factor: float, now_s: float) -> None:
        self._command.feedrate(factor)

    def _begin(self, program: nc.Program, mode: int) -> None:
        self._command.mode(mode)
        self._command.wait_complete(_BEGIN_S)
        self._drive(program)

    def _drive(self, program: nc.Program | None) -> None:
        self._driven = program
        self._watchdog.send("arm")
        self._wanted, self._reason = MotionState.FINISHED, HoldReason.NONE
        self.state, self.hold_reason = MotionState.RUNNING, HoldReason.NONE
        self._begun_s = time.monotonic()

    def _is_busy(self) -> bool:
        return self._stat.interp_state != self._cnc.INTERP_IDLE or not self._stat.inpos

    def _detect_end(self) -> None:
        if self._stat.current_vel > 0.0:
            return
        if self._stat.paused:
            self.state = MotionState.HELD
            self.hold_reason = self._reason or HoldReason.OPERATOR
        elif not self._is_busy():
            arrived = self._wanted is not MotionState.ABORTED and self._is_at_goal()
            self.state = MotionState.FINISHED if arrived else MotionState.ABORTED
            self._describe_errors()
        if self.state is not MotionState.RUNNING:
            self._watchdog.send("disarm")

    def _is_at_goal(self) -> bool:
        goal = self._driven.goal if self._driven else ()
        here = self.position(0.0)
        return len(goal) > 0 and np.allclose(here, goal, rtol=0, atol=_ARRIVED)

    def _describe_errors(self) -> None:
        while (error := self._errors.poll()) is not None:
            print(error, file=sys.stderr, flush=True)

    def _find_unable_state(self) -> MotionState | None:
        if self._stat.estop:
            return MotionState.ESTOP
        if not self._stat.enabled:
            return MotionState.NOT_READY
        return None if self.is_referenced else MotionState.UNHOMED


def _name_arc(arc: DrivenArc, names: Sequence[str]) -> Arc:
    plane = "".join(names[column] for column in arc.columns)
    return Arc(plane, arc.centre_mm, float(np.degrees(arc.turn_rad)))


def main(orders: dict[str, Any]) -> None:
    sys.path.append(_MODULES)
    machine = parse_machine(orders["machine"])
    controller = LinuxCncController(machine, FilePath(orders["folder"]))
    clocks = Clocks(time.monotonic, AwakeClock(_LATE_S))
    registers = CncRegisters(controller, clocks, "LINUXCNC")
    port = ModbusTcpPort("127.0.0.1", GATEWAY_PORT)
    while True:
        select.select(port.descriptors(), [], [], _PERIOD_S)
        controller.update(time.monotonic())
        registers.watch()
        port.serve(lambda _unit, pdu: answer(pdu, registers))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
