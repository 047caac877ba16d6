"""Sensors by a register list: every type, TCP and RTU, and what goes wrong."""

import math
import shutil
import subprocess
import threading
import time
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from truepath_drivers.conformance import checking, thermometers
from truepath_drivers.interfaces.errors import DeviceTimeout, Refused
from truepath_drivers.thermometers.modbus_registers.driver import ModbusRegisters
from truepath_simulators import machine_file
from truepath_simulators.cnc.modbus import ModbusRtuPort, ModbusTcpPort
from truepath_simulators.cnc.thermometer_gateway import UNITS, ThermometerGateway
from truepath_simulators.faults import Schedule, parse_fault

PERIOD_S = 0.05


class ServedGateway:
    """A simulated gateway in a thread of this process; `at_s` is its clock."""

    def __init__(self, port):
        self.faults, self.at_s, self.asked = Schedule(()), 0.0, 0
        machine = machine_file.parse_machine(machine_file.load_machine("demo"))
        self.gateway = ThermometerGateway(machine, (), 1, self.faults)
        self._port, self._ending = port, threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ending.set()
        self._thread.join()
        self._port.close()

    @property
    def options(self):
        rows = [{**row, "period_s": PERIOD_S} for row in self.gateway.describe()]
        return {**self._port.address, "registers": rows}

    def inject(self, text):
        self.faults.add(parse_fault(text), self.at_s)

    def _serve(self):
        while not self._ending.wait(0.002):
            if self.faults.strikes("disconnect", self.at_s):
                self._port.disconnect()
            self._port.serve(self._answer)

    def _answer(self, unit, pdu):
        self.asked += 1
        return self.gateway.answer(unit, pdu, self.at_s)


TCP, RTU = partial(ModbusTcpPort, "127.0.0.1", 0), partial(ModbusRtuPort, None)
PORTS = {"tcp": TCP, "rtu": RTU}


@pytest.fixture
def gateway(request):

    with ServedGateway(PORTS[getattr(request, "param", "tcp")](UNITS)) as served:
        yield served


def read_once(group):
    time.sleep(PERIOD_S)
    return {reading.channel: reading for reading in group.read()}


@pytest.mark.parametrize("gateway", PORTS, indirect=True)
@pytest.mark.parametrize("check", thermometers.THERMOMETER_CHECKS)
def test_it_conforms(gateway, check):
    (point,) = entry_points(group="truepath.thermometers")  # all of ours
    check(lambda: point.load()(**gateway.options))


def test_an_absent_gateway_or_register_is_told(gateway, free_port):
    rows = [{"name": "oil_degC", "address": 50}]
    checking.a_device_that_is_not_there_is_a_device_error(
        lambda: ModbusRegisters(host="127.0.0.1", port=free_port, registers=rows)
    )
    with pytest.raises(Refused, match=r"oil_degC.*does not have these registers"):
        ModbusRegisters(**{**gateway.options, "registers": rows}).connect()


def test_a_silent_sensor_and_a_broken_wire_leave_the_others(gateway):
    gateway.inject("thermometers:silence*2")
    gateway.inject("thermometers:broken-wire*5")
    with ModbusRegisters(**gateway.options) as group:
        shown = read_once(group)
    assert {n for n, r in shown.items() if "no valid reply" in r.fault} >= {"Y_degC"}
    assert shown["air_degC"].fault == "the register holds no number"  # of another unit
    assert not shown["pressure_hPa"].fault
    assert all(math.isnan(r.value) == bool(r.fault) for r in shown.values())


@pytest.mark.fault_row(14)
def test_a_silent_unit_is_asked_once_in_a_call(gateway):
    with ModbusRegisters(**gateway.options) as group:
        gateway.inject("thermometers:silence")
        begin_s, before = time.monotonic(), gateway.asked
        shown = read_once(group)
    assert all(reading.fault for reading in shown.values())
    assert gateway.asked - before == len(UNITS)
    assert time.monotonic() - begin_s < 1.5
    with pytest.raises(DeviceTimeout):
        ModbusRegisters(**gateway.options).connect()


@pytest.mark.fault_row(13)
@pytest.mark.fault_row(16)
def test_a_gateway_that_refuses_or_drops_the_link_costs_its_readings_only(gateway):
    with ModbusRegisters(**gateway.options) as group:
        gateway.inject("thermometers:exception+10s*4")
        assert all(r.fault and math.isnan(r.value) for r in read_once(group).values())
        gateway.at_s = 20.0
        assert not any(reading.fault for reading in read_once(group).values())
        gateway.inject("thermometers:disconnect")
        time.sleep(0.05)
        faults = [r.fault for r in read_once(group).values()]
        assert all(faults) or not any(faults)  # it may have come back already
        assert not any(reading.fault for reading in read_once(group).values())


def test_nothing_is_asked_before_it_is_due(gateway):
    rows = [{**row, "period_s": 60.0} for row in gateway.gateway.describe()]
    with ModbusRegisters(**{**gateway.options, "registers": rows}) as group:
        assert len(group.read()) == len(group.channels)
        assert group.read() == ()


SOURCE = Path(__file__).with_name("sensor_server.c")
FLOAT = {"function": "holding", "type": "float32"}
ROWS = [
    {"name": "X_degC", "address": 0, "scale": 0.1},
    {"name": "coolant_degC", "address": 1, "scale": 0.1},
    {"name": "air_degC", "address": 10, **FLOAT},
    {"name": "pressure_hPa", "address": 12, **FLOAT, "word_order": "little"},
]


@pytest.fixture(scope="module")
def options(tmp_path_factory):
    if not Path("/usr/include/modbus/modbus.h").exists() or not shutil.which("cc"):
        pytest.fail("libmodbus is absent: apt-get install gcc libc6-dev libmodbus-dev")
    built = tmp_path_factory.mktemp("sensors") / "sensor_server"
    command = ["cc", "-O1", "-Wall", "-Werror", "-o", built, SOURCE, "-lmodbus"]
    subprocess.run(command, check=True, timeout=60)
    rows = [{**row, "period_s": PERIOD_S} for row in ROWS]
    with subprocess.Popen([built], stdout=subprocess.PIPE, text=True) as process:
        port = int(process.stdout.readline().split()[1])
        yield {"host": "127.0.0.1", "port": port, "registers": rows}
        process.kill()


def test_words_of_libmodbus_are_the_temperatures_that_were_put_there(options):
    with ModbusRegisters(**options) as group:
        shown = {reading.channel: reading.value for reading in group.read()}
    put = {"X_degC": 20.5, "coolant_degC": -1.5, "air_degC": 21.5}
    assert shown == pytest.approx({**put, "pressure_hPa": 1002.25})


@pytest.mark.fault_row(18)
@pytest.mark.fault_row(43)
@pytest.mark.parametrize(("row", "right"), [(2, "big"), (3, "little")])
def test_a_clearly_wrong_order_of_words_is_refused_by_name(options, row, right):
    wrong = {"big": "little", "little": "big"}[right]
    rows = [{**options["registers"][row], "word_order": wrong}]
    with pytest.raises(Refused, match=f'{rows[0]["name"]}.*word_order = "{right}"'):
        ModbusRegisters(**{**options, "registers": rows}).connect()


@pytest.mark.parametrize("check", thermometers.THERMOMETER_CHECKS)
def test_it_conforms_on_libmodbus(options, check):
    check(lambda: ModbusRegisters(**options))
