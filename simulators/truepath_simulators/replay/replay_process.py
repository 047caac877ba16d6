"""Tracker and CNC of a Run as one process.

`python -m truepath_simulators.replay.replay_process`
"""

from __future__ import annotations

import select
import time
from functools import partial
from pathlib import Path
from typing import Any

from truepath_simulators.cnc.cnc_registers import Clocks, CncRegisters
from truepath_simulators.cnc.modbus import ModbusPort, answer, make_modbus_ports
from truepath_simulators.errors import SimulatorError
from truepath_simulators.links.links import Port, make_port
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.processes import AwakeClock, LifeLine, is_question
from truepath_simulators.replay.recorded_run import RecordedRun, read_recorded_run
from truepath_simulators.replay.replay_devices import (
    ReplayClock,
    ReplayController,
    ReplayTracker,
)

_PERIOD_S = 0.02
_LATE_S = 0.1


class ReplayRegisters(CncRegisters):
    """Registers that report each reading of the status."""

    def __init__(
        self, controller: ReplayController, clocks: Clocks, serial: str
    ) -> None:
        super().__init__(controller, clocks, serial)
        self._replayed = controller

    def _refresh(self, now_s: float) -> None:
        super()._refresh(now_s)
        self._replayed.note_poll()


def main() -> None:
    life = LifeLine()
    orders = life.orders()
    if not orders:
        return
    try:
        run = read_recorded_run(Path(orders["run"]))
        port = make_port(orders["tracker_link"])
        ports = make_modbus_ports(orders["cnc_link"]) if run.moves else {}
    except (OSError, SimulatorError) as error:
        life.report_failure(error)
        return
    try:
        _serve(life, run, port, ports, orders["speed"])
    finally:
        for one in (port, *ports.values()):
            one.close()


def _serve(
    life: LifeLine,
    run: RecordedRun,
    port: Port,
    ports: dict[str, ModbusPort],
    speed: float,
) -> None:
    clock = ReplayClock(run.moves, speed)
    tracker = ReplayTracker(run, clock)
    registers = _registers(run, clock) if ports else None
    life.report(_describe(run, port, ports))
    while not life.ended:
        for line in life.lines():
            if is_question(line):
                life.report(tracker.read_state())
        now_s = time.monotonic()
        port.converse(partial(tracker.receive, wall_s=now_s), tracker.forget_host)
        port.send(tracker.due(time.monotonic()))
        for one in ports.values():
            one.serve(lambda _unit, pdu: answer(pdu, registers) if registers else None)
        if registers:
            registers.watch()
        readable = [life.descriptor, *port.descriptors()]
        readable += [d for one in ports.values() for d in one.descriptors()]
        select.select(readable, port.list_blocked_descriptors(), [], _PERIOD_S)


def _registers(run: RecordedRun, clock: ReplayClock) -> ReplayRegisters:
    controller = ReplayController(parse_machine(run.machine), run, clock)
    serial = run.devices["motion"]["serial_number"]
    clocks = Clocks(lambda: clock.now_s, AwakeClock(_LATE_S))
    return ReplayRegisters(controller, clocks, serial)


def _describe(
    run: RecordedRun, port: Port, ports: dict[str, ModbusPort]
) -> dict[str, Any]:
    return {
        "tracker": port.address,
        "cnc": {name: one.address for name, one in ports.items()},
        "machine": run.machine,
        "run": {"name": run.name, "samples": run.samples, "is_exact": run.is_exact},
    }


if __name__ == "__main__":
    main()
