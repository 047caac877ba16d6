"""Sensors by a register list: every type, TCP and RTU, and what goes wrong."""

import math
import threading
import time
from importlib.metadata import entry_points

import pytest

from truepath_drivers.conformance.checking import NotConforming, on_terms
from truepath_drivers.conformance.device import (
    a_device_that_is_not_there_is_a_device_error,
)
from truepath_drivers.conformance.thermometers import THERMOMETER_CHECKS
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout, Refused
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.thermometers import Channel, Reading, Thermometers
from truepath_drivers.thermometers.modbus_registers.driver import (
    ModbusRegisters,
    Register,
)
from truepath_simulators.cnc.modbus_ports import ModbusRtuPort, ModbusTcpPort
from truepath_simulators.cnc.thermometer_gateway import UNITS, ThermometerGateway
from truepath_simulators.faults import Schedule, parse_fault
from truepath_simulators.hidden.warming import ThermalGrowth
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine

PERIOD_S = 0.05
NAMES = [
    "X_degC",
    "Y_degC",
    "Z_degC",
    "spindle_degC",
    "air_degC",
    "pressure_hPa",
    "humidity_percent",
]


class ServedGateway:
    """A simulated gateway in a thread of this process; `at_s` is its clock."""

    def __init__(self, port, hidden=()):
        self.faults, self.at_s, self.asked = Schedule(()), 0.0, 0
        machine = parse_machine(load_machine("demo"))
        self.gateway = ThermometerGateway(machine, hidden, 1, self.faults)
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


@pytest.fixture(params=["tcp", "rtu"])
def either_gateway(request):
    is_tcp = request.param == "tcp"
    port = (
        ModbusTcpPort("127.0.0.1", 0, UNITS) if is_tcp else ModbusRtuPort(None, UNITS)
    )
    with ServedGateway(port) as served:
        yield served


@pytest.fixture
def gateway():
    with ServedGateway(ModbusTcpPort("127.0.0.1", 0, UNITS)) as served:
        yield served


def read_once(group):
    time.sleep(PERIOD_S)
    return {reading.channel: reading for reading in group.read()}


def test_every_installed_driver_of_ours_is_checked_here():
    ours = {point.name for point in entry_points(group="truepath.thermometers")}
    assert ours == {"modbus-registers"}


@pytest.mark.parametrize("check", THERMOMETER_CHECKS, ids=lambda c: c.__name__)
def test_it_conforms(either_gateway, check):
    (point,) = entry_points(group="truepath.thermometers", name="modbus-registers")
    check(lambda: point.load()(**either_gateway.options))


def test_a_gateway_that_is_not_there_is_a_device_error(free_port):
    rows = [{"name": "X_degC", "address": 0}]
    a_device_that_is_not_there_is_a_device_error(
        lambda: ModbusRegisters(host="127.0.0.1", port=free_port, registers=rows)
    )


def test_every_type_of_register_shows_its_temperature():
    warm = ThermalGrowth("X", 11.0, 4.0, 100.0, 5.0)
    with ServedGateway(ModbusTcpPort("127.0.0.1", 0, UNITS), [warm]) as served:
        served.at_s = 1e5
        with ModbusRegisters(**served.options) as group:
            shown = read_once(group)
    assert [*shown] == NAMES
    expected = [24.0, 20.0, 20.0, 20.0, 20.5, 1002.0, 45.0]
    for reading, value in zip(shown.values(), expected, strict=True):
        assert reading.value == pytest.approx(value, abs=2.5)
    assert shown["X_degC"].value == pytest.approx(24.0, abs=0.15)
    assert shown["pressure_hPa"].value == pytest.approx(1002.0, abs=0.3)


@pytest.mark.parametrize(
    ("kind", "words", "word_order", "value"),
    [
        ("int16", [0xFF38], "big", -20.0),
        ("uint16", [0x00D7], "big", 21.5),
        ("int32", [0xFFFF, 0xFF38], "big", -20.0),
        ("uint32", [0x00D7, 0x0000], "little", 21.5),
        ("float32", [0x4357, 0x0000], "big", 21.5),
        ("float32", [0x0000, 0x4357], "little", 21.5),
    ],
)
def test_words_are_decoded(kind, words, word_order, value):
    row = Register("X_degC", 0, type=kind, word_order=word_order, scale=0.1)
    assert row.decode(words) == pytest.approx(value)


def test_kelvin_and_fahrenheit_by_scale_and_offset():
    kelvin = Register("X_degC", 0, scale=0.01, offset=-273.15)
    fahrenheit = Register("X_degC", 0, scale=0.1 / 1.8, offset=-32 / 1.8)
    assert kelvin.decode([29315]) == pytest.approx(20.0)
    assert fahrenheit.decode([680]) == pytest.approx(20.0)


@pytest.mark.parametrize(
    "row",
    [
        {"name": "temperature", "address": 0},
        {"name": "X_degC", "address": 65535, "type": "float32"},
        {"name": "X_degC", "address": 0, "type": "int64"},
        {"name": "X_degC", "address": 0, "function": "coil"},
        {"name": "X_degC", "address": 0, "scale": 0.0},
        {"name": "X_degC", "address": 0, "period_s": 0.0},
        {"name": "X_degC", "address": 0, "low": 50.0, "high": 10.0},
        {"name": "X_degC", "addres": 0},
        {"name": "X_degC"},
    ],
)
def test_a_row_that_cannot_be_is_refused(row):
    with pytest.raises(ValueError, match=r"register|channel"):
        ModbusRegisters(host="127.0.0.1", registers=[row])


def test_a_name_twice_and_no_row_at_all_are_refused():
    row = {"name": "X_degC", "address": 0}
    for rows in ([], [row, row]):
        with pytest.raises(ValueError, match="each name once"):
            ModbusRegisters(host="127.0.0.1", registers=rows)


def test_registers_that_the_gateway_does_not_have_are_refused_by_name(gateway):
    rows = [{"name": "oil_degC", "address": 50}]
    with pytest.raises(Refused, match=r"oil_degC.*does not have these registers"):
        ModbusRegisters(**{**gateway.options, "registers": rows}).connect()


def test_a_silent_sensor_leaves_the_others(gateway):
    gateway.inject("thermometers:silence*2")
    with ModbusRegisters(**gateway.options) as group:
        shown = read_once(group)
    assert {n for n, r in shown.items() if "no valid reply" in r.fault} >= {"Y_degC"}
    assert not shown["air_degC"].fault  # of another unit
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


def test_where_all_sensors_are_silent_connect_says_so(gateway):
    gateway.inject("thermometers:silence")
    with pytest.raises(DeviceTimeout):
        ModbusRegisters(**gateway.options).connect()


def test_no_number_is_no_reading(gateway):
    gateway.inject("thermometers:broken-wire*5")
    with ModbusRegisters(**gateway.options) as group:
        shown = read_once(group)
    assert math.isnan(shown["air_degC"].value)
    assert shown["air_degC"].fault == "the register holds no number"


@pytest.mark.fault_row(13)
def test_a_gateway_that_refuses_costs_its_readings_only(gateway):
    with ModbusRegisters(**gateway.options) as group:
        gateway.inject("thermometers:exception+10s*4")
        assert all(r.fault and math.isnan(r.value) for r in read_once(group).values())
        gateway.at_s = 20.0
        assert not any(reading.fault for reading in read_once(group).values())


@pytest.mark.fault_row(16)
def test_a_lost_connection_comes_back_by_itself(gateway):
    with ModbusRegisters(**gateway.options) as group:
        gateway.inject("thermometers:disconnect")
        time.sleep(0.05)
        faults = [r.fault for r in read_once(group).values()]
        assert all(faults) or not any(faults)  # it may have come back already
        assert not any(reading.fault for reading in read_once(group).values())


def test_nothing_is_asked_before_it_is_due(gateway):
    rows = [{**row, "period_s": 60.0} for row in gateway.gateway.describe()]
    with ModbusRegisters(**{**gateway.options, "registers": rows}) as group:
        assert len(group.read()) == len(NAMES)
        assert group.read() == ()


class Scripted(Thermometers):
    """A driver of another make; `wrong` says what it does wrong."""

    def __init__(self, wrong):
        self.wrong, self._is_open = wrong, False
        self._stamp_s = 0.0

    @property
    def channels(self):
        return (Channel("X_degC"),) * (2 if self.wrong == "name-twice" else 1)

    @property
    def period_s(self):
        return 0.01

    def connect(self):
        self._is_open = True
        return Identity("Us", "scripted", "", "")

    def close(self):
        self._is_open = False

    def read(self):
        if not self._is_open and self.wrong != "reads-closed":
            raise ConnectionLost("connect first")
        clock = time.time if self.wrong == "wall-clock" else time.monotonic
        if self.wrong == "frozen-stamp":
            self._stamp_s = self._stamp_s or clock()
            clock = lambda: self._stamp_s  # noqa: E731
        if self.wrong == "hangs":
            time.sleep(4.5)
        value, fault, name = 20.0, "", "X_degC"
        match self.wrong:
            case "kelvin":
                value = 293.15
            case "old-value-with-a-fault":
                fault = "no answer"
            case "silent-nan":
                value = math.nan
            case "other-channel":
                name = "Y_degC"
            case "never-reads":
                return ()
        return (Reading(name, clock(), value, fault),)


@pytest.mark.parametrize(
    "wrong",
    [
        "name-twice",
        "reads-closed",
        "wall-clock",
        "frozen-stamp",
        "kelvin",
        "old-value-with-a-fault",
        "silent-nan",
        "other-channel",
        "never-reads",
        pytest.param("hangs", marks=pytest.mark.long),
    ],
)
def test_the_checks_catch_a_wrong_driver(wrong):
    caught = []
    with on_terms(patience_s=0.1):
        for check in THERMOMETER_CHECKS:
            try:
                check(lambda: Scripted(wrong))
            except NotConforming:
                caught.append(check.__name__)
    assert caught


def test_the_checks_let_a_right_driver_pass():
    for check in THERMOMETER_CHECKS:
        check(lambda: Scripted(""))
