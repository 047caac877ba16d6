"""The register list against sensors on libmodbus, a peer that we did not write.

Debian: apt-get install gcc libc6-dev libmodbus-dev.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

from truepath_drivers.conformance.thermometers import THERMOMETER_CHECKS
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.thermometers.modbus_registers.driver import ModbusRegisters

SOURCE = Path(__file__).with_name("sensor_server.c")
PERIOD_S = 0.02
ROWS = [
    {"name": "X_degC", "address": 0, "scale": 0.1},
    {"name": "coolant_degC", "address": 1, "scale": 0.1},
    {"name": "air_degC", "address": 10, "function": "holding", "type": "float32"},
    {
        "name": "pressure_hPa",
        "address": 12,
        "function": "holding",
        "type": "float32",
        "word_order": "little",
    },
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
    assert shown == pytest.approx(
        {
            "X_degC": 20.5,
            "coolant_degC": -1.5,
            "air_degC": 21.5,
            "pressure_hPa": 1002.25,
        }
    )


@pytest.mark.fault_row(18)
@pytest.mark.fault_row(43)
@pytest.mark.parametrize(("row", "right"), [(2, "big"), (3, "little")])
def test_a_clearly_wrong_order_of_words_is_refused_by_name(options, row, right):
    wrong = {"big": "little", "little": "big"}[right]
    rows = [{**options["registers"][row], "word_order": wrong}]
    with pytest.raises(Refused, match=f'{rows[0]["name"]}.*word_order = "{right}"'):
        ModbusRegisters(**{**options, "registers": rows}).connect()


@pytest.mark.parametrize("check", THERMOMETER_CHECKS)
def test_it_conforms(options, check):
    check(lambda: ModbusRegisters(**options))
