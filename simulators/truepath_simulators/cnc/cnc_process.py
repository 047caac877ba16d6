"""The CNC as a separate process: `python -m truepath_simulators.cnc.cnc_process`."""

from __future__ import annotations

import json
import select
from typing import Any

from truepath_drivers.cnc.modbus.registers import BY_NAME, HoldReason
from truepath_drivers.interfaces.records import MotionState
from truepath_simulators.cnc.cnc_controller import Controller
from truepath_simulators.cnc.cnc_registers import Clocks, CncRegisters
from truepath_simulators.cnc.modbus import (
    READ_HOLDING,
    ModbusPort,
    ModbusTcpPort,
    answer,
    exception,
    make_modbus_ports,
)
from truepath_simulators.cnc.thermometer_gateway import UNITS, ThermometerGateway
from truepath_simulators.faults import Fault, Schedule, parse_fault
from truepath_simulators.hidden.effects_by_name import from_json
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.profile import Limits
from truepath_simulators.processes import (
    AwakeClock,
    LifeLine,
    MachineClock,
    is_question,
)
from truepath_simulators.timeline import BoardWriter

PERIOD_S = 0.01
_LEAD_S = 0.02
_LATE_S = 0.1  # ten periods: a busy computer, not yet a suspended one
_HEARTBEAT = BY_NAME["heartbeat"].address
_ALARM_TEXT = "Servo alarm: following error of an axis"
_DISABLING = {
    "alarm": MotionState.ALARM,
    "estop": MotionState.ESTOP,
    "drives-off": MotionState.NOT_READY,
    "unhomed": MotionState.UNHOMED,
    "door": MotionState.DOOR,
}


class Panel:
    """Events of the machine apart from its masters: operator, alarms, faults."""

    def __init__(
        self,
        controller: Controller,
        registers: CncRegisters,
        faults: Schedule,
        clock: MachineClock,
    ) -> None:
        self._controller = controller
        self._registers = registers
        self._faults = faults
        self._clock = clock
        self._held: Fault | None = None
        self._disabled_by: Fault | None = None
        self._overridden: Fault | None = None

    def inject(self, line: str) -> None:
        self._faults.add(parse_fault(line), self._clock.now_s())

    def read_state(self) -> dict[str, Any]:
        controller, now_s = self._controller, self._clock.now_s()
        controller.update(now_s)
        return {
            "state": str(controller.state),
            "position": controller.position(now_s).tolist(),
            "line": controller.line(now_s),
            "feed_mm_min": controller.feed_mm_min(now_s),
            "path_rows": 0 if controller.path is None else len(controller.path),
            "hold_reason": controller.hold_reason.name.lower(),
            "alarm_code": controller.alarm_code,
            "alarm": controller.alarm_text,
        }

    def update(self) -> None:
        """Advance the time: states, watchdog, operator, alarms."""
        now_s = self._clock.now_s()
        self._controller.update(now_s)
        self._registers.watch()
        if self._controller.has_moved:
            self._faults.begin(now_s)
        self._raise_alarms(now_s)
        self._operate(now_s)
        if self._strikes("wrong-identity", now_s):
            self._registers.falsify_identity()
        shifted, zeroed = (self._strikes(k, now_s) for k in ("shifted", "zeroed"))
        off_mm = shifted.amount if shifted else 0.0
        self._registers.falsify_position(0.0 if zeroed else 1.0, off_mm)
        if self._strikes("unreferenced", now_s):
            self._controller.is_referenced = False

    def compensate(self, tables: dict[str, Any]) -> None:
        """Report compensation as active if there are tables."""
        self._controller.is_compensating = bool(tables["files"])

    @property
    def has_moved(self) -> bool:
        return self._controller.has_moved

    def disconnects(self) -> bool:
        return self._strikes("disconnect", self._clock.now_s()) is not None

    def answer(self, pdu: bytes) -> bytes | None:
        """Answer to a request; None where the device is silent."""
        now_s = self._clock.now_s()
        if self._strikes("silence", now_s):
            return None
        refused = self._strikes("exception", now_s)
        if refused:
            return exception(pdu, int(refused.amount))
        if pdu[0] != READ_HOLDING and self._ignores(pdu, now_s):
            return pdu[:5]
        return answer(pdu, self._registers)

    def _ignores(self, pdu: bytes, now_s: float) -> bool:
        is_beat = int.from_bytes(pdu[1:3], "big") == _HEARTBEAT
        ignores_commands = self._strikes("ignore-commands", now_s) is not None
        if ignores_commands and not is_beat:
            return True
        return self._strikes("ignore-writes", now_s) is not None

    def _raise_alarms(self, now_s: float) -> None:
        stays: MotionState | None = None
        for kind, state in _DISABLING.items():
            fault = self._strikes(kind, now_s)
            if fault and fault is not self._disabled_by:
                self._disabled_by = fault
                if state is MotionState.ALARM:
                    self._controller.alarm(int(fault.amount), _ALARM_TEXT, now_s)
                else:
                    self._controller.disable(state, now_s)
            stays = state if fault and fault.lasts else stays
        if self._controller.state is MotionState.DOOR and stays is not MotionState.DOOR:
            self._controller.enable()
        self._registers.staying_cause = stays

    def _operate(self, now_s: float) -> None:
        held = self._strikes("feed-hold", now_s)
        if held and held is not self._held:
            self._controller.hold(HoldReason.OPERATOR, now_s)
        elif self._held and not held:
            self._controller.resume(now_s)
        self._held = held
        overridden = self._strikes("override", now_s)
        if overridden is not self._overridden:
            factor = overridden.amount if overridden else 1.0
            self._controller.override(factor, now_s)
        self._overridden = overridden

    def _strikes(self, kind: str, now_s: float) -> Fault | None:
        if not self._faults.has(kind):
            return None
        return self._faults.strikes(kind, now_s, self._controller.line(now_s))


def main() -> None:
    life = LifeLine()
    orders = life.orders()
    if not orders:
        return
    try:
        ports = make_modbus_ports(orders["link"])
        sensors = ModbusTcpPort(orders["link"]["host"], 0, UNITS)
    except OSError as error:
        life.report_failure(error)
        return
    board = BoardWriter(orders["board"])
    try:
        clock = MachineClock(orders["epoch_ns"], orders["speed"])
        panel = _panel(orders, board, clock)
        panel.compensate(orders["compensation"])
        gateway = _gateway(orders)
        addresses = {name: port.address for name, port in ports.items()}
        rows = {"registers": gateway.describe()}
        life.report(addresses | {"thermometers": sensors.address | rows})
        _serve(life, list(ports.values()), panel, gateway, sensors, clock)
    finally:
        for port in (*ports.values(), sensors):
            port.close()


def _serve(
    life: LifeLine,
    ports: list[ModbusPort],
    panel: Panel,
    gateway: ThermometerGateway,
    sensors: ModbusTcpPort,
    clock: MachineClock,
) -> None:
    while not life.ended:
        for line in life.lines():
            if is_question(line):
                life.report(panel.read_state())
            elif line.startswith("thermometers:"):
                gateway.faults.add(parse_fault(line), clock.now_s())
            elif line.startswith("{"):
                panel.compensate(json.loads(line)["compensation"])
            else:
                panel.inject(line)
        panel.update()
        _serve_sensors(gateway, sensors, clock.now_s(), has_moved=panel.has_moved)
        if panel.disconnects():
            for port in ports:
                port.disconnect()
        for port in ports:
            port.serve(lambda _unit, pdu: panel.answer(pdu))
        waited = [life.descriptor, *(d for port in ports for d in port.descriptors())]
        waited += sensors.descriptors()
        select.select(waited, [], [], PERIOD_S)


def _serve_sensors(
    gateway: ThermometerGateway, port: ModbusTcpPort, now_s: float, *, has_moved: bool
) -> None:
    if has_moved:
        gateway.faults.begin(now_s)
    if gateway.faults.strikes("disconnect", now_s):
        port.disconnect()
    port.serve(lambda unit, pdu: gateway.answer(unit, pdu, now_s))


def _gateway(orders: dict[str, Any]) -> ThermometerGateway:
    return ThermometerGateway(
        parse_machine(orders["machine"]),
        [from_json(effect) for effect in orders["hidden"]],
        orders["seed"],
        Schedule(
            fault
            for fault in map(parse_fault, orders["faults"])
            if fault.device == "thermometers"
        ),
    )


def _panel(orders: dict[str, Any], board: BoardWriter, clock: MachineClock) -> Panel:
    controller = Controller(
        parse_machine(orders["machine"]),
        Limits(**orders["limits"]),
        board.publish,
        _LEAD_S * orders["speed"],
    )
    clocks = Clocks(clock.now_s, AwakeClock(_LATE_S))
    registers = CncRegisters(controller, clocks, f"SIM-C{orders['seed']:06d}")
    faults = Schedule(
        fault for fault in map(parse_fault, orders["faults"]) if fault.device == "cnc"
    )
    return Panel(controller, registers, faults, clock)


if __name__ == "__main__":
    main()
